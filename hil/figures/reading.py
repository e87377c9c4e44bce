"""One position from many readings at rest: outliers, mean and its uncertainty, and whether the axis still creeps. No
I/O.

The rules, in the words of a report:

Outliers: a reading further than 6 · (1 + 8/n) robust standard deviations (1.4826 × the median distance from the median)
from the median of the n is left out, from 10 readings on; a window of which more than a tenth (and more than two) would
be left out is refused as a whole. Of normal readings one window in a thousand loses one.

Uncertainty: the standard deviation of the mean is s/√n · √((1+ρ)/(1−ρ)), ρ the correlation of neighbouring readings
where it is positive: readings taken faster than the air changes are not that many independent ones.

At rest: the straight line through a window changes over it by no more than a tolerance, beyond twice its own
uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.errors import MeasurementLostError
from hil.records.rows import UM_PER_MM, Floats

OUTLIER_STD, FEW = 6.0, 8.0
"""In few readings the median distance may be small by chance, so the limit is wider there."""
RULE_FROM = 10
"""Fewest readings to which the outlier rule applies."""
LEFT_OUT_AT_MOST = 0.1
"""Largest share of outliers in a window that is not refused."""
RULE = "readings beyond 6 (1 + 8/n) robust standard deviations from the median of n are left out"


@dataclass(frozen=True)
class Average:
    """The result of a window of readings.

    std_um: of one reading; mean_std_um: of the mean, both NaN of a single reading; count: readings used; left_out:
    outliers
    """

    position_mm: float
    std_um: float
    mean_std_um: float
    count: int
    left_out: int


def average(position_mm: Floats) -> Average:
    """Mean of readings at rest, mm, shape (n,), in the order of time, n ≥ 1.

    Raises MeasurementLostError for a window with too many outliers: the signal is unsteady then.
    """
    kept = position_mm[~outliers(position_mm)]
    left_out = len(position_mm) - len(kept)
    if left_out > max(2.0, LEFT_OUT_AT_MOST * len(position_mm)):
        raise MeasurementLostError(f"{left_out} of {len(position_mm)} readings stand apart: the signal is not steady")
    if len(kept) < 2:
        return Average(float(kept.mean()), math.nan, math.nan, len(kept), left_out)
    std_um = float(kept.std(ddof=1)) * UM_PER_MM
    mean_std_um = std_um / math.sqrt(len(kept)) * math.sqrt(_inflation(kept))
    return Average(float(kept.mean()), std_um, mean_std_um, len(kept), left_out)


def outliers(position_mm: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Which readings the rule leaves out, shape (n,).

    Where more than half of them are the same number, as of a coarse display, the mean distance replaces the median one.
    """
    distance = np.abs(position_mm - np.median(position_mm))
    if len(position_mm) < RULE_FROM:
        return np.zeros(len(position_mm), dtype=np.bool_)
    spread = 1.4826 * float(np.median(distance)) or 1.2533 * float(np.mean(distance))
    limit = OUTLIER_STD * (1.0 + FEW / len(position_mm))
    return np.asarray(distance > limit * spread, dtype=np.bool_)


def _inflation(position_mm: Floats) -> float:
    """Factor by which correlation of neighbours widens the variance of their mean, at least 1."""
    deviation = position_mm - position_mm.mean()
    total = float(deviation @ deviation)
    n = len(position_mm)
    if total == 0.0 or n < 4:
        return 1.0
    rho = float(deviation[1:] @ deviation[:-1]) / total + 1.0 / n  # the estimate is short by about 1/n
    rho = min(max(rho, 0.0), 1.0 - 2.0 / n)
    return (1.0 + rho) / (1.0 - rho)


@dataclass(frozen=True)
class WindowCreep:
    """Change of the straight line over a window, and its standard deviation."""

    change_um: float
    std_um: float

    def within(self, tolerance_um: float) -> bool:
        """At rest: the change is within the tolerance plus two standard deviations."""
        return abs(self.change_um) <= tolerance_um + 2.0 * self.std_um


def creep(time_s: Floats, position_mm: Floats) -> WindowCreep:
    """Of positions (mm) at times (s), both shape (n,). Fewer than four readings, or all at one time, give infinite
    uncertainty.
    """
    spread = time_s - time_s.mean() if len(time_s) else time_s
    if len(time_s) < 4 or not np.any(spread):
        return WindowCreep(0.0, math.inf)
    kept = ~outliers(position_mm)
    time, position = time_s[kept], position_mm[kept] * UM_PER_MM
    time = time - time.mean()
    sum_of_squares = float(time @ time)
    slope = float(time @ position) / sum_of_squares
    residual = position - position.mean() - slope * time
    span = float(np.ptp(time))
    std = math.sqrt(float(residual @ residual) / (len(time) - 2) / sum_of_squares) * span
    return WindowCreep(slope * span, std)
