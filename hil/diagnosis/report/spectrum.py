"""The spectrum of a residual over the position, at unevenly spaced targets: amplitudes in µm by period in mm.

At each period a sine is fitted by least squares beside a constant (Lomb 1976, Scargle 1982; with the constant:
Zechmeister & Kürster 2009). The noise level of the highest amplitude is found by permuting the values within each run
many times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.records.rows import Floats

LINES = 1500
OVERSAMPLING = 3.0
SHORTEST_MM = 0.5
ORDERS = 400
"""Permutations."""
EXCEEDED = 0.05
"""Share of the permutations that exceed the noise level."""
ONE_SIDED = 0.2
"""Least determinant of sine and cosine at the targets (0: collinear) at which an amplitude is determined."""
SAME_MM = 0.01


@dataclass(frozen=True)
class Spectrum:
    """Periods descending, (f,), amplitudes there, (f,); level_um: noise level that the highest line exceeds by chance
    in EXCEEDED of all cases.
    """

    period_mm: Floats
    amplitude_um: Floats
    level_um: float

    @property
    def highest(self) -> tuple[float, float]:
        """Period and amplitude of the highest line."""
        top = int(np.argmax(self.amplitude_um))
        return float(self.period_mm[top]), float(self.amplitude_um[top])


def spectrum(target_mm: Floats, residual_um: Floats, run: Floats, seed: int = 0) -> Spectrum | None:
    """The spectrum of rows, each array (n,); None where the targets resolve fewer than two periods."""
    frequency = _frequencies(target_mm)
    if len(frequency) < 2 or len(target_mm) < 8:
        return None
    angle = 2 * np.pi * target_mm[:, None] * frequency
    sine, cosine = (wave - np.mean(wave, axis=0) for wave in (np.sin(angle), np.cos(angle)))
    ss, cc, sc = np.sum(sine**2, axis=0), np.sum(cosine**2, axis=0), np.sum(sine * cosine, axis=0)
    determinant = ss * cc - sc**2
    told = determinant > ONE_SIDED * (0.5 * (ss + cc)) ** 2
    if np.count_nonzero(told) < 2:
        return None
    centred = residual_um - np.mean(residual_um)
    orders = _in_random_order(centred, run, np.random.default_rng(seed))
    y = np.column_stack([centred, orders]).astype(np.float32)
    sy, cy = (wave[:, told].T.astype(np.float32) @ y for wave in (sine, cosine))
    ss, cc, sc, determinant = (each[told, None] for each in (ss, cc, sc, determinant))
    amplitude = np.hypot(cc * sy - sc * cy, ss * cy - sc * sy) / determinant
    level = float(np.quantile(np.max(amplitude[:, 1:], axis=0), 1.0 - EXCEEDED))
    return Spectrum(1.0 / frequency[told], np.asarray(amplitude[:, 0], dtype=np.float64), level)


def _frequencies(target_mm: Floats) -> Floats:
    """Even in frequency, finer than the travel resolves, up to the resolution of the targets, per mm, ascending."""
    places = np.unique(np.round(target_mm / SAME_MM)) * SAME_MM
    travel = float(np.ptp(places))
    if travel <= 0.0:
        return np.zeros(0)
    shortest = SHORTEST_MM
    if 3 * len(places) <= len(target_mm):  # the same targets again and again: nothing is known between them
        shortest = max(shortest, 2.0 * float(np.median(np.diff(places))))
    step = 1.0 / (OVERSAMPLING * travel)
    count = int(min(LINES, (1.0 / shortest - 1.0 / travel) / step + 1.0))
    return np.asarray(1.0 / travel + step * np.arange(max(count, 0)))


def _in_random_order(values: Floats, run: Floats, rng: np.random.Generator) -> Floats:
    """The values (n,) with those of each run permuted ORDERS times, shape (n, ORDERS)."""
    out = np.empty((len(values), ORDERS))
    for number in np.unique(run):
        rows: NDArray[np.int64] = np.flatnonzero(run == number)
        order = np.argsort(rng.random((len(rows), ORDERS)), axis=0)
        out[rows] = values[rows][order]
    return out
