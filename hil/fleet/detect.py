"""Ageing in one series of values, found at a stated rate of false alarms.

Level and noise of an axis are not known before. Each value is held against the mean and scatter of the values before
it (Hawkins, "Self-starting CUSUM charts for location and scale", The Statistician 36, 1987): in a series without ageing
T = (x − mean)/s · √(n/(n + 1)) has Student's distribution with n − 1 degrees of freedom, whatever level and noise
are, and its normal score is standard normal and independent of the scores before. So the run length of a CUSUM of
the scores is that of a CUSUM with known level and noise, which is computed (`arl`, Brook and Evans, Biometrika 59,
1972) and not estimated.

The scores hold where values scatter independently about one level and normally. Other courses, such as a season's,
are not that: `memory` tells how far values follow those before them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.records.rows import Floats

REFERENCE = 0.5
"""Reference value k of the CUSUM, in standard deviations: best for a step of one. Growth of 0.2 to 0.5 standard
deviations a measurement is found within 1.2 of the mean time of the best of 0.25, 0.5, 0.75 and 1
(`python tests/study/fleet_trend.py`)."""
CLIP = 3.0
"""Largest score, in standard deviations: one wrong measurement adds at most CLIP − k and is no alarm by itself. 3 as
in Hawkins and Olwell, "Cumulative sum charts and charting for quality improvement", 1998, 7.3."""
LOWEST = 1.0
"""Lowest threshold, in standard deviations: a run length of about 10."""
_STATES = 200
"""Intervals of the Markov chain. With 400 the run lengths of the published tables differ by less than 0.01 %."""
SURER = 100.0
"""How much longer a CUSUM without ageing runs to a false improvement than to a false alarm. With 1, every second false
improvement was followed by a false alarm, 20 % more in all (`python tests/study/fleet_trend.py`)."""
LEAST = 3
"""Values before which there is no score: two give the scatter that the third is held against."""


def arl(threshold: float, reference: float = REFERENCE, clip: float = math.inf) -> float:
    """Average number of values without ageing until a one-sided CUSUM of standard normal scores reaches `threshold`.

    reference: k; clip: scores beyond ±clip count as ±clip. By the Markov chain of Brook and Evans (1972).
    """
    width = 2.0 * threshold / (2 * _STATES - 1)
    step = np.arange(-_STATES, _STATES)
    within = _below((step + 0.5) * width + reference, clip)
    to = np.arange(_STATES)[None, :] - np.arange(_STATES)[:, None] + _STATES
    move = within[to] - within[to - 1]
    move[:, 0] = within[to[:, 0]]  # everything below goes to the lowest state
    return float(np.linalg.solve(np.eye(_STATES) - move, np.ones(_STATES))[0])


def _below(score: NDArray[Any], clip: float) -> Floats:
    return np.asarray(
        np.where(score >= clip, 1.0, np.where(score < -clip, 0.0, scipy.special.ndtr(score))), dtype=np.float64
    )


@lru_cache(maxsize=64)
def threshold_for(run_length: float, reference: float = REFERENCE, clip: float = CLIP) -> float:
    """Threshold at which a one-sided CUSUM without ageing runs `run_length` values on the average, at least
    `LOWEST`."""

    def beyond(threshold: float) -> float:
        return math.log(arl(threshold, reference, clip) / run_length)

    if beyond(LOWEST) >= 0.0:
        return LOWEST
    high = 2.0 * LOWEST
    while beyond(high) < 0.0:
        high *= 1.5
    return float(scipy.optimize.brentq(beyond, LOWEST, high, xtol=1e-4))


def scores(values: Floats, floor: Floats | None = None) -> Floats:
    """Normal scores of values, shape (n,), each against those before it; NaN for the first `LEAST` − 1.

    floor: standard uncertainty that each value's own repeats show, shape (n,), NaN for none: the scatter is not
    taken below it. A clipped value counts among those before the next as the largest that is not clipped.
    """
    found = np.full(len(values), np.nan)
    mean, squares = 0.0, 0.0
    least = np.zeros(len(values)) if floor is None else np.nan_to_num(floor)
    beyond = float(scipy.special.ndtr(CLIP))
    for n, value in enumerate(values.tolist()):
        if n >= LEAST - 1:
            s = max(math.sqrt(squares / (n - 1)), float(least[n])) * math.sqrt((n + 1) / n)
            away = value - mean
            if s == 0.0:
                score = math.copysign(CLIP, away) if away else 0.0
            else:
                score = math.copysign(-float(scipy.special.ndtri(scipy.special.stdtr(n - 1, -abs(away) / s))), away)
            if abs(score) > CLIP:
                score = math.copysign(CLIP, away)
                value = mean + math.copysign(min(abs(away), s * float(scipy.special.stdtrit(n - 1, beyond))), away)  # noqa: PLW2901
            found[n] = score
        away = value - mean
        mean += away / (n + 1)
        squares += away * (value - mean)
    return found


def cusum(score: Floats, reference: float = REFERENCE) -> Floats:
    """One-sided CUSUM upwards of scores, shape (n,); a NaN adds nothing."""
    found, sum_ = np.empty(len(score)), 0.0
    for at, one in enumerate(score.tolist()):
        sum_ = sum_ if math.isnan(one) else max(0.0, sum_ + one - reference)
        found[at] = sum_
    return found


@dataclass(frozen=True)
class Alarm:
    """Indices of values: at which the threshold was reached, the first that counted towards it, and the last of this
    alarm, None while it stands. upwards: whether the values rose"""

    at: int
    onset: int
    until: int | None
    upwards: bool


@dataclass(frozen=True)
class Watched:
    """A watched series. score, up, down: shape (n,), the scores and the CUSUMs up and down; begun: index of the
    first value since the last improvement, from which the axis is measured against itself; threshold: of both CUSUMs
    """

    score: Floats
    up: Floats
    down: Floats
    begun: int
    threshold: float
    alarms: tuple[Alarm, ...]

    @property
    def standing(self) -> Alarm | None:
        """The last alarm, where it stands and the axis has not become better since."""
        last = self.alarms[-1] if self.alarms else None
        return last if last is not None and last.until is None and last.at >= self.begun else None

    def nearness(self, *, either: bool) -> float:
        """The CUSUM at the last value as a share of the threshold; either: of the larger of both."""
        return float(max(self.up[-1], self.down[-1] if either else 0.0)) / self.threshold


def watch(
    values: Floats, threshold: float, floor: Floats | None = None, *, either: bool = False, better_at: float = math.inf
) -> Watched:
    """Watch a series, shape (n,), n ≥ 1, in the order of time.

    either: a fall is an alarm too; better_at: threshold of the CUSUM of falls at which one is an improvement, such as a
    repair: the axis is measured against itself anew from where the fall began. It is higher than `threshold`
    (`SURER`): after a fall by chance the usual level would look like growth.
    """
    n = len(values)
    score, up, down = np.full(n, np.nan), np.zeros(n), np.zeros(n)
    alarms: list[Alarm] = []
    begun, found_until = 0, -1
    while True:
        own = slice(begun, n)
        score[own] = scores(values[own], None if floor is None else floor[own])
        up[own], down[own] = cusum(score[own]), cusum(-score[own])
        better = None if either else _reached(down[own], better_at)
        end = n if better is None else begun + better
        alarms += [one for one in _alarms(up[:end], begun, threshold, upwards=True) if one.at > found_until]
        if better is None:
            break
        fall = _onset(down, end)
        if alarms and alarms[-1].until is None:
            alarms[-1] = Alarm(alarms[-1].at, alarms[-1].onset, fall, alarms[-1].upwards)
        begun, found_until = max(fall, begun + 1), end
    if either:
        alarms = sorted([*alarms, *_alarms(down, 0, threshold, upwards=False)], key=lambda one: one.at)
    return Watched(score, up, down, begun, threshold, tuple(alarms))


def _reached(sums: Floats, threshold: float) -> int | None:
    over = np.flatnonzero(sums >= threshold)
    return int(over[0]) if len(over) else None


def _onset(sums: Floats, at: int) -> int:
    """Index of the first value since the CUSUM was last 0: the maximum likelihood estimate of where the change
    began."""
    zeros = np.flatnonzero(sums[:at] == 0.0)
    return int(zeros[-1]) + 1 if len(zeros) else 0


def _alarms(sums: Floats, begun: int, threshold: float, *, upwards: bool) -> list[Alarm]:
    """Alarms of a CUSUM from `begun` on; each ends where the CUSUM is 0 again."""
    found, at = [], begun
    while (first := _reached(sums[at:], threshold)) is not None:
        first += at
        zeros = np.flatnonzero(sums[first:] == 0.0)
        until = first + int(zeros[0]) if len(zeros) else None
        found.append(Alarm(first, max(begun, _onset(sums, first)), until, upwards))
        if until is None:
            break
        at = until
    return found


def memory(series: Sequence[Floats]) -> tuple[float, float]:
    """Correlation of scores with those before them, over all series, and its standard error where there is none.

    Beyond two standard errors the values are not independent, and false alarms are more frequent than stated. (NaN,
    NaN) without scores.
    """
    products, count = 0.0, 0
    for score in series:
        pairs: NDArray[Any] = np.stack([score[:-1], score[1:]]) if len(score) > 1 else np.empty((2, 0))
        pairs = pairs[:, np.all(np.isfinite(pairs), axis=0)]
        products += float(np.sum(pairs[0] * pairs[1]))
        count += pairs.shape[1]
    return (products / count, 1.0 / math.sqrt(count)) if count else (math.nan, math.nan)
