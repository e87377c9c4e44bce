"""Lost motion from the whole wind-up, with its uncertainty: where the rising flank of torque would meet the sliding
level.

While the table sticks, motor travel winds up the drive train only, so the torque is a curve of the wind-up. When it has
risen to the level of sliding, the motor's travel since the reversal is the wind-up released and built up again, and
that is the lost motion of the table from then on. The break-away lies above: static friction drives the torque, and its
peak, further than sliding needs. So the peak itself is not used. The upper half of the flank is fitted by a parabola.
The sliding level is the torque after longer moves beyond the peak (or, without them, the mean of the steps there). The
lost motion is where the two meet.

Torque cannot show how far the guideway deflects before it slides, which looks like more wind-up. `HIDDEN_SHARE` and
`HIDDEN_UM` account for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.backlash.trace import ReversalTrace
from hil.records.rows import Floats

Mask = NDArray[np.bool_]
HIDDEN_SHARE = 0.006
"""Standard uncertainty of the part that torque cannot separate from wind-up, as a share of the lost motion."""
HIDDEN_UM, CREEP_HIDDEN_UM = 0.3, 0.45
"""The same as a length, which counts where little is lost, after steps and after a creep, whose sliding level is not that left
at rest: RMS beyond chance below 20 µm on 140 machines drawn at random (seeds from 10000 of `tests/study/backlash_study.py`, whose
page is of others).
Without it the interval held the truth on 31 % of the machines of 5 to 10 µm.
"""
_LOW, _HIGH = (0.0, 0.2, 0.35, 0.5), 0.88
"""Limits of the fitted flank, candidates for the lower one first: 0 where torque is zero, 1 where sliding begins."""
_BEYOND_SHARE, _BEYOND_STEPS = 0.12, 5  # left out beyond the meeting point: peak and drop
_FEWEST_FLANK, _FEWEST_CURVED, _FEWEST_SLIDING, _FEWEST_SLIDES = 4, 9, 10, 4  # places
_STILL_RISING_SHARE = 0.12  # of the flank's slope: steps that still rise more are not sliding
_ROUNDING_VARIANCE = 0.1**2 / 12.0  # 6077h counts in 0.1 % of rated
_F_TEST_LEVEL = 0.01  # significance at which further coefficients are accepted


@dataclass(frozen=True)
class FittedWindUp:
    """Lost motion in µm; u_um its standard uncertainty, of which chance_um comes from noise and averages out over runs.

    level_percent: torque of sliding, % of rated; peak_um, peak_percent: the break-away, largest mean torque, as travel
    and torque
    the flank: torque = Σ coefficients[i]·(travel - centre_um)^i within flank_um
    """

    lost_motion_um: float
    u_um: float
    chance_um: float
    level_percent: float
    peak_um: float
    peak_percent: float
    centre_um: float
    coefficients: tuple[float, ...]
    flank_um: tuple[float, float]

    def flank_percent(self, travel_um: Floats) -> Floats:
        """Torque of the fitted flank at travels in µm, % of rated, shape as given."""
        u = travel_um - self.centre_um
        return np.asarray(sum(c * u**i for i, c in enumerate(self.coefficients)), dtype=np.float64)


@dataclass(frozen=True)
class Polynomial:
    """A polynomial fitted to a flank; covariance of its coefficients from the residual, widened for few points."""

    centre: float
    coefficients: Floats
    covariance: Floats
    rss: float
    freedom: int

    def meets(self, level: float, start_um: float) -> float:
        """Travel at which it reaches a level, by Newton from start_um; NaN where it never does."""
        x = start_um - self.centre
        powers = np.arange(len(self.coefficients))
        for _ in range(30):
            value = float(self.coefficients @ x**powers)
            slope = self.slope(x + self.centre)
            if slope <= 0.0:
                return float("nan")
            step = (level - value) / slope
            x += step
            if abs(step) < 1e-9:
                break
        return x + self.centre

    def slope(self, at_um: float) -> float:
        x = at_um - self.centre
        return float(sum(i * c * x ** (i - 1) for i, c in enumerate(self.coefficients) if i))

    def variance(self, at_um: float) -> float:
        row = (at_um - self.centre) ** np.arange(len(self.coefficients))
        return float(row @ self.covariance @ row)


@dataclass(frozen=True)
class _Flank:
    """A fitted flank, where it meets the sliding level, and the travel it was fitted over."""

    curve: Polynomial
    meet: float
    over_um: tuple[float, float]


def hidden_um(trace: ReversalTrace, lost_motion_um: float) -> float:
    """Standard uncertainty of what does not average out over runs, µm."""
    return float(np.hypot(HIDDEN_SHARE * lost_motion_um, CREEP_HIDDEN_UM if trace.creep_um_s else HIDDEN_UM))


def fit_wind_up(trace: ReversalTrace) -> FittedWindUp | None:
    """The fit of one reversal, None without a flank that ends in sliding."""
    travel, torque = trace.travel_um, trace.rising_percent
    meet = _first_guess(travel, torque)
    for _ in range(8):
        if meet is None:
            return None
        sliding = _sliding(travel, meet)
        if int(sliding.sum()) < _FEWEST_SLIDING:
            return None
        fitted = _flank(travel, torque, meet, _level(trace, sliding))
        if fitted is None or abs(fitted.meet - meet) < 1e-4:
            break
        meet = fitted.meet
    return None if fitted is None else _result(trace, fitted, sliding)


def _level(trace: ReversalTrace, sliding: Mask) -> float:
    """Torque of sliding. Single steps with rests in between stick a little each time, so the longer moves are
    preferred.
    """
    slides = trace.slides_rising_percent
    return float(np.mean(slides if len(slides) >= _FEWEST_SLIDES else trace.rising_percent[sliding]))


def _level_variance(trace: ReversalTrace, sliding: Mask, drift: float) -> float:
    """Variance of that mean; drift: slope of the sliding steps, % per µm."""
    slides = trace.slides_rising_percent
    if len(slides) >= _FEWEST_SLIDES:
        values, trend = slides, 0.0
    else:
        values = trace.rising_percent[sliding]
        trend = drift * float(np.ptp(trace.travel_um[sliding])) / 4.0
    seen = float(values.var(ddof=1))
    averaged = len(values) if seen > _ROUNDING_VARIANCE else 1  # without noise every reading is rounded the same way
    return _student(len(values) - 1) ** 2 * seen / len(values) + _ROUNDING_VARIANCE / averaged + trend**2 / 3.0


def _student(freedom: int) -> float:
    """Ratio of Student's to the normal quantile at 95 %, for a spread estimated with so few degrees of freedom."""
    return float(scipy.special.stdtrit(freedom, 0.975) / scipy.special.ndtri(0.975))


