"""What a job would move, and what it would write, as data: `--dry-run`'s text and the question that a screen asks are made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.axis.axis_file import AxisConfig
from hil.machine.measure import Step


@dataclass(frozen=True)
class Move:
    """One kind of motion. what: "measure", "reverse +", "reverse −", "probe" …; its furthest ends in load mm; its highest velocity

    how: "moves" between the two ends; "goes" to the one place that both are; "drives" by so much from wherever it stands; "turns",
    with ends and velocity in degrees
    """

    what: str
    low_mm: float
    high_mm: float
    velocity_mm_s: float
    how: str = "moves"


@dataclass(frozen=True)
class Write:
    """One thing that is written. what: "rows", "tables", "parameter", "meanwhile" (put back afterwards) …; place: file or parameter"""

    what: str
    place: str


@dataclass(frozen=True)
class Plan:
    """positions: how many are captured, each with `at_rest_s` seconds at rest; datum_mm: where the instrument's zero is taken.

    overtravel_mm: of a probe, whose contacts the positions are then: how far beyond each it goes at most; locked: it changes what only
    the builder may change; of_probe: that is the run-out of the probe, which has a builder's key of its own. new_zero: the axis's zero
    is taken anew; instrument_zeroed: a person says that the instrument counts from another place than it did.
    """

    axis: str
    backend: str
    moves: tuple[Move, ...] = ()
    writes: tuple[Write, ...] = ()
    homes: bool = False
    datum_mm: float | None = None
    positions: int = 0
    at_rest_s: float = 0.0
    locked: bool = False
    overtravel_mm: float | None = None
    of_probe: bool = False
    new_zero: bool = False
    instrument_zeroed: bool = False

    @property
    def reach_mm(self) -> tuple[float, float] | None:
        """The lowest and the highest position; None where nothing moves."""
        if not self.moves:
            return None
        return min(move.low_mm for move in self.moves), max(move.high_mm for move in self.moves)


def measuring_plan(axis: AxisConfig, steps: Sequence[Step], writes: Sequence[Write], *, locked: bool = False) -> Plan:
    """Of a job that measures these steps along the axis."""
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
    )
