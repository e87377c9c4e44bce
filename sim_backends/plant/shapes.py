"""Smooth random curves along an axis: sums of a few incommensurate waves, seeded.

For errors that depend on the position only (pitch error, guideway angles). Deliberately neither polynomials nor splines, so that
no fitted model reproduces them by being the same formula.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property

Points = tuple[tuple[float, float], ...]
"""A measured curve: places, mm, ascending, and the value at each."""


def between(points: Points, x_mm: float) -> float:
    """A measured curve at x, straight between its points and level beyond them; 0 without any."""
    if not points:
        return 0.0
    after = bisect_left(points, (x_mm,))
    (low_mm, low), (high_mm, high) = points[max(0, after - 1)], points[min(after, len(points) - 1)]
    return low if high_mm == low_mm else low + (high - low) * (x_mm - low_mm) / (high_mm - low_mm)


@dataclass(frozen=True)
class SmoothShape:
    """value(x) = slope·x + Σ a·sin(k·x + φ) + the measured curve − its value at 0; x in mm, value in the unit of the amplitudes."""

    slope_per_mm: float = 0.0
    waves: tuple[tuple[float, float, float], ...] = ()  # (amplitude, wave number in rad/mm, phase in rad)
    points: Points = ()

    @classmethod
    def random(cls, seed: int, peak: float, length_mm: float, *, slope_per_mm: float = 0.0) -> SmoothShape:
        """A shape whose five waves alone deviate by at most `peak` within 0…length; at most 2.5 waves per length."""
        if peak == 0.0:
            return cls(slope_per_mm)
        rng = random.Random(seed)
        raw = []
        for order in range(1, 6):
            cycles = 2.5 * (order - rng.random() * 0.8) / 5
            raw.append((rng.gauss(0.0, 1.0) / order**0.7, math.tau * cycles / length_mm, rng.uniform(0.0, math.tau)))
        unscaled = cls(0.0, tuple(raw))
        largest = max(abs(unscaled.value(length_mm * i / 200)) for i in range(201))
        return cls(slope_per_mm, tuple((a * peak / largest, k, phase) for a, k, phase in raw))

    def value(self, x_mm: float) -> float:
        """The curve at x, in its own unit; 0 at x = 0."""
        total = self.slope_per_mm * x_mm + between(self.points, x_mm) - self._at_zero
        for amplitude, k, phase in self.waves:
            total += amplitude * math.sin(k * x_mm + phase)
        return total

    @cached_property
    def _at_zero(self) -> float:
        return sum(amplitude * math.sin(phase) for amplitude, _, phase in self.waves) + between(self.points, 0.0)
