"""The null distribution: the best gain of each effect in simulated campaigns of table and noise alone, in the
campaign's own design.

Textbook tails (χ², periodogram) are too light for a search over periods, moments and time constants in correlated
noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection
from hil.diagnosis.search.candidates import Candidates, score

Floats = NDArray[np.float64]

CAMPAIGNS = 300
"""Simulated campaigns."""


@dataclass(frozen=True)
class Null:
    """By effect id, the gain of its best candidate over none in each simulated campaign, shape (b,).

    floor: gain of a candidate that explains nothing; narrowest: width of the narrowest candidate
    """

    maxima: dict[str, Floats]
    floor: dict[str, float]
    narrowest: dict[str, int]
    log_rows: float

    def probability(self, effect: str, value: Floats | float) -> Floats:
        """Probability in noise that the best candidate of this effect reaches a gain, at least that of a single
        candidate.

        Shape of `value`.
        """
        width = self.narrowest[effect]
        own_floor = -0.5 * width * self.log_rows
        single = gammaincc(0.5 * width, np.maximum(np.asarray(value) - own_floor, 0.0))
        return np.asarray(np.maximum(single, tail_probability(self.maxima[effect], self.floor[effect], value)))


def tail_probability(sample: Floats, floor: float, value: Floats | float) -> Floats:
    """Chance of exceeding `value`, from a sample (b,) that cannot fall below `floor`: the larger of a Gumbel and a gamma tail.

    Shape of `value`.
    """
    far = np.asarray(value)
    mean, spread = float(np.mean(sample)), max(float(np.std(sample)), 1e-6)
    scale = spread * np.sqrt(6.0) / np.pi
    gumbel = -np.expm1(-np.exp(np.minimum(-(far - (mean - 0.5772 * scale)) / scale, 50.0)))
    above = max(mean - floor, 1e-6)
    shape = (above / spread) ** 2
    gamma = gammaincc(shape, shape * np.maximum(far - floor, 0.0) / above)
    return np.asarray(np.maximum(gumbel, gamma))


def simulate(linear: LinearCampaign, noise: Noise, offsets: Floats, seed: int) -> Floats:
    """Campaigns of table roughness, run offsets and noise alone, unit white noise, shape (n, count).

    offsets: standard deviation of the run offsets of each campaign, shape (count,)
    """
    rng = np.random.default_rng(seed)
    count = len(offsets)
    y = linear.whitened(noise).colour(rng.normal(size=(len(linear.campaign), count)))
    ridge = linear.table.ridge(noise)[: linear.table.table_width]
    random = np.flatnonzero(ridge > 0)
    parts = linear.table.stacked[:, random] / np.sqrt(ridge[random])
    y += parts @ rng.normal(size=(parts.shape[1], count))
    return np.asarray(y + linear.table.offset @ (offsets * rng.normal(size=(linear.table.offset.shape[1], count))))


def null_maxima(
    linear: LinearCampaign,
    candidates: Candidates,
    noises: Sequence[Noise],
    offsets: Floats,
    beside: Extra,
    *,
    seed: int,
    smooth: Sequence[Noise] = (),
) -> Null:
    """The null distribution for noise model noises[0], profiled over all of `noises`, with the columns `beside` in every fit.

    offsets: standard deviation of the run offsets of each simulated campaign, shape (b,)
    smooth: noise models over which effects that may be a feature of one place are profiled too, and none beside them
    """
    y = simulate(linear, noises[0], offsets, seed)
    count = len(offsets)
    best_null = np.full(count, -np.inf)
    best = np.full((len(candidates.effects), count), -np.inf)
    for noise in noises:
        best_null = _raise(best, best_null, linear.projection(noise, y, beside), candidates)
    best_null = np.tile(best_null, (len(best), 1))
    local = candidates.of_one_place(linear.campaign)
    mine = np.unique(local.effect)
    for noise in smooth if len(local) else ():
        best_null[mine] = _raise(best, best_null[mine], linear.projection(noise, y, beside), local)
    maxima, floor, narrowest = {}, {}, {}
    log_rows = float(np.log1p(len(y)))
    for index, name in enumerate(candidates.effects):
        values = best[index] - best_null[index]
        if np.all(np.isfinite(values)):
            maxima[name] = values
            widths = np.where(candidates.blocks.shrunk, 4, candidates.blocks.width)
            mine = widths[candidates.effect == index]
            floor[name] = -0.5 * float(np.max(mine)) * log_rows
            narrowest[name] = int(np.min(mine))
    return Null(maxima, floor, narrowest, log_rows)


def _raise(best: Floats, best_null: Floats, projection: Projection, candidates: Candidates) -> Floats:
    """Raise the best evidence of each effect, shape (e, b), to that in a projection; the best evidence of none, shape (…, b)."""
    gains = score(projection, candidates.stack(projection.whitened)).gain
    for index in np.unique(candidates.effect):
        best[index] = np.maximum(best[index], projection.log_null + np.max(gains[candidates.effect == index], axis=0))
    return np.asarray(np.maximum(best_null, projection.log_null))
