"""Columns of the axis's history: time since the start, travel since the reversal, stroke before it, a sensor seen
through a lag.

Functions from columns to further columns, causal row by row, but that `complete` takes the noise of thermometers and of the air's
sensors out of whole records. During a correction the engine tracks the same values and passes them as columns; what a sensor said
before, for a lag, is in `Course`. For records that lack them they are estimated here, and the result lists which.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from itertools import pairwise
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from hil.effects.thermometers import is_temperature, most_noise, without_noise

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]

LONG_STROKE_MM = 1e6
"""Stroke before the first reversal of a record, where its length is unknown."""
SAME_PLACE_MM = 0.002
"""Two rows' reversals this near are one: records hold travels to a thousandth."""
BRANCH = ("branch_travel_mm", "branch_stroke_mm", "branch_stroke_2_mm", "branch_stroke_3_mm")
"""Columns of the reversals that an elastic drive train still remembers: the travel since the last of them and the strokes before it,
the latest first; closed loops are left out. `LONG_STROKE_MM` where there is none.
"""


def complete(columns: Columns) -> dict[str, Floats]:
    """The columns, with `row_order`, `since_reversal_mm`, `stroke_mm`, `command_mm` and those of BRANCH added where they
    are missing or not filled, and the temperatures of the machine and the air's sensors without their noise
    (`hil.effects.thermometers`).

    columns: at least `run`, `direction`, `target_mm`, each of shape (n,), rows in the order of time. `row_order`
    replaces `time_s` where that is missing (`time_column`).
    """
    full = dict(columns)
    if "command_mm" not in full:
        full["command_mm"] = full["target_mm"]
    if "row_order" not in full:
        full["row_order"] = row_order(full["run"])
        time = full[time_column(full)]
        slow = {name: most for name in full if (most := most_noise(name)) is not None and _filled(full, name)}
        full |= {name: without_noise(time, full[name], most) for name, most in slow.items()}
    if not _filled(full, "since_reversal_mm") or not _filled(full, "stroke_mm"):
        since, stroke = reversals(full["target_mm"], full["direction"])
        if not _filled(full, "since_reversal_mm"):
            full["since_reversal_mm"] = since
        if not _filled(full, "stroke_mm"):
            full["stroke_mm"] = stroke
    return with_branches(full)


def with_branches(columns: Columns) -> dict[str, Floats]:
    """The columns with those of BRANCH, which follow from the others of rows in the order of time."""
    if all(name in columns for name in BRANCH):
        return dict(columns)
    way = (columns[name] for name in ("target_mm", "direction", "since_reversal_mm", "stroke_mm"))
    return {**columns, **branches(*way)}


def time_column(columns: Columns) -> str:
    """`time_s` where it is filled, else `row_order`."""
    return "time_s" if _filled(columns, "time_s") else "row_order"


def stand_ins(columns: Columns) -> tuple[str, ...]:
    """Which columns of time and reversal `complete` has to estimate."""
    return tuple(name for name in ("time_s", "since_reversal_mm", "stroke_mm") if not _filled(columns, name))


def _filled(columns: Columns, name: str) -> bool:
    return name in columns and bool(np.all(np.isfinite(columns[name])))


def row_order(run: Floats) -> Floats:
    """Row order as time, in rows, shape (n,): (run - 1) · rows of that run + row within the run.

    So the later runs of a campaign stay later when they are read alone.
    """
    _, group, counts = np.unique(run, return_inverse=True, return_counts=True)
    by_run = np.argsort(group, kind="stable")
    within = np.empty(len(run))
    within[by_run] = np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.asarray((run - 1.0) * counts[group] + within, dtype=np.float64)


