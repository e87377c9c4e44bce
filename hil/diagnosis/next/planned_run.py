"""A measurement before it is made: its rows, conditions, duration, and the person it needs.

The kinematics of point-to-point moves give travel since a reversal and time before any motion. `feasible` lists runs,
`next_measurement` chooses one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.records.rows import Floats


@dataclass(frozen=True)
class Means:
    """The measuring abilities of an axis and its sensors.

    low_mm, high_mm: outermost targets; feed_mm_s: of positioning; reading_s: at rest for each row; overrun_mm: beyond a
    reversal
    levels: column -> values it can be set to, the usual one first; by_itself: columns that no person has to set
    assumed: columns whose usual level was not recorded, so that the one here is assumed
    sensors: columns that are read already; mountable: sensors and changes of the set-up that a person can be asked for
    feeds_mm_s: feeds at which positions can be captured in motion; empty where the axis is read at rest only
    """

    low_mm: float
    high_mm: float
    feed_mm_s: float = 50.0
    reading_s: float = 3.0
    overrun_mm: float = 1.0
    targets: int = 13
    levels: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    by_itself: frozenset[str] = frozenset()
    assumed: frozenset[str] = frozenset()
    sensors: frozenset[str] = frozenset()
    mountable: frozenset[str] = frozenset({"thermometers", "air", "abbe_offset_mm", "setup"})
    feeds_mm_s: tuple[float, ...] = ()
    pitches_mm: tuple[float, ...] = ()

    @property
    def span_mm(self) -> float:
        """Distance of the outermost targets."""
        return self.high_mm - self.low_mm


@dataclass(frozen=True)
class PlannedPoint:
    """One row to be measured: reached in a direction, after a reversal `overrun_mm` before it where the axis has to
    reverse.

    strokes_s, rest_s: fast strokes, or standstill, just before it; feed_mm_s: of the approach, None: the usual one
    dwell_s: standstill at it before the usual dwell; levels: column -> value it is set to
    """

    run: int
    direction: int
    target_mm: float
    overrun_mm: float
    strokes_s: float = 0.0
    rest_s: float = 0.0
    levels: tuple[tuple[str, float], ...] = ()
    feed_mm_s: float | None = None
    dwell_s: float = 0.0


@dataclass(frozen=True)
class PlannedRun:
    """A measurement that could be made next.

    words: what is to be done, in words and figures; person: what a person must do for it, '' for none
    adds: columns it adds to those of the records; minutes: machine time, with the waiting for a person
    """

    name: str
    words: str
    points: tuple[PlannedPoint, ...]
    minutes: float
    person: str = ""
    adds: tuple[str, ...] = ()

    def describe(self) -> str:
        """One sentence with its figures."""
        who = f"; {self.person}" if self.person else "; the axis can do it alone"
        return f"{self.words} ({len(self.points)} rows, about {math.ceil(self.minutes)} min{who})"


def motion_columns(points: Sequence[PlannedPoint], means: Means, *, start_s: float = 0.0) -> dict[str, Floats]:
    """The columns that follow from the rows alone, each (n,): run, direction, target, time, travel since the reversal,
    stroke, levels.

    The axis reverses only where it must: where it came from the other side, or the target is behind it.
    """
    here, heading, turned_at, stroke, now = means.low_mm, 1, means.low_mm - means.overrun_mm, means.span_mm, start_s
    rows: list[tuple[float, ...]] = []
    for point in points:
        legs = [point.target_mm]
        if (point.target_mm - here) * point.direction <= 0 or heading != point.direction:
            legs = [point.target_mm - point.direction * point.overrun_mm, point.target_mm]
        now += point.strokes_s + point.rest_s
        for stop in legs:
            way = stop - here
            if way:
                if way * heading < 0:
                    stroke, turned_at, heading = abs(here - turned_at), here, -heading
                now += abs(way) / (point.feed_mm_s or means.feed_mm_s)
                here = stop
        now += means.reading_s + point.dwell_s
        rows.append((point.run, point.direction, point.target_mm, now, abs(here - turned_at), stroke, point.strokes_s))
    names = ("run", "direction", "target_mm", "time_s", "since_reversal_mm", "stroke_mm", "strokes_s")
    columns = {
        name: np.array(values, dtype=np.float64) for name, values in zip(names, zip(*rows, strict=True), strict=True)
    }
    for name in dict.fromkeys(name for point in points for name, _ in point.levels):
        columns[name] = np.array([dict(point.levels).get(name, math.nan) for point in points])
    return columns
