"""What every job on several drives is made of: one work for each drive, taken through the same stages side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from drivers.errors import BridgeError
from drivers.raw_parameters import RawParameter, RawParameters, Steps
from hil.parameters.journal import Download, Journal, Phase
from hil.parameters.preflight import Objection
from hil.parameters.report import Ending, JobReport, Row, Verdict
from hil.parameters.transaction import DriveJob, ended_in

T = TypeVar("T")
W = TypeVar("W", bound="Work")
Progress = Callable[[str, str, int, int], None]
"""progress(stage, drive, done, total)"""

VERDICTS = {
    Ending.WRITTEN: Verdict.WRITTEN,
    Ending.UNCHANGED: Verdict.NOT_WRITTEN,
    Ending.PUT_BACK: Verdict.PUT_BACK,
    Ending.REFUSED: Verdict.NOT_WRITTEN,
    Ending.UNFINISHED: Verdict.UNKNOWN,
}
"""Of a parameter whose old and new values differ; of others nothing became, unless nothing is known."""


def unseen(_stage: str, _drive: str, _done: int, _total: int) -> None:
    """Nobody looks."""


@dataclass
class Work:
    """One drive under way. old, new: by address, as far as they are known; after: what comes before what."""

    drive: RawParameters
    journal: Journal
    job: DriveJob
    parameters: dict[str, RawParameter] = field(default_factory=dict)
    old: dict[str, bytes] = field(default_factory=dict)
    new: dict[str, bytes] = field(default_factory=dict)
    after: dict[str, Sequence[str]] = field(default_factory=dict)
    objections: list[Objection] = field(default_factory=list)
    noted: Download | None = None
    ending: Ending | None = None
    stored: bool = False
    error: str = ""
    notes: list[str] = field(default_factory=list)
    meant_back: bool = False
    audited: bool | None = None
    lost: list[str] = field(default_factory=list)
    began_ns: int = 0
    starts: int = 0  # of the drive, when it was looked at
    seconds: float = 0.0

    def fail(self, error: BridgeError) -> None:
        """The first error is the one that is told."""
        self.error = self.error or ended_in(error)

    def differing(self) -> list[str]:
        """Addresses whose new value is not the old one."""
        return [address for address in self.new if not self.same(address, self.old[address], self.new[address])]

    def same(self, address: str, shown: bytes, meant: bytes) -> bool:
        return self.drive.same(self.parameters[address], shown, meant)

    def note(self, phase: Phase, **facts: object) -> None:
        """Into the journal, where this drive has one under way."""
        if self.noted is not None:
            self.journal.note(self.noted, phase, **facts)


def run_together(
    works: Sequence[T], drive: Callable[[T], RawParameters], steps: Callable[[T], Steps[None]]
) -> list[BridgeError | None]:
    """Run steps for each, those on one line side by side; what each raised."""
    results: dict[int, BridgeError | None] = {}
    lines = {id(drive(work).line): drive(work).line for work in works}
    for key, line in lines.items():
        numbers = [number for number, work in enumerate(works) if id(drive(work).line) == key]
        outcomes = line.run([steps(works[number]) for number in numbers])
        results |= {
            number: outcome if isinstance(outcome, BridgeError) else None
            for number, outcome in zip(numbers, outcomes, strict=True)
        }
    return [results[number] for number in range(len(works))]


def stage(
    works: Sequence[W],
    name: str,
    total: Callable[[W], int],
    steps: Callable[[W], Steps[None]],
    progress: Progress = unseen,
) -> None:
    """Take every work through a stage; what it raises becomes its error. total: accesses of it, for the progress."""
    for work in works:
        _count(work, name, max(1, total(work)), progress)
    errors = run_together(works, lambda work: work.drive, steps)
    for work, error in zip(works, errors, strict=True):
        work.seconds = (work.drive.clock.now_ns() - work.began_ns) * 1e-9
        if error is not None:
            work.fail(error)


def _count(work: Work, name: str, total: int, progress: Progress) -> None:
    done = 0

    def tell(count: int) -> None:
        nonlocal done
        done += count
        progress(name, work.drive.name, min(done, total), total)

    work.job.tell = tell


def reports_of(works: Sequence[Work]) -> list[JobReport]:
    """What became of each."""
    failed = [work.drive.name for work in works if work.error or work.objections]
    return [_report(work, [name for name in failed if name != work.drive.name]) for work in works]


def _report(work: Work, others: Sequence[str]) -> JobReport:
    ending = work.ending or Ending.UNFINISHED
    notes = list(work.notes)
    if others and not work.error and not work.objections and not ending.good:
        notes.append(f"because of {', '.join(others)}")
    return JobReport(
        work.drive.name,
        ending,
        tuple(_row(work, address, ending) for address in work.new if address in work.old),
        work.stored,
        work.error,
        tuple(work.objections),
        tuple(notes),
        work.seconds,
        str(work.noted.path) if work.noted is not None and ending is Ending.UNFINISHED else "",
        work.meant_back,
        work.audited,
        tuple(work.lost),
    )


def _row(work: Work, address: str, ending: Ending) -> Row:
    parameter, latencies = work.parameters[address], work.job.latencies
    same = work.same(address, work.old[address], work.new[address])
    return Row(
        address,
        parameter.info.name,
        parameter.info.unit,
        work.drive.decode(parameter, work.old[address]),
        work.drive.decode(parameter, work.new[address]),
        Verdict.SAME if same and ending is not Ending.UNFINISHED else VERDICTS[ending],
        latencies.read_s.get(address),
        latencies.write_s.get(address),
    )
