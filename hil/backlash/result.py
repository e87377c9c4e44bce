"""The result of a measurement of lost motion by torque: both estimates of every reversal, their means, and the
uncertainty.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
import scipy

from hil.backlash.neutral_settings import SettingsBefore
from hil.backlash.torque_fit import FittedWindUp, fit_wind_up, hidden_um
from hil.backlash.trace import ReversalTrace

_NORMAL = NormalDist().inv_cdf(0.975)

NAMES = {-1: "+ → −", 1: "− → +"}
"""Names of the two reversals, by the direction after them."""
BOTH = tuple(NAMES)


@dataclass(frozen=True)
class Reversal:
    """One measured reversal with both estimates; None: no peak, or no wind-up that ends in sliding."""

    run: int
    trace: ReversalTrace
    published_um: float | None
    fitted: FittedWindUp | None

    @classmethod
    def of(cls, run: int, trace: ReversalTrace) -> Reversal:
        """Both estimates of a trace."""
        return cls(run, trace, four_sample(trace), fit_wind_up(trace))

    def lost_motion_um(self, method: str) -> float | None:
        """The estimate by "fitted" or "four-sample", µm."""
        if method == "four-sample":
            return self.published_um
        return None if self.fitted is None else self.fitted.lost_motion_um


@dataclass(frozen=True)
class MeanLostMotion:
    """A mean over reversals and its uncertainty: mean ± u95 with 95 % confidence."""

    mean_um: float
    u95_um: float


def mean_um(reversals: Sequence[Reversal], method: str, directions: Sequence[int] = BOTH) -> float | None:
    """Mean of these directions' means, µm. None where a direction was not measured, or a reversal of it has no value."""
    means = [_mean([one.lost_motion_um(method) for one in _into(reversals, direction)]) for direction in directions]
    return _mean(means)


def _into(reversals: Sequence[Reversal], direction: int) -> list[Reversal]:
    return [one for one in reversals if one.trace.direction == direction]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known and len(known) == len(values) else None


def fitted_lost_motion(reversals: Sequence[Reversal], directions: Sequence[int] = BOTH) -> MeanLostMotion | None:
    """Mean of these directions by the fitted curve, with its uncertainty at 95 %; None where a fit is missing.

    The random part is that of the fits, or the scatter of the runs of one direction where that is larger;
    `hidden_um` does not average out.
    """
    mean = mean_um(reversals, "fitted", directions)
    if mean is None:
        return None
    variance = sum(_chance_variance(reversals, direction) for direction in directions) / len(directions) ** 2
    u_um = math.hypot(
        math.sqrt(variance), max(hidden_um(one.trace, mean) for each in directions for one in _into(reversals, each))
    )
    return MeanLostMotion(mean, _NORMAL * u_um)


def _chance_variance(reversals: Sequence[Reversal], direction: int) -> float:
    """Random variance of one direction's mean, µm²."""
    fits = [one.fitted for one in reversals if one.trace.direction == direction and one.fitted is not None]
    stated = sum(fit.chance_um**2 for fit in fits) / len(fits) ** 2
    if len(fits) < 2:
        return stated
    values = np.array([fit.lost_motion_um for fit in fits])
    student = float(scipy.special.stdtrit(len(fits) - 1, 0.975) / _NORMAL)
    seen = student**2 * float(values.var(ddof=1)) / len(fits)
    return max(stated, seen)


def reversal_json(one: Reversal) -> dict[str, Any]:
    """Plain values of one reversal, without its trace."""
    fit = one.fitted
    return {
        "run": one.run,
        "reversal": NAMES[one.trace.direction],
        "direction": one.trace.direction,
        "steps": len(one.trace.position_load_mm) - 1,
        "four_sample_um": one.published_um,
        "fitted_um": None if fit is None else fit.lost_motion_um,
        "fitted_u95_um": None if fit is None else _NORMAL * fit.u_um,
        "break_away_um": None if fit is None else fit.peak_um,
        "break_away_percent": None if fit is None else fit.peak_percent,
        "sliding_percent": None if fit is None else fit.level_percent,
    }


@dataclass(frozen=True)
class TorqueBacklash:
    """What was measured. found: the parameters before; written: the amount written; reversals: in the order of time."""

    reversals: tuple[Reversal, ...]
    method: str
    directions: tuple[int, ...]
    found: SettingsBefore
    written: float | None = None

    @property
    def lost_motion_um(self) -> float | None:
        """Mean over the directions measured, by the chosen method; None where the detection limit was exceeded."""
        return mean_um(self.reversals, self.method, self.directions)

    @property
    def exceeded(self) -> Reversal | None:
        """The reversal without a peak within the allowed steps, if any."""
        return next((one for one in self.reversals if one.lost_motion_um(self.method) is None), None)

    @property
    def fitted(self) -> MeanLostMotion | None:
        """Mean over the directions measured, by the fitted curve; None where a fit is missing."""
        return fitted_lost_motion(self.reversals, self.directions)

    @property
    def by_rule_um(self) -> float | None:
        """Mean over the directions measured, by the rule of four samples."""
        return mean_um(self.reversals, "four-sample", self.directions)

    @property
    def by_direction_um(self) -> dict[int, float | None]:
        """Mean of each direction measured, by the chosen method."""
        return {each: mean_um(self.reversals, self.method, [each]) for each in self.directions}


def first_peak_um(distances_um: Iterable[float], torques_percent: Iterable[float]) -> float | None:
    """The published rule (CN103561904): the distance at the first peak of |torque|, of one torque for each step; None without a peak.

    Of the torques T at steps n-3 … n the peak is at n-1 when T(n-2) >= T(n-3), T(n-1) >= T(n-2) and T(n) < T(n-1). Kept as
    published, as the reference for the fitted curve: noise triggers it easily.
    """
    last: deque[tuple[float, float]] = deque(maxlen=4)
    for distance_um, torque in zip(distances_um, torques_percent, strict=True):
        last.append((distance_um, abs(torque)))
        if len(last) == 4:
            (_, t3), (_, t2), (peak_um, t1), (_, t0) = last
            if t2 >= t3 and t1 >= t2 and t0 < t1:
                return peak_um
    return None


def four_sample(trace: ReversalTrace) -> float | None:
    """Lost motion in µm by the published rule, from the first reading of each step."""
    return first_peak_um(trace.travel_um.tolist(), trace.torque_percent[:, 0].tolist())
