"""The course of a temperature, or of the air, without the noise of its sensor.

A body of a machine warms up and cools down over minutes; what its thermometer says differs from row to row by some hundredths of a
kelvin. Read row by row, these move the correction of an axis of a metre with 12 ppm/K by half a micrometre; and in a fit a lag that
only averages them is better than none. Of the air, 0.02 K and 0.05 hPa of noise are 0.07 µm on a dead path of three metres, and
a reading that wanders then fits better.

Whittaker's smoother (1923) on the times of the rows: the sum of squared differences to the readings, plus λ times the integral of the
squared slope (a temperature that is a random walk) or of the squared bend (whose slope is one). λ and which of the two by restricted
likelihood.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TEMPERATURE = re.compile(r"temp_\w+_c")
"""Names of the columns of the machine's temperatures."""
AIR_TEMPERATURE = "air_temp_c"
AIR = {AIR_TEMPERATURE: 0.05, "air_pressure_hpa": 0.06, "air_humidity_percent": 0.5}
"""Noise of a sensor of the air, in its unit, up to which it is the sensor's: a resolution of 0.2 hPa has 0.06. What the air does
from row to row within it is lost: on a dead path of a metre 0.05 µm by the temperature and 0.02 µm by the pressure. A thermometer
does not tell the whole path that fast, a barometer would.
"""
MOST_NOISE_K = 0.05
"""Noise of a reading, standard deviation, up to which it is the thermometer's: a body of a machine does not leap by it between two
rows, and a resolution of a tenth of a kelvin has 0.03 K. Beyond it the readings are taken as they are.
"""
LEAST_NOISE = 1e-4
"""Noise below which it does not matter, in the unit of the readings: without any they would have no likelihood."""
FARTHEST = 6.0
"""Largest difference of a reading to the course, in standard deviations of the noise: beyond it something else happened, and the
readings are taken as they are.
"""
SPAN = 3.0
"""Span of the course in standard deviations of the noise, from which it is known: a smaller one is little more than a line through the
noise, which any drift would follow.
"""
FEWEST = 12
"""Moments below which the noise cannot be told from the course."""
MOST_MOMENTS = 1000
"""About as many moments are smoothed: readings between are averaged."""
APART = 0.25
"""Part of the median interval below which two readings are of one moment, which keeps the equations well conditioned."""
PAUSE = 3.0
"""Intervals between two moments from which they are not averaged."""
RESOLVED = 2.5
"""Median change from one reading to the next, in the smallest one, from which equal readings are one that was held, and not rounded
alike.
"""
KEPT, MOST_ROWS_KEPT = 24, 20_000
"""Courses that are kept, and rows up to which they are: a diagnosis completes the same columns some forty times, a machine has nine
such sensors or so. 24 bytes a row: 12 MB at most.
"""
STEPS = 16
"""Values of λ tried, in the time over which they smooth: from half an interval to a quarter of the record."""


def is_temperature(column: str) -> bool:
    """Whether a column is a temperature of the machine or of the air."""
    return column == AIR_TEMPERATURE or TEMPERATURE.fullmatch(column) is not None


def most_noise(column: str) -> float | None:
    """Noise of a column's sensor up to which its readings are smoothed, in the unit of the column; None for one that is not."""
    return MOST_NOISE_K if TEMPERATURE.fullmatch(column) else AIR.get(column)


def without_noise(time_s: Floats, reading: Floats, most: float = MOST_NOISE_K) -> Floats:
    """One temperature, °C, or another slow quantity, (n,), from its readings at times, s, (n,); where a clock begins anew, each
    stretch by itself.

    The readings themselves where there are too few, or where their noise is more than `most` or than the course spans.
    """
    time, value = (np.ascontiguousarray(one, np.float64) for one in (time_s, reading))
    if len(time) > MOST_ROWS_KEPT:
        return _of_stretches(time, value, most)
    return _known(time.tobytes(), value.tobytes(), most)


@lru_cache(maxsize=KEPT)
def _known(times_s: bytes, readings: bytes, most: float) -> Floats:
    """The same of arrays' bytes, made once for the same readings."""
    return _of_stretches(np.frombuffer(times_s), np.frombuffer(readings), most)


def _of_stretches(time_s: Floats, reading: Floats, most: float) -> Floats:
    """The same of each stretch of a clock by itself, and for reading only, since it may be kept."""
    begins = np.flatnonzero(np.diff(time_s) < 0.0) + 1
    parts = zip(np.split(time_s, begins), np.split(reading, begins), strict=True)
    course = np.concatenate([_without_noise(*part, most) for part in parts])
    course.flags.writeable = False
    return course