def reversals(target_mm: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Travel since the last reversal and length of the stroke before it, both in mm, shape (n,), from targets alone.

    The overrun before a reversal is not in the records, so the travel is a lower bound.
    """
    n = len(target_mm)
    since, stroke = np.zeros(n), np.full(n, LONG_STROKE_MM)
    travelled, before = 0.0, LONG_STROKE_MM
    for i in range(1, n):
        step = abs(float(target_mm[i] - target_mm[i - 1]))
        if direction[i] == direction[i - 1]:
            travelled += step
        else:
            before, travelled = travelled, step
        since[i], stroke[i] = travelled, before
    if n:
        stroke[0] = LONG_STROKE_MM
    return since, stroke


def remembered(turns_mm: tuple[float, ...], here_mm: float, way: float, target_mm: float) -> tuple[float, ...]:
    """Places of the reversals that matter after a straight motion to another place, the oldest first; way: sign of the motion before.

    A motion that passes the place of the reversal before last closes a loop, which is forgotten (Masing's rules, 1926).
    """
    ahead = 1.0 if target_mm > here_mm else -1.0
    if ahead != way:
        turns_mm = (*turns_mm, here_mm)
    while len(turns_mm) >= 2 and ahead * (target_mm - turns_mm[-2]) >= 0.0:
        turns_mm = turns_mm[:-2]
    return turns_mm


def strokes_of(turns_mm: tuple[float, ...], here_mm: float) -> tuple[float, ...]:
    """The values of BRANCH for the reversals that are remembered at a place, mm."""
    strokes = [abs(b - a) for a, b in pairwise((*turns_mm, here_mm))][::-1]
    return tuple(strokes[: len(BRANCH)] + [LONG_STROKE_MM] * (len(BRANCH) - len(strokes)))


def branches(position_mm: Floats, direction: Floats, since_mm: Floats, stroke_mm: Floats) -> dict[str, Floats]:
    """The columns of BRANCH, each of shape (n,), from places, directions, travels since the reversal and strokes before it.

    A row tells its last two reversals. Where they join those of the row before, the way between the rows is known; where they do not,
    the axis is taken to have come from a long stroke.
    """
    found = np.empty((len(position_mm), len(BRANCH)))
    turns: tuple[float, ...] = ()
    here = way = turned_before = stroke_before = np.nan
    rows = zip(*(values.tolist() for values in (position_mm, direction, since_mm, stroke_mm)), strict=True)
    for i, (place, ahead, since, stroke) in enumerate(rows):
        turned = place - ahead * since
        known = stroke < LONG_STROKE_MM
        before = turned + ahead * stroke
        legs: tuple[float, ...] = (place,)
        same = abs(turned - turned_before) <= SAME_PLACE_MM and abs(stroke - stroke_before) <= SAME_PLACE_MM
        if ahead == way and same and ahead * (place - here) >= -SAME_PLACE_MM:
            pass
        elif known and ahead == -way and abs(before - turned_before) <= SAME_PLACE_MM:
            legs = (turned, place)
        elif known and ahead == way and way * (before - here) >= -SAME_PLACE_MM:
            legs = (before, turned, place)
        else:
            turns, here, way = ((before,) if known else ()), turned, -ahead
        for leg in legs:
            if leg != here:
                turns = remembered(turns, here, way, leg)
                here, way = leg, 1.0 if leg > here else -1.0
        if way != ahead:  # it stands on the reversal itself
            turns, way = (*turns, here), ahead
        found[i], turned_before, stroke_before = strokes_of(turns, here), turned, stroke
    return dict(zip(BRANCH, found.T, strict=True))


def lagged(time_s: Floats, values: Floats, tau_s: float, *, begin: float | None = None) -> Floats:
    """`values` through a first-order lag of time constant tau_s (s), shape (n,), at the first row settled, or `begin`.

    Exact for a value that changes linearly between rows. A single row, or tau_s ≤ 0, gives the values themselves.
    """
    out = np.array(values, dtype=np.float64)
    if tau_s <= 0 or len(out) < 2:
        return out
    step = np.maximum(np.diff(time_s), 0.0)
    ratio = step / tau_s
    decay = np.exp(-ratio)
    gain = np.divide(1.0 - decay, ratio, out=np.ones_like(ratio), where=ratio > 1e-9)
    drive = (1.0 - gain) * out[1:] + (gain - decay) * out[:-1]
    state = float(out[0]) if begin is None else begin
    course = [state]
    for share, step_in in zip(
        decay.tolist(), drive.tolist(), strict=True
    ):  # plain floats: an array's elements are slow
        state = share * state + step_in
        course.append(state)
    return np.array(course)


def through(column: str, tau_s: float) -> str:
    """Name of the column that holds another one as it is now through a lag, where its course is not among the rows."""
    return f"{column} through {tau_s!r} s"


OFTEN_S = 1.0
"""Readings of a sensor are kept at most so often: the bodies of a machine take minutes."""
MOST_KEPT = 20_000
"""Readings kept of a sensor; of the older half of them every second is left out then."""


class Course:
    """What sensors have said so far, so that a correction can read them through a lag while the machine runs."""

    def __init__(self) -> None:
        self._said: dict[str, list[tuple[float, float]]] = {}  # (s, value) by column
        self._taken: dict[
            tuple[str, float], tuple[float, float, float]
        ] = {}  # time and value of a reading, and through the lag

    def note(self, now_s: float, known: Mapping[str, float]) -> None:
        """Take in the columns at a moment of a clock that is never set."""
        for name, value in known.items():
            if not is_temperature(name) or not math.isfinite(value):
                continue
            said = self._said.setdefault(name, [])
            if len(said) > 1 and now_s - said[-2][0] < OFTEN_S:
                said.pop()
            said.append((now_s, value))
            if len(said) > MOST_KEPT:
                del said[1 : MOST_KEPT // 2 : 2]

    def now(self, column: str, tau_s: float) -> float | None:
        """The column through a lag, as `lagged` gives it for the last reading; None where there was none."""
        said = self._said.get(column)
        if not said:
            return None
        since_s, value, state = self._taken.get((column, tau_s), (*said[0], said[0][1]))
        later = [(since_s, value), *said[bisect_right(said, since_s, key=itemgetter(0)) :]]
        time_s, values = np.array(later).T
        course = lagged(time_s, values, tau_s, begin=state)
        if len(later) > 2:  # the last reading may still be replaced
            self._taken[column, tau_s] = (*later[-2], float(course[-2]))
        return float(course[-1])
