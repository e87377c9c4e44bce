"""A rise fitted by where the load is: for each of the motor's travels, the load's travel at which it and the rise make up the motor's.

Over the load's own travel a rise may be so steep that a reading says nothing of its height there (the load sticks while the motor
moves), but the load's place under a rise is always well determined; so that is what is compared with the place measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hil.correction.rise import Floats, Rise

_HALVINGS = 16
"""Of the motor's travel, in which the load's is sought before a straight line finds it."""


@dataclass(frozen=True)
class Reach:
    """How far lengths may go, mm: the shortest and the longest rise, the last onset."""

    shortest_mm: float
    longest_mm: float
    onset_mm: float


@dataclass(frozen=True)
class Places:
    """Where motor and load were, mm since the reversal, and in which stroke; shape (n,) each."""

    motor_mm: Floats
    load_mm: Floats
    stroke: NDArray[np.int64]

    def residual_um(self, rise: Rise) -> Floats:
        """How much further the load was than the rise says, shape (n,)."""
        return 1000.0 * (self.load_mm - load_mm(rise, self.motor_mm))


def load_mm(rise: Rise, motor_mm: Floats) -> Floats:
    """The load's travel at the motor's, shape (n,)."""

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
    """A rise as the numbers that are searched: amounts, µm; rises in their logarithm, as they may be far apart; onsets."""

    def __init__(self, first: Rise, reach: Reach, most_um: float) -> None:
        shape = first.shape
        self._first, self._reach = first, reach
        self._amounts = len(first.amounts_um)
        self.low = np.array(
            [0.0] * self._amounts + [math.log(reach.shortest_mm)] * shape.rises + [0.0] * shape.onsets, dtype=np.float64
        )
        self.high = np.array(
            [most_um] * self._amounts + [math.log(reach.longest_mm)] * shape.rises + [reach.onset_mm] * shape.onsets,
            dtype=np.float64,
        )
        searched = [] if shape.knots else list(first.lengths_mm)
        start = [*first.amounts_um, *np.log(searched[: shape.rises]), *searched[shape.rises :]]
        edge = 1e-6 * (self.high - self.low)
        self.start = np.clip(start, self.low + edge, self.high - edge)
        self.scale = np.array([most_um] * self._amounts + [1.0] * shape.rises + [reach.onset_mm] * shape.onsets)

    def rise(self, values: Floats) -> Rise:
        shape, split = self._first.shape, self._amounts
        if shape.knots:
            lengths = self._first.lengths_mm
        else:
            rises, onsets = np.exp(values[split : split + shape.rises]), values[split + shape.rises :]
            lengths = (*rises.tolist(), *onsets.tolist())
        return Rise(shape, tuple(values[:split].tolist()), lengths)

    def slopes(self, values: Floats, motor_mm: Floats) -> Floats:
        """Of the load's lag, µm, by each value, at the motor's travels: shape (n, values)."""
        rise = self.rise(values)
        place = load_mm(rise, motor_mm)
        h = 1e-2 * self._reach.shortest_mm
        steep = (rise.along_um(place + h) - rise.along_um(np.maximum(place - h, 0.0))) / (2.0 * h)
        columns = [rise.shape.columns(place, rise.lengths_mm)]
        for k in range(self._amounts, len(values)):
            step = np.zeros(len(values))
            step[k] = 1e-4 * self.scale[k]
            more, less = self.rise(values + step), self.rise(np.maximum(values - step, self.low))
            columns.append(((more.along_um(place) - less.along_um(place)) / (2.0 * step[k]))[:, None])
        return np.asarray(np.hstack(columns) / (1.0 + steep / 1000.0)[:, None])

    def free(self, values: Floats) -> NDArray[np.bool_]:
        """Which values are not held by a bound."""
        edge = 1e-4 * (self.high - self.low)
        return np.asarray((values > self.low + edge) & (values < self.high - edge))


def fit_at_load(first: Rise, places: Places, reach: Reach) -> Rise:
    """The rise of this shape that puts the load closest to where it was, searched from one that is near."""
    coordinates = _Coordinates(first, reach, _most_um(places))
    best = least_squares(
        lambda values: places.residual_um(coordinates.rise(values)),
        coordinates.start,
        jac=lambda values: coordinates.slopes(values, places.motor_mm),
        bounds=(coordinates.low, coordinates.high),
        x_scale=coordinates.scale,
        max_nfev=40,
    )
    return coordinates.rise(np.asarray(best.x))


def standard_uncertainties(rise: Rise, places: Places, reach: Reach) -> tuple[float, list[float], list[float]]:
    """Of the whole amount, µm, of each amount, and of each length that was searched, mm.

    By the scatter of whole strokes (the covariance of the fit with strokes as its units), so that what repeats within a stroke counts
    once; a value that a bound holds, or of an amount of nothing, has none (0).
    """
    coordinates = _Coordinates(rise, reach, _most_um(places))
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


def _most_um(places: Places) -> float:
    return 2.0 * 1000.0 * float(np.max(places.motor_mm - places.load_mm)) + 1e-3
