"""The plan of a job: what it moves and writes, as data for `--dry-run` and for the screen's question before the start."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hil.axis.axis_file import AxisConfig
from hil.records.journal import Campaign

if TYPE_CHECKING:  # a script's names load without what measures
    from hil.machine.measure import Step

OF_PROCEDURE = "run-"
"""Begin of the kind of a job, and of its campaigns, that carries out a user's procedure."""


def text_key(kind: str) -> str:
    """The key of a job's kind in the texts of the screen; procedures of users have one together."""
    return "procedure" if kind.startswith(OF_PROCEDURE) else kind.replace(" ", "_")


@dataclass(frozen=True)
class Move:
    """One kind of motion. what: "measure", "reverse +", "reverse −", "probe" …; low_mm, high_mm: its ends, mm of the load;
    velocity_mm_s: the highest.

    how: "moves" between the two ends; "goes" to the position that both ends are; "drives" by a distance from its present position;
    "turns", with ends and velocity in degrees
    """

    what: str
    low_mm: float
    high_mm: float
    velocity_mm_s: float
    how: str = "moves"


@dataclass(frozen=True)
class PlannedWrite:
    """One thing to be written. what: "rows", "tables", "parameter", "meanwhile" (restored afterwards) …; place: file or parameter."""

    what: str
    place: str


@dataclass(frozen=True)
class Plan:
    """The plan of a job.

    homes: the axis is homed; datum_mm: position at which the datum is taken
    travel_s: time of the moves between the positions, without homing and settling, s
    measured: positions that the interrupted campaign has already, where it is gone on with
    positions: number of captures (of a probe: contacts), each with `at_rest_s` seconds at rest
    overtravel_mm: largest travel of a probe beyond each contact
    locked: the job needs the builder's role; store: name of the opened store whose builder's key that is, "" for the axis's
    new_zero: the axis's zero is taken anew; instrument_zeroed: the instrument was zeroed since the last measurement
    """

    axis: str
    backend: str
    moves: tuple[Move, ...] = ()
    writes: tuple[PlannedWrite, ...] = ()
    homes: bool = False
    datum_mm: float | None = None
    positions: int = 0
    at_rest_s: float = 0.0
    locked: bool = False
    overtravel_mm: float | None = None
    store: str = ""
    new_zero: bool = False
    instrument_zeroed: bool = False
    travel_s: float = 0.0
    measured: int = 0

    @property
    def seconds(self) -> float:
        """Least time of the moves and readings, s: without homing, settling and further rounds."""
        return self.travel_s + self.positions * self.at_rest_s

    @property
    def left(self) -> int:
        """Number of positions that are left."""
        return self.positions - self.measured

    @property
    def seconds_left(self) -> float:
        """`seconds` for the positions that are left."""
        return self.seconds * self.left / self.positions if self.positions else 0.0

    @property
    def reach_mm(self) -> tuple[float, float] | None:
        """The lowest and the highest position, mm; None where nothing moves."""
        if not self.moves:
            return None
        return min(move.low_mm for move in self.moves), max(move.high_mm for move in self.moves)


def with_moves_of(plan: Plan, other: Plan) -> Plan:
    """The plan, and the moves of another one before or after it."""
    moves, positions = (*plan.moves, *other.moves), plan.positions + other.positions
    return replace(plan, moves=moves, positions=positions, travel_s=plan.travel_s + other.travel_s)


def going_on(plan: Plan, directory: Path, kind: str) -> Plan:
    """The plan of going on with the interrupted campaign of this kind in an axis's folder; unchanged where there is none."""
    campaign = Campaign.unfinished(directory, kind)
    return plan if campaign is None else replace(plan, measured=min(campaign.rows, plan.positions))


def measuring_plan(
    axis: AxisConfig, steps: Sequence[Step], writes: Sequence[PlannedWrite], *, locked: bool = False
) -> Plan:
    """The plan of a job that measures these steps along the axis."""
    how = axis.measurement
    targets = [step.target_mm for step in steps]
    low = min(*targets, how.reference_mm) - how.overrun_mm
    high = max(*targets, how.reference_mm) + how.overrun_mm
    return Plan(
        axis.name,
        axis.drive.backend,
        (Move("measure", low, high, how.velocity_mm_s),),
        tuple(writes),
        how.home,
        how.reference_mm,
        len(steps),
        how.dwell_s + how.reading_s,
        locked,
        travel_s=_travel_s(axis, targets),
    )


def _travel_s(axis: AxisConfig, targets_mm: Sequence[float]) -> float:
    """Time of the moves from target to target by ramps at the axis's limits, s; a reversal goes past its target by overrun_mm."""
    how, ramp = axis.measurement, axis.limits.max_acceleration_mm_s2
    reversals = 2.0 * how.overrun_mm
    total, sign = 0.0, 0.0
    for start, end in itertools.pairwise((how.reference_mm, *targets_mm)):
        turned = sign != 0.0 and (end - start) * sign <= 0.0
        distance = abs(end - start) + (reversals if turned else 0.0)
        sign = 1.0 if end > start else -1.0
        peak = min(how.velocity_mm_s, (distance * ramp) ** 0.5)
        total += 0.0 if distance == 0.0 else distance / peak + peak / ramp
    return total
