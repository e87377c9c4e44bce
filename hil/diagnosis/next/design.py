"""The design of a campaign before anything is known of the error.

Targets lie off any grid, random in each part of the travel. Their order is random, so that position is not confounded
with time or temperature. Reversals occur at all distances. Some targets are measured twice in each run for the noise
floor. Feeds, dwells and levels are shuffled. Runs are cold, warm and rested. `check_campaign` checks a measured
campaign.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.errors import InputError
from hil.diagnosis.next.feasible import CHANGE_MIN, CROSS_MIN, START_MIN
from hil.diagnosis.next.planned_run import Means, PlannedPoint, motion_columns
from hil.records.rows import Floats

REPEATS = 4
SIZES = ((12, 60), (10, 50), (8, 42), (8, 32), (6, 32), (6, 24), (5, 20), (4, 20), (4, 16), (3, 16), (3, 12))
"""Runs and fewest rows of each; the first that fits the time is taken."""
FEEDS = (0.25, 0.5, 1.0)
"""Feeds of approach, as shares of the usual one."""
LONG_DWELL_S = 5.0
HEAT_S = (120.0, 360.0)
"""Shortest and longest stroke or rest between runs, s."""
PAUSE_STEPS = 8
ORDERS = 8
"""Steps in which the pauses are lengthened to use the time; random orders of levels that are tried."""
LONGEST_TRAVEL_MM = 60.0
GRID_SHARE = 0.02
"""A target this near (in periods) to a multiple of a likely pitch is drawn again."""


def design(means: Means, minutes: float, seed: int = 0) -> tuple[PlannedPoint, ...]:
    """The rows of a campaign of at most `minutes`: the largest of `SIZES` that fits with short pauses, with as many more rows as fit
    with pauses half-way, and the longest pauses that fit. Raises InputError when that is too short for the smallest, naming its time.
    """
    least = 0.0
    for runs, fewest in SIZES:
        points = _drawn(means, runs, fewest, seed, 0.0)
        least = plan_minutes(points, means)
        if least > minutes:
            continue
        for rows in range(SIZES[0][1], fewest, -1):
            fuller = _drawn(means, runs, rows, seed, 0.5)
            if plan_minutes(fuller, means) <= minutes:
                points = fuller
                break
        rows = len(points) // runs
        for step in range(PAUSE_STEPS, 0, -1):
            longer = _drawn(means, runs, rows, seed, step / PAUSE_STEPS)
            if plan_minutes(longer, means) <= minutes:
                return longer
        return points
    needed = math.ceil(10.0 * least) / 10.0
    raise InputError(f"{minutes:g} min are too short for a campaign, expected at least {needed:g} min")


def plan_minutes(points: Sequence[PlannedPoint], means: Means) -> float:
    """Machine time of a plan, min: motion, dwells, strokes, rests, and waiting for changes of conditions by a
    person.
    """
    time = float(motion_columns(points, means)["time_s"][-1]) / 60.0
    waits = 0.0
    before: dict[str, float] = {}
    for point in points:
        for name, value in point.levels:
            if before.get(name, value) != value and name not in means.by_itself:
                waits += CHANGE_MIN if name == "load_kg" else CROSS_MIN
            before[name] = value
    return time + waits + START_MIN


def _drawn(means: Means, runs: int, rows: int, seed: int, share: float) -> tuple[PlannedPoint, ...]:
    """share: of the pauses between the shortest and the longest."""
    rng = np.random.default_rng([seed, 23])
    levels = {
        name: _least_along_time(rng, np.resize(np.asarray(values, dtype=np.float64), runs))
        for name, values in means.levels.items()
        if len(values) > 1
    }
    pauses = np.random.default_rng([seed, 24])  # of their own, so that they do not change with the rows
    points: list[PlannedPoint] = []
    for index in range(runs):
        run = _run(rng, means, index + 1, rows, tuple((name, float(v[index])) for name, v in levels.items()))
        if index:  # the first is cold
            warm = index % 2 == 1
            pause = float(round(HEAT_S[0] + share * pauses.uniform() * (HEAT_S[1] - HEAT_S[0])))
            run[0] = replace(run[0], strokes_s=pause if warm else 0.0, rest_s=0.0 if warm else pause)
        points += run
    return tuple(points)


def _least_along_time(rng: np.random.Generator, levels: Floats) -> Floats:
    """The levels in that of `ORDERS` random orders which follows the runs' order least: few runs then do not confound the two."""
    orders = [rng.permutation(levels) for _ in range(ORDERS)]
    number = np.arange(len(levels)) - (len(levels) - 1) / 2.0
    return min(orders, key=lambda order: abs(float(order @ number)))


def _run(
    rng: np.random.Generator, means: Means, number: int, rows: int, levels: tuple[tuple[str, float], ...]
) -> list[PlannedPoint]:
    """Targets over the whole travel in random order and direction, some of them twice with others in between."""
    count = rows - REPEATS
    edges = np.linspace(means.low_mm, means.high_mm, count + 1)
    targets = [_off_pitch(rng, means, float(a), float(b)) for a, b in itertools.pairwise(edges)]
    sides = rng.permutation(np.resize([1, -1], count))
    once = rng.permutation(count)
    again = rng.permutation(once[: count // 2])[:REPEATS]
    order = [*once, *again]
    out = []
    for index in order:
        target, side = targets[int(index)], int(sides[int(index)])
        room = (target - means.low_mm if side > 0 else means.high_mm - target) + means.overrun_mm
        longest = max(means.overrun_mm, min(room, LONGEST_TRAVEL_MM))
        travel = float(np.exp(rng.uniform(np.log(min(0.3, means.overrun_mm)), np.log(longest))))
        feed = means.feed_mm_s * float(rng.choice(FEEDS))
        dwell = LONG_DWELL_S if rng.random() < 0.15 else 0.0
        out.append(
            PlannedPoint(number, side, target, round(travel, 3), levels=levels, feed_mm_s=round(feed, 3), dwell_s=dwell)
        )
    return out


def _off_pitch(rng: np.random.Generator, means: Means, low: float, high: float) -> float:
    """A target in a part of the travel, whole µm, not on a multiple of a likely pitch."""
    target = round(float(rng.uniform(low, high)), 3)
    for _ in range(20):
        phases = [abs(target / p - round(target / p)) for p in means.pitches_mm]
        if all(phase > GRID_SHARE for phase in phases):
            break
        target = round(float(rng.uniform(low, high)), 3)
    return target
