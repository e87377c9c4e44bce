"""What a loop would do, and what one left behind; without what makes a diagnosis, which takes long to load."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hil.axis import AxisConfig
from hil.files import read_text
from hil.jobs.plan import Move, Plan, Write, measuring_plan
from hil.journal import Campaign
from hil.procedures.explore import Exploration
from hil.procedures.measure import bidirectional_steps

CLOSE_LOOP = "close-loop"


@dataclass(frozen=True)
class Looped:
    """What a loop came to. stages: the figures of each, as `error_figures`, in the order of time; good: nothing is left to be done"""

    stages: Mapping[str, Mapping[str, Any]]
    good: bool


def loop_plan(axis: AxisConfig, exploration: Exploration) -> Plan:
    """What a loop at rest moves and writes at least; runs that tell causes apart come on top."""
    how = axis.measurement
    steps = bidirectional_steps(how.targets_mm, how.runs)
    writes = [Write("rows", str(axis.store.directory)), Write("tables", str(axis.tables_path))]
    plan = measuring_plan(axis, steps, writes, locked=True)
    moves = list(plan.moves)
    if exploration.warm_up_s > 0:
        low, high = min(how.targets_mm), max(how.targets_mm)
        moves.append(Move("warm", low, high, axis.limits.max_velocity_mm_s / 2))
    explored = 2 * exploration.runs * exploration.rows
    return replace(plan, moves=tuple(moves), positions=2 * len(steps) + explored)


def unfinished_exploration(directory: Path) -> Exploration | None:
    """How the loop explores that was broken off and can be gone on with; None where there is none, or one by a plan."""
    found = Campaign.unfinished(directory, CLOSE_LOOP)
    if found is None:
        return None
    try:
        return Exploration(**json.loads(read_text(found / "campaign.json"))["exploration"])
    except (ValueError, KeyError, TypeError):
        return None
