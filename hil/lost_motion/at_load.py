"""Fitting a rise to the load's position: for each travel of the motor, the load's travel that together with the rise
makes up the motor's.

Over the load's own travel a rise may be so steep that a reading does not determine its height there (the load sticks
while the motor moves). The load's position under a rise is always well determined, so that is compared with the
measured position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.correction.rise import Rise
from hil.records.rows import Floats

_HALVINGS = 16
"""Bisections of the motor's travel before the final linear interpolation."""


@dataclass(frozen=True)
class LengthBounds:
    """Bounds of the lengths, mm: the shortest and the longest rise, the last onset."""

    shortest_mm: float
    longest_mm: float
    onset_mm: float


@dataclass(frozen=True)
class StrokePositions:
    """Positions of motor and load, mm since the reversal, and the number of the stroke; shape (n,) each."""

    motor_mm: Floats
    load_mm: Floats
    stroke: NDArray[np.int64]

    def residual_um(self, rise: Rise) -> Floats:
        """Measured load position less that of the rise, µm, shape (n,)."""
        return 1000.0 * (self.load_mm - load_mm(rise, self.motor_mm))


def load_mm(rise: Rise, motor_mm: Floats) -> Floats:
    """The load's travel, mm, at the motor's travels, mm, shape (n,)."""

    def beyond_mm(place: Floats) -> Floats:
        return np.asarray(place + rise.along_um(place) / 1000.0 - motor_mm)

    low, high = np.zeros_like(motor_mm), np.maximum(motor_mm, 0.0)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        over = beyond_mm(middle) > 0.0
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    short, past = beyond_mm(low), beyond_mm(high)
    return np.asarray(low + (high - low) * np.clip(-short / np.maximum(past - short, 1e-15), 0.0, 1.0))


class _Coordinates:
    """The search vector of a rise: amounts, µm; logarithms of the rise lengths, which may differ by orders; onsets,
    mm.
    """

    def __init__(self, first: Rise, bounds: LengthBounds, most_um: float) -> None:
        shape = first.shape
        self._first, self._bounds = first, bounds
        self._amounts = len(first.amounts_um)
        self.low = np.array(
            [0.0] * self._amounts + [math.log(bounds.shortest_mm)] * shape.rises + [0.0] * shape.onsets,
            dtype=np.float64,
        )
        self.high = np.array(
            [most_um] * self._amounts + [math.log(bounds.longest_mm)] * shape.rises + [bounds.onset_mm] * shape.onsets,
            dtype=np.float64,
        )
        searched = [] if shape.knots else list(first.lengths_mm)
        start = [*first.amounts_um, *np.log(searched[: shape.rises]), *searched[shape.rises :]]
        edge = 1e-6 * (self.high - self.low)
        self.start = np.clip(start, self.low + edge, self.high - edge)
        self.scale = np.array([most_um] * self._amounts + [1.0] * shape.rises + [bounds.onset_mm] * shape.onsets)

    def rise(self, values: Floats) -> Rise:
        """The rise of a search vector."""
        shape, split = self._first.shape, self._amounts
        if shape.knots:
            lengths = self._first.lengths_mm
        else:
            rises, onsets = np.exp(values[split : split + shape.rises]), values[split + shape.rises :]
            lengths = (*rises.tolist(), *onsets.tolist())
        return Rise(shape, tuple(values[:split].tolist()), lengths)

    def slopes(self, values: Floats, motor_mm: Floats) -> Floats:
        """Derivatives of the load's lag, µm, by each value, at the motor's travels: shape (n, values)."""
        rise = self.rise(values)
        place = load_mm(rise, motor_mm)
        h = 1e-2 * self._bounds.shortest_mm
        steep = (rise.along_um(place + h) - rise.along_um(np.maximum(place - h, 0.0))) / (2.0 * h)
        columns = [rise.shape.columns(place, rise.lengths_mm)]
        for k in range(self._amounts, len(values)):
            step = np.zeros(len(values))
            step[k] = 1e-4 * self.scale[k]
            more, less = self.rise(values + step), self.rise(np.maximum(values - step, self.low))
            columns.append(((more.along_um(place) - less.along_um(place)) / (2.0 * step[k]))[:, None])
        return np.asarray(np.hstack(columns) / (1.0 + steep / 1000.0)[:, None])

    def free(self, values: Floats) -> NDArray[np.bool_]:
        """Which values are not at a bound."""
        edge = 1e-4 * (self.high - self.low)
        return np.asarray((values > self.low + edge) & (values < self.high - edge))


def fit_at_load(first: Rise, places: StrokePositions, bounds: LengthBounds) -> Rise:
    """The rise of this shape with the least squares of the load's position, searched from a rise near it."""
    coordinates = _Coordinates(first, bounds, _most_um(places))
    best = scipy.optimize.least_squares(
        lambda values: places.residual_um(coordinates.rise(values)),
        coordinates.start,
        jac=lambda values: coordinates.slopes(values, places.motor_mm),
        bounds=(coordinates.low, coordinates.high),
        x_scale=coordinates.scale,
        max_nfev=40,
    )
    return coordinates.rise(np.asarray(best.x))


def standard_uncertainties(
    rise: Rise, places: StrokePositions, bounds: LengthBounds
) -> tuple[float, list[float], list[float]]:
    """Standard uncertainties of the whole amount, µm, of each amount, µm, and of each searched length, mm.

    From the scatter of whole strokes (cluster-robust covariance with strokes as clusters), so that errors which repeat
    within a stroke count once. A value at a bound, or the length of an amount of 0, has none (0).
    """
    coordinates = _Coordinates(rise, bounds, _most_um(places))
    values = coordinates.start
    free = coordinates.free(values)
    slopes, residual = coordinates.slopes(values, places.motor_mm)[:, free], places.residual_um(rise)
    strokes = np.unique(places.stroke)
    pulls = np.array([slopes[places.stroke == s].T @ residual[places.stroke == s] for s in strokes])
    inverse = np.linalg.pinv(slopes.T @ slopes)
    among = len(strokes) / max(1, len(strokes) - 1)
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(free, free)] = among * inverse @ (pulls.T @ pulls) @ inverse
    count, rises = len(rise.amounts_um), rise.shape.rises
    amounts = np.sqrt(np.maximum(np.diag(covariance)[:count], 0.0))
    whole = math.sqrt(max(0.0, float(covariance[:count, :count].sum())))
    lengths = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
    lengths[:rises] *= rise.lengths_mm[:rises] if rises else 1.0
    return whole, amounts.tolist(), lengths.tolist()


def _most_um(places: StrokePositions) -> float:
    return 2.0 * 1000.0 * float(np.max(places.motor_mm - places.load_mm)) + 1e-3