def _without_noise(time_s: Floats, reading: Floats, most: float) -> Floats:
    """The same of ascending times."""
    intervals = np.diff(time_s)
    if len(time_s) < FEWEST or not np.any(intervals > 0.0) or np.ptp(reading) == 0.0:
        return reading
    time = (time_s - time_s[0]) / float(np.median(intervals[intervals > 0.0]))
    mean = float(np.mean(reading))
    moments = _Moments.of(*_readings(time, reading - mean))
    if len(moments.time) < FEWEST:
        return reading
    best = max(_tried(moments), key=lambda one: one.worth, default=None)
    if best is None or best.noise > most or float(np.ptp(best.course)) < SPAN * best.noise:
        return reading
    course = mean + _straight_between(time, moments.time, best.course)
    off = np.abs(best.course - moments.value) * np.sqrt(moments.count)
    return course if float(np.max(off)) <= FARTHEST * max(best.noise, LEAST_NOISE) else reading


def _readings(time: Floats, reading: Floats) -> tuple[Floats, Floats]:
    """Readings with their times; one that was held over several rows once, at their mean time."""
    changes = np.abs(np.diff(reading))
    changes = changes[changes > 0.0]
    if float(np.median(changes)) < RESOLVED * float(np.min(changes)):
        return time, reading
    index = np.concatenate([[0], np.cumsum(np.diff(reading) != 0.0)])
    return np.bincount(index, time) / np.bincount(index), reading[
        np.concatenate([[0], np.flatnonzero(np.diff(index)) + 1])
    ]


