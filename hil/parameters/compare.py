"""Comparison of a set with what a drive holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from drivers.parameters import ParameterValue
from drivers.raw_parameters import DriveIdentity, RawParameters, Steps, WireTime
from hil.parameters.preflight import (
    Objection,
    left_out,
    match_set,
    notes_of_file,
    objections_to_file,
    objections_to_identity,
    unless_held,
)
from hil.parameters.report import plain
from hil.parameters.set_file import ParameterSet
from hil.parameters.tasks import Progress, counted, no_progress, run_together, serialized
from hil.parameters.transaction import ended_in


class Side(Enum):
    """Result of comparing one parameter."""

    SAME = "same"
    DIFFERS = "differs"
    UNKNOWN = "cannot be compared"


@dataclass(frozen=True)
class Compared:
    """One parameter. held, wanted: in its unit, None where unknown; why: reason why it cannot be compared; read_s: answer time, s."""

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
    """One drive against its set. any_version: as for `Target`; cost: bus time of a download of the differences."""

    drive: RawParameters
    contents: ParameterSet
    any_version: bool = False
    rows: list[Compared] = field(default_factory=list)
    objections: list[Objection] = field(default_factory=list)
    identity: DriveIdentity | None = None
    cost: WireTime = field(default_factory=WireTime)
    answer_s: float = 0.0  # drive's own time for one answer, without the bus
    error: str = ""
    notes: list[str] = field(default_factory=list)

    @property
    def same(self) -> bool:
        """Whether the drive holds all of the set, without an error or objection."""
        return not self.error and not self.objections and all(row.side is Side.SAME for row in self.rows)

    def as_json(self) -> dict[str, Any]:
        """As `--json` writes it; bytes as hexadecimal digits."""
        return {
            "drive": self.drive.name,
            "good": self.same,
            "error": self.error,
            "notes": self.notes,
            "objections": [vars(each) for each in self.objections],
            "parameters": [
                {**vars(row), "side": row.side.value, "held": plain(row.held), "wanted": plain(row.wanted)}
                for row in self.rows
            ],
            "download": {**vars(self.cost), "answer_s": self.answer_s},
        }


def compare(
    pairs: Sequence[tuple[RawParameters, ParameterSet]], *, any_version: bool = False, progress: Progress = no_progress
) -> list[Comparison]:
    """Read the parameters of each set, drives side by side, and compare. Errors of a drive or its wire become `Comparison.error`."""
    comparisons = [Comparison(drive, contents, any_version) for drive, contents in pairs]
    progress = serialized(progress)
    errors = run_together(comparisons, lambda each: each.drive, lambda each: _compare(each, progress))
    for comparison, error in zip(comparisons, errors, strict=True):
        if error is not None:
            comparison.error = ended_in(error)
    return comparisons


def _compare(comparison: Comparison, progress: Progress) -> Steps[None]:
    drive, contents = comparison.drive, comparison.contents
    wanted, objections = match_set(drive, contents)
    comparison.objections = objections
    comparison.identity = yield from drive.identify()
    comparison.objections += objections_to_identity(
        contents.identity, comparison.identity, any_version=comparison.any_version
    )
    comparison.notes += [each.why for each in objections_to_file(drive, comparison.identity)]
    omitted = left_out(drive, contents)
    comparison.notes += [omitted] if omitted else []
    comparison.notes += notes_of_file(drive)
    accesses = yield from drive.read([each.address for each in wanted], counted(progress, "read", drive, len(wanted)))
    differing: list[tuple[str, bytes]] = []
    shown: dict[str, bytes] = {}
    for each, access in zip(wanted, accesses, strict=True):
        parameter, info = each.parameter, each.parameter.info
        meant = drive.decode(parameter, each.data)
        if access.data is None:
            why = "" if access.error is None else ended_in(access.error)
            comparison.rows.append(
                Compared(each.address, info.name, drive.unit_of(parameter), None, meant, Side.UNKNOWN, why)
            )
            continue
        shown[each.address] = access.data
        same = drive.same(parameter, access.data, each.data)
        if not same:
            differing.append((each.address, each.data))
        held = drive.decode(parameter, access.data)
        side = Side.SAME if same else Side.DIFFERS
        comparison.rows.append(
            Compared(each.address, info.name, drive.unit_of(parameter), held, meant, side, "", access.seconds)
        )
    comparison.objections = unless_held(drive, comparison.objections, wanted, shown)
    comparison.cost = drive.cost([*shown.items(), *differing], differing)
    comparison.answer_s = _answer_s(comparison, shown)


def _answer_s(comparison: Comparison, shown: Mapping[str, bytes]) -> float:
    """The drive's own time for an answer, s: median of the answer times less their bus time."""
    shares = sorted(
        (row.read_s - comparison.drive.cost([(row.address, shown[row.address])], []).seconds)
        for row in comparison.rows
        if row.read_s is not None
    )
    return max(0.0, shares[len(shares) // 2]) if shares else 0.0
