"""What a loop would do, and what one left behind; without what makes a diagnosis, which takes long to load."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from hil.app.jobs.plan import Move, Plan, Write, measuring_plan
from hil.axis.axis_file import AxisConfig
from hil.calibration.explore import Exploration
from hil.calibration.in_motion import InMotion
from hil.machine.measure import bidirectional_steps
from hil.records.journal import Campaign

CLOSE_LOOP = "close-loop"


@dataclass(frozen=True)
class Looped:
    """What a loop came to. stages: the figures of each, as `error_figures`, in the order of time; good: nothing is left to be done"""

    stages: Mapping[str, Mapping[str, Any]]
    good: bool


def loop_plan(axis: AxisConfig, exploration: Exploration, in_motion: InMotion | None = None) -> Plan:
    """What a loop moves and writes at least; runs that tell causes apart come on top."""
    how = axis.measurement
    steps = bidirectional_steps(how.targets_mm, how.runs)
    writes = [Write("rows", str(axis.store.directory)), Write("tables", str(axis.tables_path))]
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


def feeds_of(text: str) -> tuple[float, ...]:
    """Feeds, mm/s, as people type them: at least two, between them commas, or semicolons where a comma is a decimal one.

    Raises InputError.
    """
    parts = text.replace(",", ".").split(";") if ";" in text else text.split(",")
    try:
        found = tuple(float(part) for part in parts)
    except ValueError:
        found = ()
    if len(set(found)) < 2 or not all(0 < feed < math.inf for feed in found):
        raise InputError(f"{text!r}, expected at least two different feeds above 0 mm/s, e.g. 20,60,110")
    return found


def passes_at(axis: AxisConfig, feeds_mm_s: tuple[float, ...]) -> InMotion:
    """Passes at these feeds, with the instrument's latency and trigger as the axis file has them."""
    how = axis.instrument
    return InMotion(feeds_mm_s, latency_s=how.latency_s, trigger_input=how.trigger_input)


def unfinished_loop(directory: Path) -> tuple[Exploration, InMotion | None] | None:
    """How the loop explores that was broken off and can be gone on with; None where there is none, or one by a plan."""
    found = Campaign.unfinished(directory, CLOSE_LOOP)
    if found is None:
        return None
    try:
        passes = found.purpose.get("in_motion")
        in_motion = None if passes is None else InMotion(**{**passes, "feeds_mm_s": tuple(passes["feeds_mm_s"])})
        return Exploration(**found.purpose["exploration"]), in_motion
    except (KeyError, TypeError):
        return None
