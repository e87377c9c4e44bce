"""A set against what a drive holds, and against another set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from drivers.parameters import ParameterValue
from drivers.raw_parameters import DriveIdentity, RawParameters, Steps, WireTime
from hil.parameters.preflight import Objection, match_set, objections_to_identity
from hil.parameters.set_file import ParameterSet
from hil.parameters.transaction import DriveJob, ended_in
from hil.parameters.works import Progress, one_at_a_time, run_together, unseen


class Side(Enum):
    """What comparing one parameter gave."""

    SAME = "same"
    DIFFERS = "differs"
    UNKNOWN = "cannot be compared"


@dataclass(frozen=True)
class Compared:
    """One parameter; values in its unit, None where there is none. why: it cannot be compared, or could not be written."""

    address: str
    name: str
    unit: str
    held: ParameterValue | None
    wanted: ParameterValue | None
    side: Side
    why: str = ""
    read_s: float | None = None


@dataclass
class Comparison:
    """One drive against its set. cost: what a download of the differences would cost on the bus, after this look at it."""

    drive: RawParameters
    contents: ParameterSet
    job: DriveJob
    any_version: bool = False
    rows: list[Compared] = field(default_factory=list)
    objections: list[Objection] = field(default_factory=list)
    identity: DriveIdentity | None = None
    cost: WireTime = field(default_factory=WireTime)
    answer_s: float = 0.0  # what the drive took for one answer, beside the bus
    error: str = ""

    @property
    def same(self) -> bool:
        return not self.error and not self.objections and all(row.side is Side.SAME for row in self.rows)

    def as_json(self) -> dict[str, Any]:
        return {
            "drive": self.drive.name,
            "good": self.same,
            "error": self.error,
            "objections": [vars(each) for each in self.objections],
            "parameters": [
                {
                    **vars(row),
                    "side": row.side.value,
                    "held": row.held.hex() if isinstance(row.held, bytes) else row.held,
                    "wanted": row.wanted.hex() if isinstance(row.wanted, bytes) else row.wanted,
                }
                for row in self.rows
            ],
            "download": {**vars(self.cost), "answer_s": self.answer_s},
        }


def compare(
    pairs: Sequence[tuple[RawParameters, ParameterSet]], *, any_version: bool = False, progress: Progress = unseen
) -> list[Comparison]:
    """Read what each set speaks of, side by side, and compare. Never raises for what a drive or its wire does."""
    comparisons = [Comparison(drive, contents, DriveJob(drive), any_version) for drive, contents in pairs]
    progress = one_at_a_time(progress)
    errors = run_together(comparisons, lambda each: each.drive, lambda each: _compare(each, progress))
    for comparison, error in zip(comparisons, errors, strict=True):
        if error is not None:
            comparison.error = ended_in(error)
    return comparisons


def _compare(comparison: Comparison, progress: Progress) -> Steps[None]:
    drive, contents = comparison.drive, comparison.contents
    wanted, objections = match_set(drive, contents)
    comparison.objections = objections
    done = 0

    def tell(count: int) -> None:
        nonlocal done
        done += count
        progress("read", drive.name, done, len(wanted))

    comparison.identity = yield from drive.identify()
    comparison.objections += objections_to_identity(
        contents.identity, comparison.identity, any_version=comparison.any_version
    )
    accesses = yield from drive.read([each.address for each in wanted], tell)
    comparison.job.latencies.note(comparison.job.latencies.read_s, accesses)
    differing: list[tuple[str, bytes]] = []
    shown: dict[str, bytes] = {}
    for each, access in zip(wanted, accesses, strict=True):
        parameter, info = each.parameter, each.parameter.info
        meant = drive.decode(parameter, each.data)
        if access.data is None:
            why = "" if access.error is None else ended_in(access.error)
            comparison.rows.append(Compared(each.address, info.name, info.unit, None, meant, Side.UNKNOWN, why))
            continue
        shown[each.address] = access.data
        same = drive.same(parameter, access.data, each.data)
        if not same:
            differing.append((each.address, each.data))
        held = drive.decode(parameter, access.data)
        side = Side.SAME if same else Side.DIFFERS
        comparison.rows.append(Compared(each.address, info.name, info.unit, held, meant, side, "", access.seconds))
    comparison.cost = drive.cost([*shown.items(), *differing], differing)
    comparison.answer_s = _answer_s(comparison, shown)


def _answer_s(comparison: Comparison, shown: Mapping[str, bytes]) -> float:
    """The drive's own share of an answer: what reading took, less what the bus took, at the median."""
    shares = sorted(
        (row.read_s - comparison.drive.cost([(row.address, shown[row.address])], []).seconds_likely)
        for row in comparison.rows
        if row.read_s is not None
    )
    return max(0.0, shares[len(shares) // 2]) if shares else 0.0
