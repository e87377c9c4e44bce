"""The plan of a loop, and an interrupted one; separate from the diagnosis, which loads slowly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.axis.axis_file import AxisConfig
from hil.calibration.explore import Exploration
from hil.desk.plan import Move, Plan, PlannedWrite, measuring_plan
from hil.machine.in_motion_settings import InMotion
from hil.machine.measure import bidirectional_steps
from hil.records.journal import Campaign

if TYPE_CHECKING:  # the diagnosis loads slowly
    from hil.diagnosis.loop.procedure import Loop

CLOSE_LOOP = "close-loop"


@dataclass(frozen=True)
class Looped:
    """The result of a loop. stages: the figures of each, as `error_figures`, in the order of time; good: nothing
    remains to be done; loop: as the procedure returns it
    """

    stages: Mapping[str, Mapping[str, Any]]
    good: bool
    loop: Loop


def loop_plan(axis: AxisConfig, exploration: Exploration, in_motion: InMotion | None = None) -> Plan:
    """The least moves and writes of a loop; runs that separate causes are added during it."""
    how = axis.measurement
    steps = bidirectional_steps(how.targets_mm, how.runs)
    writes = [PlannedWrite("rows", str(axis.store.directory)), PlannedWrite("tables", str(axis.tables_path))]
    plan = measuring_plan(axis, steps, writes, locked=True)
    moves = list(plan.moves)
    if exploration.warm_up_s > 0:
        low, high = min(how.targets_mm), max(how.targets_mm)
        moves.append(Move("warm", low, high, axis.limits.max_velocity_mm_s / 2))
    if in_motion is not None:
        low, high = min(how.targets_mm), max(how.targets_mm)
        feeds = ", ".join(f"{feed:g}" for feed in in_motion.feeds_mm_s)
        moves.append(Move(f"feeds {feeds}", low, high, max(in_motion.feeds_mm_s)))
    explored = 2 * exploration.runs * exploration.rows
    return replace(plan, moves=tuple(moves), positions=2 * len(steps) + explored)


def passes_at(axis: AxisConfig, feeds_mm_s: tuple[float, ...]) -> InMotion:
    """Passes at these feeds (mm/s), with the latency and trigger of the axis file."""
    how = axis.instrument
    return InMotion(feeds_mm_s, latency_s=how.latency_s, trigger_input=how.trigger_input)


def unfinished_loop(directory: Path) -> tuple[Exploration, InMotion | None] | None:
    """Exploration and passes of the interrupted loop that can be resumed; None without one, or for one by a plan."""
    found = Campaign.unfinished(directory, CLOSE_LOOP)
    if found is None:
        return None
    try:
        passes = found.purpose.get("in_motion")
        in_motion = None if passes is None else InMotion(**{**passes, "feeds_mm_s": tuple(passes["feeds_mm_s"])})
        return Exploration(**found.purpose["exploration"]), in_motion
    except (KeyError, TypeError):
        return None
