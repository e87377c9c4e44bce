"""The exploring campaign: rows planned to show effects that a calibration cannot, and to keep them apart.

Targets lie off the grid and in random order, so that time is not confounded with position. Reversals have travels of
all lengths. Runs alternate between warmed up and rested. Load and cross position take the given levels in shuffled
order. Every run repeats some of its targets for the noise floor. The whole plan follows from a seed, so that a resumed
campaign continues it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field

import numpy as np

from hil.machine.conditions import SET_UP
from hil.machine.events import Event, Listener, silent
from hil.machine.measure import Step, measure
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Records, concatenate


def warm_up(session: AxisSession, duration_s: float, listener: Listener = silent, *, stage: str = "warm-up") -> None:
    """Full strokes between the outermost targets for duration_s at half the axis's largest velocity, supervised like any other motion.

    Raises what stops the axis.
    """
    velocity = session.drive.limits.max_velocity_mm_s / 2
    low, high = min(session.how.targets_mm), max(session.how.targets_mm)
    start_ns = session.clock.now_ns()
    total = max(1, round(duration_s))
    listener(Event(stage, f"strokes {low:g} to {high:g} mm at {velocity:g} mm/s", 0, total))
    while (elapsed_s := (session.clock.now_ns() - start_ns) / 1e9) < duration_s:
        session.move_to(high, velocity)
        session.move_to(low, velocity)
        listener(Event(stage, done=min(total, round(elapsed_s)), total=total))
    listener(Event(stage, done=total, total=total))


def rest(session: AxisSession, duration_s: float, listener: Listener = silent, *, stage: str = "rest") -> None:
    """Stands still for duration_s, enabled and supervised. Raises what stops the axis."""
    total = max(1, round(duration_s))
    listener(Event(stage, done=0, total=total))
    session.watch(duration_s)
    listener(Event(stage, done=total, total=total))


REPEATS = 4
"""Targets that are measured twice in each run."""


@dataclass(frozen=True)
class ExploringRun:
    """One run of the campaign.

    strokes_s, rest_s: warming strokes and standstill before it; conditions: column -> level during it
    """

    steps: tuple[Step, ...]
    strokes_s: float = 0.0
    rest_s: float = 0.0
    conditions: tuple[tuple[str, float], ...] = field(default=())


@dataclass(frozen=True)
class Exploration:
    """Extent of a campaign: runs, rows per run, and the mean duration of warming up or resting between runs, s."""

    runs: int = 8
    rows: int = 42
    warm_up_s: float = 240.0


def plan_runs(session: AxisSession, how: Exploration, seed: int) -> list[ExploringRun]:
    """The runs of a campaign over the travel of the session's targets; the seed determines targets and order."""
    rng = np.random.default_rng([session.how.seed, seed])
    low, high = min(session.how.targets_mm), max(session.how.targets_mm)
    levels = session.conditions.levels
    settings = {name: _shuffled_levels(rng, values, how.runs) for name, values in levels.items()}
    planned = []
    for number in range(1, how.runs + 1):
        heat = rng.permutation([1.0, 0.0]) if number > 1 else np.array([0.0, 0.0])
        planned.append(
            ExploringRun(
                tuple(_steps(rng, number, how.rows, (low, high), session.how.overrun_mm)),
                strokes_s=float(heat[0] * rng.uniform(0.5, 1.5) * how.warm_up_s),
                rest_s=float(heat[1] * rng.uniform(0.5, 1.5) * how.warm_up_s),
                conditions=tuple((name, values[number - 1]) for name, values in settings.items()),
            )
        )
    return planned


def _shuffled_levels(rng: np.random.Generator, values: Sequence[float], runs: int) -> list[float]:
    """Every level about equally often, in random order."""
    times = -(-runs // len(values))
    return [float(value) for value in rng.permutation(np.tile(np.asarray(values, dtype=np.float64), times))[:runs]]


def _steps(
    rng: np.random.Generator, run: int, rows: int, travel_mm: tuple[float, float], overrun_mm: float
) -> list[Step]:
    """Strata over the travel, one random target in each, in random order and direction; some twice."""
    low, high = travel_mm
    repeats = min(REPEATS, rows // 4)
    edges = np.linspace(low, high, rows - repeats + 1)
    targets = np.round(rng.uniform(edges[:-1], edges[1:]), 3)
    directions = rng.permutation(np.resize([1, -1], len(targets)))
    twice = rng.choice(len(targets), repeats, replace=False)
    order = rng.permutation(np.concatenate([np.arange(len(targets)), twice]))
    steps = []
    for index in order:
        target, direction = float(targets[index]), int(directions[index])
        room_mm = (target - low if direction > 0 else high - target) + overrun_mm
        longest = max(overrun_mm, min(room_mm, 40.0))
        travel = float(np.exp(rng.uniform(np.log(min(0.3, overrun_mm)), np.log(longest))))
        steps.append(Step(run, direction, target, round(travel, 3)))
    return steps


def explore(
    session: AxisSession, campaign: Campaign, name: str, runs: Sequence[ExploringRun], listener: Listener = silent
) -> Records:
    """Measures the runs with the compensation now in force. A run that is on disk already is not prepared again.

    Raises InputError for rows of another plan, and what stops the axis.
    """
    parts = []
    for number, run in enumerate(runs, start=1):
        stage = f"{name}-{number}"
        if not campaign.has_rows(stage):
            _set_conditions(session, run)
            if any(condition in SET_UP for condition, _ in run.conditions):
                session.take_datum()
            if run.strokes_s:
                warm_up(session, run.strokes_s, listener=listener, stage=f"{stage} warming")
            if run.rest_s:
                rest(session, run.rest_s, listener, stage=f"{stage} resting")
        parts.append(measure(session, campaign, stage, run.steps, listener))
    return concatenate(parts)


def _set_conditions(session: AxisSession, run: ExploringRun) -> None:
    """Sets the run's conditions, without power where they are set by hand."""
    conditions = session.conditions
    now = conditions.read()
    other = any(now.get(name) != level for name, level in run.conditions)
    with session.without_power() if conditions.by_hand and other else nullcontext():
        for name, level in run.conditions:
            conditions.set(name, level)
