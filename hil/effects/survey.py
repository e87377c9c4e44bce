"""The survey of records: travel, time span, and which columns are there and vary.

It decides which forms of an effect make sense; it holds no statistics of the error itself.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.effects.history import time_column
from hil.effects.thermometers import AIR_TEMPERATURE, TEMPERATURE

Floats = NDArray[np.float64]

OTHER_AXIS = re.compile(r"pos_\w+_mm")
MOST_MOMENTS = 500
"""Most times between rows that are kept as candidates for a step."""
VARIES = 1e-9
"""Smallest relative spread that counts as varying."""
READ_AFTER_MOTION = ("motor_mm", "torque_percent")
"""Columns that are read at the capture: the axis's own answer to a command."""
FOLLOWS = 0.99
"""Share of such a column's variance which the way to the target must explain for it to be no cause of its own: what is left is then
a tenth of its amplitude, the noise of the reading. A torque that changes with the reversals alone is friction: no load was varied, and
what goes with it is lost motion.
"""
REVERSAL_NODES = 6
"""Nodes of the piecewise linear course over the logarithm of the travel since the reversal, in that test."""


@dataclass(frozen=True)
class Survey:
    """Facts of the records.

    centre_mm, half_span_mm: of the targets; spacing_mm: median distance of neighbouring distinct targets of a pass
    time_column, time_start: `time_s`, or `row_order` (in rows) where no time was recorded
    duration_s, interval_s: of the whole campaign, and the median between rows, in units of the time column
    varying: columns that are filled in every row and vary, but for readings that follow the way to the target (`follows_way`);
    mean: the mean of each filled column
    ranges: least and largest value of each filled column
    moments: times between rows at which a step may have occurred: all up to MOST_MOMENTS, run boundaries always
    pitches_mm: periods of the mechanics (screw pitch, rack tooth …), where the axis file gives them
    """

    rows: int
    centre_mm: float
    half_span_mm: float
    spacing_mm: float
    time_column: str
    time_start: float
    duration_s: float
    interval_s: float
    varying: frozenset[str]
    mean: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    moments: tuple[float, ...] = field(default=())
    pitches_mm: tuple[float, ...] = field(default=())

    def has(self, *names: str) -> bool:
        """Whether all the named columns are filled and vary."""
        return all(name in self.varying for name in names)

    @property
    def time_unit(self) -> str:
        """'s', or 'rows' where no time was recorded."""
        return "s" if self.time_column == "time_s" else "rows"

    @property
    def temperatures(self) -> tuple[str, ...]:
        """The temperature columns of the machine (`temp_<place>_c`) that vary."""
        return tuple(sorted(name for name in self.varying if TEMPERATURE.fullmatch(name)))

    @property
    def warmth(self) -> tuple[str, ...]:
        """The temperatures that the machine may follow: its own or, where none was logged, that of the air it stands in."""
        if any(TEMPERATURE.fullmatch(name) for name in self.mean):
            return self.temperatures
        return (AIR_TEMPERATURE,) if self.has(AIR_TEMPERATURE) else ()

    @property
    def other_axes(self) -> tuple[str, ...]:
        """The position columns of other axes (`pos_<axis>_mm`) that vary."""
        return tuple(sorted(name for name in self.varying if OTHER_AXIS.fullmatch(name)))


def survey_of(columns: Mapping[str, Floats], pitches_mm: tuple[float, ...] = ()) -> Survey:
    """Survey of completed columns (`hil.effects.history.complete`), each of shape (n,), n ≥ 1. Raises KeyError without
    `target_mm` or `run`.
    """
    target = columns["target_mm"]
    low, high = float(np.min(target)), float(np.max(target))
    half_span = max((high - low) / 2, 1e-6)
    steps = np.abs(np.diff(target))
    steps = steps[steps > half_span * 1e-4]
    time_name = time_column(columns)
    time = columns[time_name]
    intervals = np.diff(time)
    intervals = intervals[intervals > 0]
    mean: dict[str, float] = {}
    ranges: dict[str, tuple[float, float]] = {}
    varying: set[str] = set()
    for name, values in columns.items():
        if not np.all(np.isfinite(values)):
            continue
        mean[name] = float(np.mean(values))
        ranges[name] = float(np.min(values)), float(np.max(values))
        if varies(values) and not (name in READ_AFTER_MOTION and follows_way(values, columns)):
            varying.add(name)
    return Survey(
        rows=len(target),
        centre_mm=(low + high) / 2,
        half_span_mm=half_span,
        spacing_mm=float(np.median(steps)) if len(steps) else half_span,
        time_column=time_name,
        time_start=float(np.min(time)),
        duration_s=max(float(np.max(time) - np.min(time)), 1e-6),
        interval_s=float(np.median(intervals)) if len(intervals) else 1.0,
        varying=frozenset(varying),
        mean=mean,
        ranges=ranges,
        moments=_moments(time, columns["run"]),
        pitches_mm=pitches_mm,
    )


def varies(values: Floats) -> bool:
    """Whether a column, shape (n,), is filled in every row and not constant."""
    if not np.all(np.isfinite(values)):
        return False
    return bool(np.ptp(values) > VARIES * max(1.0, float(np.max(np.abs(values)))))


def follows_way(values: Floats, columns: Mapping[str, Floats]) -> bool:
    """Whether a reading, (n,), is a function of target, direction and travel since the reversal, but for `FOLLOWS`."""
    d, since = columns["direction"], np.log(np.maximum(columns["since_reversal_mm"], 1e-3))
    nodes = np.linspace(float(np.min(since)), float(np.max(since)) + 1e-9, REVERSAL_NODES)
    course = np.column_stack([np.interp(since, nodes, row) for row in np.eye(REVERSAL_NODES)])
    way = np.hstack([columns["target_mm"][:, None], course, course * d[:, None]])
    if len(values) <= way.shape[1]:
        return False
    rest = values - way @ np.linalg.lstsq(way, values, rcond=None)[0]
    left, whole = float(np.sum(rest**2)) / (len(values) - way.shape[1]), float(np.var(values))
    return bool(left < (1.0 - FOLLOWS) * whole)


def _moments(time: Floats, run: Floats) -> tuple[float, ...]:
    later = np.flatnonzero(np.diff(time) > 0)
    if len(later) > MOST_MOMENTS:
        thinned = later[:: -(-len(later) // MOST_MOMENTS)]
        later = np.union1d(thinned, later[np.diff(run)[later] != 0])
    return tuple(float(value) for value in (time[later] + time[later + 1]) / 2)
