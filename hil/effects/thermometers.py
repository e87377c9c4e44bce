"""The course of a temperature without the noise of its thermometer.

A body of a machine warms up and cools down over minutes; what its thermometer says differs from row to row by some hundredths of a
kelvin. Row by row an axis of a metre with 12 ppm/K makes half a micrometre of them, in the fit and in the correction, and a lag that
only averages the noise fits better than none.

Whittaker's smoother (1923) on the times of the rows: the sum of squared differences to the readings, plus λ times the integral of the
squared slope (a temperature that is a random walk) or of the squared bend (whose slope is one). λ and which of the two by restricted
likelihood.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

Floats = NDArray[np.float64]

TEMPERATURE = re.compile(r"temp_\w+_c")
"""Names of the columns of the machine's temperatures."""
MOST_NOISE_K = 0.05
"""Noise of a reading, standard deviation, up to which it is the thermometer's: a body of a machine does not leap by it between two
rows, and a resolution of a tenth of a kelvin has 0.03 K. Beyond it the readings are taken as they are.
"""
LEAST_NOISE_K = 1e-4
"""Noise below which it does not matter: readings without any would have no likelihood."""
FEWEST = 12
"""Moments below which the noise cannot be told from the course."""
MOST_MOMENTS = 1000
"""Moments of a record at most: readings between are averaged."""
APART = 0.1
"""Part of the mean interval below which two readings are of one moment, which keeps the equations well conditioned."""
STEPS = 16
"""Values of λ tried, in the time over which they smooth: from half the mean interval to a quarter of the record."""


@dataclass(frozen=True)
class _Moments:
    """Readings averaged over moments. time: in mean intervals, ascending; count: readings of each; value: their mean, K; each (m,).

    spread: sum of squares of the readings about their moment's mean, K²
    """

    time: Floats
    count: Floats
    value: Floats
    spread: float

    @classmethod
    def of(cls, time: Floats, reading: Floats) -> _Moments:
        width = max(APART, len(time) / MOST_MOMENTS)
        _, index = np.unique(np.floor((time - time[0]) / width), return_inverse=True)
        count = np.bincount(index).astype(float)
        value = np.bincount(index, reading) / count
        return cls(np.bincount(index, time) / count, count, value, float(np.sum((reading - value[index]) ** 2)))

    def differences(self, order: int) -> Floats:
        """Rows of a matrix, (m - order, order + 1), whose product with values squares to the integral of the squared derivative."""
        h = np.diff(self.time)
        if order == 1:
            return np.column_stack([-1.0 / np.sqrt(h), 1.0 / np.sqrt(h)])
        before, after = h[:-1], h[1:]
        rows = np.column_stack([1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after])
        return np.asarray(rows / np.sqrt((before + after) / 2.0)[:, None])


def without_noise(time_s: Floats, reading_c: Floats) -> Floats:
    """One temperature, °C, (n,), from its readings at times, s, (n,).

    The readings themselves where times do not ascend, where there are too few, or where their noise is more than `MOST_NOISE_K`.
    """
    if len(time_s) < FEWEST or np.any(np.diff(time_s) < 0.0) or time_s[-1] <= time_s[0] or np.ptp(reading_c) == 0.0:
        return reading_c
    time = time_s * ((len(time_s) - 1) / float(time_s[-1] - time_s[0]))
    mean_c = float(np.mean(reading_c))
    moments = _Moments.of(time, reading_c - mean_c)
    m = len(moments.time)
    if m < FEWEST:
        return reading_c
    widths = np.geomspace(0.5, m / 4.0, STEPS) * (len(time) / m)
    tried = (_Course.of(moments, order, width ** (2 * order)) for order in (1, 2) for width in widths.tolist())
    best = max(tried, key=lambda one: one.worth)
    if best.noise_k > MOST_NOISE_K:
        return reading_c
    return np.asarray(mean_c + np.interp(time, moments.time, best.course))


@dataclass(frozen=True)
class _Course:
    """A smooth course of the values. course: (m,); worth: its restricted log-likelihood beside a straight line; noise_k: standard
    deviation of a reading about it, K.
    """

    course: Floats
    worth: float
    noise_k: float

    @classmethod
    def of(cls, moments: _Moments, order: int, stiffness: float) -> _Course:
        """With the squared derivative of an order held small, `stiffness` times against the squared differences to the readings."""
        m, freedom = len(moments.time), float(np.sum(moments.count)) - 2.0
        rows = moments.differences(order)
        matrix = stiffness * _banded(rows, m)
        matrix[-1] += moments.count
        factor = cholesky_banded(matrix)

        def smooth(values: Floats) -> Floats:
            return np.asarray(cho_solve_banded((factor, False), moments.count * values))

        course = smooth(moments.value)
        logs = 2.0 * float(np.sum(np.log(factor[-1]))) - (m - order) * np.log(stiffness) - _log_determinant(rows)
        if order == 1:  # a line has a slope, which the penalty would draw to zero: it is fitted beside the walk
            line = moments.time - np.average(moments.time, weights=moments.count)
            apart = line - smooth(line)
            information = float(line @ (moments.count * apart))
            course = course + apart * (float(moments.value @ (moments.count * apart)) / information)
            logs += np.log(information / float(line @ (moments.count * line)))
        squares = float(moments.value @ (moments.count * (moments.value - course))) + moments.spread
        squares = max(squares, freedom * LEAST_NOISE_K**2)
        return cls(
            course, -0.5 * (freedom * np.log(squares / freedom) + float(logs)), float(np.sqrt(squares / freedom))
        )


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
    return 2.0 * float(np.sum(np.log(cholesky_banded(matrix)[-1])))
