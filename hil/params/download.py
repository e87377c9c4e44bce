"""A download to one drive or several: who does what when, what is noted before, and what becomes of the others when one fails.

    prepare   identity, state, snapshot, every entry looked at        nothing is written while anything speaks against it
    write     what differs, in order, read back                       on any failure every drive is put back
    keep      the drives store what they hold                         only when asked, only when all of it is proven

What may go in: these stages over `DriveJob`s and their journals. Work on several drives runs side by side as far as their lines allow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

from drivers.drive import DriveState
from drivers.errors import AbortError, BridgeError, CapabilityError, InputError, StateError
from drivers.raw_parameters import DriveIdentity, RawParameters, Steps
from hil.params.journal import Download, Journal, Noted, Phase
from hil.params.preflight import (
    Objection,
    Wanted,
    match_set,
    objection_to_state,
    objections_to_identity,
)
from hil.params.report import Ending, JobReport, Row, Verdict
from hil.params.set_file import ParameterSet
from hil.params.transaction import DriveJob, ended_in

T = TypeVar("T")
Progress = Callable[[str, str, int, int], None]
"""progress(stage, drive, done, total)"""


def unseen(_stage: str, _drive: str, _done: int, _total: int) -> None:
    """Nobody looks."""


@dataclass
class Target:
    """One drive of a download: its set and its journal. any_version: a set read with another revision or firmware is welcome."""

    drive: RawParameters
    contents: ParameterSet
    journal: Journal
    any_version: bool = False


@dataclass
class _Work:
    """A target under way."""

    target: Target
    job: DriveJob
    wanted: list[Wanted] = field(default_factory=list)
    objections: list[Objection] = field(default_factory=list)
    identity: DriveIdentity | None = None
    old: dict[str, bytes] = field(default_factory=dict)
    written: list[str] = field(default_factory=list)
    noted: Download | None = None
    ending: Ending | None = None
    stored: bool = False
    not_kept: bool = False  # the drive was asked to, and said no
    error: str = ""
    notes: list[str] = field(default_factory=list)
    began_ns: int = 0
    seconds: float = 0.0

    @property
    def drive(self) -> RawParameters:
        return self.target.drive

    @property
    def goals(self) -> dict[str, bytes]:
        return {each.address: each.data for each in self.wanted}

    @property
    def after(self) -> dict[str, Sequence[str]]:
        return {each.address: each.after for each in self.wanted}

    def fail(self, error: BridgeError) -> None:
        self.error = self.error or ended_in(error)


def download(targets: Sequence[Target], *, store: bool = False, progress: Progress = unseen) -> list[JobReport]:
    """Write every target's set, all or nothing over all of them; store: have the drives keep it afterwards.

    Never raises for what a drive or its wire does: the reports say it. Raises InputError where an earlier download of one of them is
    not finished, or the journal cannot be written before the first write.
    """
    works = [_Work(target, DriveJob(target.drive)) for target in targets]
    for work in works:
        _refuse_unfinished(work.target)
        work.began_ns = work.drive.clock.now_ns()
    _stage(works, "look", lambda work: len(work.target.contents.entries), partial(_prepare, store=store), progress)
    if any(work.objections or work.error for work in works):
        for work in works:
            work.ending = Ending.REFUSED
        return _reports(works)
    _begin(works, store)
    changing = [work for work in works if work.noted is not None]
    try:
        _stage(changing, "write", lambda work: 2 * len(_differing(work)), _write, progress)
    except KeyboardInterrupt:
        _stage(changing, "put back", lambda work: len(work.goals), _put_back, progress)
        raise
    if any(work.error for work in changing):
        _stage(changing, "put back", lambda work: len(work.goals), _put_back, progress)
        for work in works:
            work.ending = work.ending or Ending.UNCHANGED
        return _reports(works)
    if store:
        _stage(works, "store", lambda _work: 1, _keep, progress)
    for work in works:
        _end(work)
    return _reports(works)


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


def _stage(
    works: Sequence[_Work],
    stage: str,
    total: Callable[[_Work], int],
    steps: Callable[[_Work], Steps[None]],
    progress: Progress,
) -> None:
    for work in works:
        _count(work, stage, total(work), progress)
    errors = run_together(works, lambda work: work.drive, steps)
    for work, error in zip(works, errors, strict=True):
        work.seconds = (work.drive.clock.now_ns() - work.began_ns) * 1e-9
        if error is not None:
            work.fail(error)


def _count(work: _Work, stage: str, total: int, progress: Progress) -> None:
    done = 0

    def tell(count: int) -> None:
        nonlocal done
        done += count
        progress(stage, work.drive.name, min(done, total), total)

    work.job.tell = tell


def _refuse_unfinished(target: Target) -> None:
    unfinished = target.journal.unfinished()
    if unfinished is not None:
        raise InputError(
            f"drive {target.drive.name}: the download begun {unfinished.began} is not finished, expected `hil params resume`"
            " or `hil params rollback` first",
            path=unfinished.path,
        )


# -- the stages of one drive -------------------------------------------------------------------------------------------
def _prepare(work: _Work, store: bool) -> Steps[None]:
    drive, contents = work.drive, work.target.contents
    work.wanted, work.objections = match_set(drive, contents)
    work.identity = yield from drive.identify()
    work.objections += objections_to_identity(contents.identity, work.identity, any_version=work.target.any_version)
    state = yield from drive.state()
    objection = objection_to_state(state)
    if objection is not None:
        work.objections.append(objection)
    if store:
        why = yield from drive.objection_to_store()
        if why is not None:
            work.objections.append(Objection("", "", why))
    accesses = yield from drive.read([each.address for each in work.wanted], work.job.tell)
    work.job.latencies.note(work.job.latencies.read_s, accesses)
    names = {each.address: each.parameter.info.name for each in work.wanted}
    for access in accesses:
        if access.data is not None:
            work.old[access.address] = access.data
        elif access.error is not None:
            unread = f"cannot be read: {ended_in(access.error)}"
            work.objections.append(Objection(access.address, names[access.address], unread))


def _differing(work: _Work) -> list[str]:
    parameters = {each.address: each.parameter for each in work.wanted}
    return [
        address
        for address, data in work.goals.items()
        if not work.drive.same(parameters[address], work.old[address], data)
    ]


def _begin(works: Sequence[_Work], store: bool) -> None:
    """Note what is about to happen, of every drive, before the first write to any."""
    for work in works:
        if work.identity is None or not (_differing(work) or store):
            work.ending = Ending.UNCHANGED
            continue
        noted = [
            Noted(each.address, each.parameter.info.name, work.old[each.address], each.data) for each in work.wanted
        ]
        contents = work.target.contents
        work.noted = work.target.journal.begin(
            work.drive.name, contents.name, contents.digest(), work.identity, noted, store=store
        )


def _write(work: _Work) -> Steps[None]:
    work.written = yield from work.job.bring(work.goals, work.old, work.after)
    _note(work, Phase.PROVEN)


def _put_back(work: _Work) -> Steps[None]:
    try:
        _note(work, Phase.GOING_BACK)
    except InputError as error:  # the disk is full: no reason to leave the drive as it is
        work.notes.append(ended_in(error))
    work.ending = Ending.UNFINISHED
    try:
        yield from work.job.settle_at(work.old, work.after)
    except BridgeError as error:
        work.notes.append(f"it could not be put back: {ended_in(error)}")
        return
    work.ending = Ending.PUT_BACK
    _note(work, Phase.END, ending=work.ending.name)


def _keep(work: _Work) -> Steps[None]:
    state: DriveState = yield from work.drive.state()
    objection = objection_to_state(state)
    if objection is not None:
        raise StateError(f"drive {work.drive.name}: {objection.why}; it was not stored")
    _note(work, Phase.STORING)
    try:
        yield from work.drive.store()
    except (AbortError, CapabilityError) as error:
        work.notes.append(f"it holds all of it, but did not store it: {ended_in(error)}")
        work.not_kept = True
        return
    work.stored = True
    _note(work, Phase.STORED)


def _end(work: _Work) -> None:
    """After everything is proven. A store that failed leaves the parameters written and the job unfinished: it can be resumed."""
    if work.error:
        work.ending = Ending.UNFINISHED
        work.notes.append("everything is written and was read back; whether the drive keeps it is not known")
        return
    work.ending = Ending.WRITTEN if work.written else Ending.UNCHANGED
    if work.noted is not None:
        _note(work, Phase.END, ending=work.ending.name)


def _note(work: _Work, phase: Phase, **facts: object) -> None:
    if work.noted is not None:
        work.target.journal.note(work.noted, phase, **facts)


# -- what is said of it ------------------------------------------------------------------------------------------------
def _reports(works: Sequence[_Work]) -> list[JobReport]:
    failed = [work.drive.name for work in works if work.error or work.objections]
    return [_report(work, [name for name in failed if name != work.drive.name]) for work in works]


def _report(work: _Work, others: Sequence[str]) -> JobReport:
    ending = work.ending or Ending.UNFINISHED
    notes = list(work.notes)
    if others and not work.error and not work.objections and not ending.good:
        notes.append(f"because of {', '.join(others)}")
    return JobReport(
        work.drive.name,
        ending,
        tuple(_row(work, each, ending) for each in work.wanted if each.address in work.old),
        work.stored,
        work.error or ("not stored" if work.not_kept else ""),
        tuple(work.objections),
        tuple(notes),
        work.seconds,
        str(work.noted.path) if work.noted is not None and ending is Ending.UNFINISHED else "",
    )


def _row(work: _Work, each: Wanted, ending: Ending) -> Row:
    drive, latencies, address = work.drive, work.job.latencies, each.address
    same = drive.same(each.parameter, work.old[address], each.data)
    verdict = {
        Ending.WRITTEN: Verdict.SAME if same else Verdict.WRITTEN,
        Ending.UNCHANGED: Verdict.SAME if same else Verdict.NOT_WRITTEN,
        Ending.PUT_BACK: Verdict.SAME if same else Verdict.PUT_BACK,
        Ending.REFUSED: Verdict.SAME if same else Verdict.NOT_WRITTEN,
        Ending.UNFINISHED: Verdict.UNKNOWN,
    }[ending]
    return Row(
        address,
        each.parameter.info.name,
        each.parameter.info.unit,
        drive.decode(each.parameter, work.old[address]),
        drive.decode(each.parameter, each.data),
        verdict,
        latencies.read_s.get(address),
        latencies.write_s.get(address),
    )