@dataclass(frozen=True)
class _Moments:
    """Readings averaged over moments. time: in median intervals, ascending; count: readings of each; value: their mean; each (m,).

    spread: sum of squares of the readings about a straight course through their moment
    """

    time: Floats
    count: Floats
    value: Floats
    spread: float

    @classmethod
    def of(cls, time: Floats, reading: Floats) -> _Moments:
        bins, index = np.unique(np.round(time / APART), return_inverse=True)
        at = np.bincount(index, time) / np.bincount(index)
        at = np.clip(at, APART * (bins - 0.25), APART * (bins + 0.25))  # two that lie together across a border
        together = -(-len(at) // MOST_MOMENTS)
        if together > 1:
            piece = np.concatenate([[0], np.cumsum(np.diff(at) > PAUSE * together)])
            place = np.arange(len(at)) - np.searchsorted(piece, piece)
            _, group = np.unique(piece * len(at) + place // together, return_inverse=True)
            index = group[index]
            at = np.bincount(index, time) / np.bincount(index)
        count = np.bincount(index).astype(float)
        value = np.bincount(index, reading) / count
        slope = np.gradient(value, at) if len(at) > 1 else np.zeros(1)
        off = reading - value[index] - slope[index] * (time - at[index])
        return cls(at, count, value, float(np.sum(off**2)))

    def differences(self, order: int) -> Floats:
        """Rows of a matrix, (m - order, order + 1), whose product with values squares to the integral of the squared derivative."""
        h = np.diff(self.time)
        if order == 1:
            return np.column_stack([-1.0 / np.sqrt(h), 1.0 / np.sqrt(h)])
        before, after = h[:-1], h[1:]
        rows = np.column_stack([1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after])
        return np.asarray(rows / np.sqrt((before + after) / 2.0)[:, None])


@dataclass(frozen=True)
class _Course:
    """A smooth course of the values. course: (m,); worth: its restricted log-likelihood beside a straight line; noise: standard
    deviation of a reading about it.
    """

    course: Floats
    worth: float
    noise: float

    @classmethod
    def tried(cls, moments: _Moments, order: int, stiffness: Floats) -> Iterator[_Course]:
        """With the squared derivative of an order held small, `stiffness` times, (s,), against the squared differences to the
        readings; without those beside which rounding hides the readings.
        """
        m, freedom = len(moments.time), float(np.sum(moments.count)) - 2.0
        rows = moments.differences(order)
        matrix = _banded(rows, m)[None] * stiffness[:, None, None]
        matrix[:, -1] += moments.count
        factor = _Factor.of(matrix)
        course = factor.solve(moments.count * moments.value)
        logs = factor.log_determinant - (m - order) * np.log(stiffness) - _log_determinant(rows)
        if order == 1:  # a line has a slope, which the penalty would draw to zero: it is fitted beside the walk
            line = moments.time - np.average(moments.time, weights=moments.count)
            apart = line - factor.solve(moments.count * line)
            information = apart @ (moments.count * line)
            course = course + apart * ((apart @ (moments.count * moments.value)) / information)[:, None]
            logs = logs + np.log(information / float(line @ (moments.count * line)))
        squares = (moments.value - course) @ (moments.count * moments.value) + moments.spread
        squares = np.maximum(squares, freedom * LEAST_NOISE**2)
        worth = -0.5 * (freedom * np.log(squares / freedom) + logs)
        for i in np.flatnonzero(factor.is_definite & np.isfinite(worth)):
            yield cls(course[i], float(worth[i]), float(np.sqrt(squares[i] / freedom)))


def _tried(moments: _Moments) -> Iterator[_Course]:
    widths = np.geomspace(0.5, float(np.sum(moments.count)) / 4.0, STEPS)
    with np.errstate(all="ignore"):  # of matrices that are not definite
        for order in (1, 2):
            yield from _Course.tried(moments, order, widths ** (2 * order))


def _straight_between(time: Floats, moments: Floats, course: Floats) -> Floats:
    """The course at some times: straight between the moments, and beyond them."""
    found = np.interp(time, moments, course)
    for beyond, at, inner in ((time < moments[0], 0, 1), (time > moments[-1], -1, -2)):
        slope = (course[inner] - course[at]) / (moments[inner] - moments[at])
        found[beyond] = course[at] + slope * (time[beyond] - moments[at])
    return np.asarray(found)


def _banded(rows: Floats, size: int) -> Floats:
    """DᵀD of a matrix D whose row i holds rows[i] from column i on, in the upper banded form of LAPACK."""
    width = rows.shape[1]
    found = np.zeros((width, size))
    for i in range(width):
        for j in range(i, width):
            found[width - 1 - (j - i), j : j + len(rows)] += rows[:, i] * rows[:, j]
    return found


def _log_determinant(rows: Floats) -> float:
    """log |D·Dᵀ| of a matrix D whose row i holds rows[i] from column i on."""
    count, width = rows.shape
    matrix = np.zeros((width, count))
    for apart in range(min(width, count)):
        here, there = rows[: count - apart, apart:], rows[apart:, : width - apart]
        matrix[width - 1 - apart, apart:] = np.sum(here * there, axis=1)
    return float(_Factor.of(matrix[None]).log_determinant[0])


@dataclass(frozen=True)
class _Factor:
    """L·D·Lᵀ of s symmetric matrices of one band. below: of L, by row and distance from the diagonal, (m, w, s); diagonal: (m, s)."""

    below: Floats
    diagonal: Floats

    @classmethod
    def of(cls, band: Floats) -> _Factor:
        """band: in the upper banded form of LAPACK, (s, w + 1, m)."""
        width, m = band.shape[1] - 1, band.shape[2]
        rows = np.ascontiguousarray(band.transpose(2, 1, 0))
        below, diagonal = np.zeros((m, width, len(band))), np.zeros((m, len(band)))
        for j in range(m):
            near = min(width, j)
            left = rows[j, width - near : width].copy()  # of columns j - near … j - 1
            for i in range(near):
                column = j - near + i
                for k in range(i):
                    if i - k <= width:
                        left[i] -= left[k] * below[column, i - k - 1]
            d = rows[j, width].copy()
            for i in range(near):
                share = left[i] / diagonal[j - near + i]
                d -= share * left[i]
                below[j, near - i - 1] = share
            diagonal[j] = d
        return cls(below, diagonal)

    @property
    def is_definite(self) -> NDArray[np.bool_]:
        return np.asarray(np.all(self.diagonal > 0.0, axis=0))

    @property
    def log_determinant(self) -> Floats:
        return np.asarray(np.sum(np.log(self.diagonal), axis=0))

    def solve(self, right: Floats) -> Floats:
        """Solutions of the matrices, (s, m), for a right side (m,)."""
        m, width, _ = self.below.shape
        y = np.repeat(right[:, None], self.diagonal.shape[1], axis=1)
        for j in range(1, m):
            for i in range(min(width, j)):
                y[j] -= self.below[j, i] * y[j - i - 1]
        y /= self.diagonal
        for j in range(m - 1, 0, -1):
            for i in range(min(width, j)):
                y[j - i - 1] -= self.below[j, i] * y[j]
        return np.asarray(y.T)