def _first_guess(travel: Floats, torque: Floats) -> float | None:
    """Approximate start of sliding: the first position whose smoothed torque is at the level of the last quarter."""
    tail = max(_FEWEST_SLIDING, len(travel) // 5)
    if len(travel) < tail + 8:
        return None
    level = float(np.median(torque[-tail:]))
    if level < 0.5 * abs(torque[0]) or level <= torque[0]:
        return None  # still in a clearance, or falling
    smooth = np.convolve(np.pad(torque, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    above = np.flatnonzero(smooth >= level - 0.03 * (level - torque[0]))
    return float(travel[above[0]]) if len(above) else None


def _sliding(travel: Floats, meet: float) -> Mask:
    spacing = float(np.median(np.diff(travel)))
    return np.asarray(travel > meet + max(_BEYOND_SHARE * meet, _BEYOND_STEPS * spacing))


def _flank(travel: Floats, torque: Floats, meet: float, level: float) -> _Flank | None:
    """The flank as far down as one smooth curve describes it: from zero torque, or from above a clearance there.

    Positions are chosen by travel and not by torque, so that noise does not affect the choice.
    """
    below = np.flatnonzero((travel < meet) & (torque <= 0.0))
    zero = float(travel[below[-1]]) if len(below) else float(travel[0])
    found = None
    for low in _LOW:
        part = (travel >= zero + low * (meet - zero)) & (travel <= zero + _HIGH * (meet - zero))
        if int(part.sum()) < _FEWEST_FLANK:
            break
        x, y = travel[part], torque[part]
        curved = int(part.sum()) >= _FEWEST_CURVED
        curve = fit_polynomial(x, y, 2 if curved else 1)
        met = curve.meets(level, meet)
        if np.isfinite(met) and x[0] < met < travel[-1]:
            found = _Flank(curve, met, (float(x[0]), float(x[-1])))
            if not curved or not any(explains_more(fit_polynomial(x, y, degree), curve) for degree in (3, 4)):
                break
    return found


def explains_more(more: Polynomial, fewer: Polynomial) -> bool:
    """Whether further coefficients improve the fit significantly (F test)."""
    if more.rss <= 0.0:
        return False
    added = fewer.freedom - more.freedom
    gain = (fewer.rss - more.rss) / added / (more.rss / more.freedom)
    return bool(scipy.special.fdtrc(added, more.freedom, gain) < _F_TEST_LEVEL)


def fit_polynomial(x: Floats, y: Floats, degree: int) -> Polynomial:
    """Least squares over x, y, shape (n,), about the mean of x."""
    centre = float(x.mean())
    rows = np.vander(x - centre, degree + 1, increasing=True)
    coefficients: Floats = np.asarray(np.linalg.lstsq(rows, y, rcond=None)[0], dtype=np.float64)
    rss = float(np.sum((y - rows @ coefficients) ** 2))
    freedom = max(1, len(x) - degree - 1)
    residual = max(_student(freedom) ** 2 * rss / freedom, _ROUNDING_VARIANCE)
    covariance = np.asarray(np.linalg.inv(rows.T @ rows) * residual, dtype=np.float64)
    return Polynomial(centre, coefficients, covariance, rss, freedom)


def _result(trace: ReversalTrace, flank: _Flank, sliding: Mask) -> FittedWindUp | None:
    travel, torque, meet = trace.travel_um, trace.rising_percent, flank.meet
    slope = flank.curve.slope(meet)
    tail = fit_polynomial(travel[sliding], torque[sliding], 1)
    if slope <= 0.0 or tail.slope(meet) > _STILL_RISING_SHARE * slope:
        return None  # it has not broken away
    variance = flank.curve.variance(meet) + _level_variance(trace, sliding, tail.slope(meet))
    chance_um = float(np.sqrt(variance)) / slope
    u_um = float(np.hypot(chance_um, hidden_um(trace, meet)))
    near = (travel > 0.9 * meet) & (travel < 1.2 * meet + _BEYOND_STEPS)
    peak = int(np.argmax(np.where(near, torque, -np.inf)))
    coefficients = tuple(flank.curve.coefficients.tolist())
    return FittedWindUp(
        meet,
        u_um,
        chance_um,
        _level(trace, sliding),
        float(travel[peak]),
        float(torque[peak]),
        flank.curve.centre,
        coefficients,
        flank.over_um,
    )
