"""Tests whether a finding of the search is more than noise, with the look-elsewhere effect.

Decisions use the null distribution of the maximum: the best gain of each effect in simulated campaigns of table and noise alone, in
the campaign's own design. Textbook tails (χ², periodogram) are too light for a search over periods, moments and time constants in
correlated noise. It is simulated only for gains near the decision, neither far below nor far above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection, random_gain
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import Candidates, score
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.rank import REFINEMENT, smoother
from hil.diagnosis.search.search import Stage
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.search.structure import Catalogue, Structure

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


STRUCTURE_CAMPAIGNS = 300
OFFSET_STEPS = 9
"""Run offsets tried between none and the largest."""


@dataclass
class NullJudge:
    """Decides the stages of one search on all rows; caches its simulations."""

    seed: int
    null: Null | None = None
    asked: dict[int, Null] = field(default_factory=dict)

    def __call__(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> bool:
        top = stage.ranking[0].evidence - stage.before
        if top > policy().accepted_from:
            return True
        if top < policy().positive:
            return False
        return self.probability(stage, searcher, chosen, noise) < policy().false_findings

    def may_become_significant(self, effect: str, gain: float) -> bool:
        """Whether this gain of a grid point may become significant by refinement."""
        del effect
        return gain > policy().positive - REFINEMENT

    def probability(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> float:
        """Probability in noise alone that any effect reaches the gain of the best one."""
        key = len(chosen)
        if key not in self.asked:
            offsets = run_offsets(searcher, [*chosen, stage.ranking[0].choice], noise, self.seed)
            smooth = smoother(noise) if searcher.linear.rough else ()
            noises = tuple(dict.fromkeys((noise, noise.calm())))
            beside = searcher.extra(chosen)
            self.asked[key] = null_maxima(
                searcher.linear, searcher.candidates, noises, offsets, beside, seed=self.seed, smooth=smooth
            )
        null = self.null = self.asked[key]
        values = [
            float(null.probability(r.effect, r.evidence - stage.before))
            for r in stage.ranking
            if r.effect in null.maxima
        ]
        return min(1.0, min(values, default=1.0) * max(len(null.maxima), 1))

    def critical(self) -> dict[str, float]:
        """For each effect the gain that is just significant, for the folds; empty where nothing was simulated."""
        if self.null is None:
            return {}
        wanted = policy().false_findings / max(len(self.null.maxima), 1)
        grid = np.linspace(0.0, 40.0, 161)
        critical = {}
        for effect in self.null.maxima:
            good = grid[self.null.probability(effect, grid) < wanted]
            critical[effect] = float(good[0]) if len(good) else 40.0
        return critical


def run_offsets(searcher: Searcher, choices: Sequence[Choice], noise: Noise, seed: int) -> Floats:
    """Standard deviations of the run offsets, sampled from their posterior with some choices in the fit, shape
    (CAMPAIGNS,).

    The best candidate is in the fit, so that a drift from run to run does not increase the offsets.
    """
    offsets = np.linspace(0.0, policy().most_offset, OFFSET_STEPS)
    trials = [replace(noise, offset=float(offset)) for offset in offsets]
    odds = np.array([searcher.evidence(choices, trial) for trial in trials])
    weight = np.exp(odds - np.max(odds))
    return np.random.default_rng(seed).choice(offsets, CAMPAIGNS, p=weight / np.sum(weight))


@dataclass(frozen=True)
class FoldJudge:
    """Decides the stages of a search with a run left out, by the critical gains on all rows."""

    critical: dict[str, float]

    def __call__(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> bool:
        return any(r.evidence - stage.before > self.critical.get(r.effect, policy().unsimulated) for r in stage.ranking)

    def may_become_significant(self, effect: str, gain: float) -> bool:
        """Whether this gain of a grid point may become significant by refinement."""
        return gain > self.critical.get(effect, policy().unsimulated) - REFINEMENT


@dataclass(frozen=True)
class Hit:
    """A significant structure: the block, its variance ratio as a random effect, its gain, its probability in noise."""

    structure: Structure
    variance: float
    gain: float
    probability: float

    @property
    def extra(self) -> Extra:
        """Its columns for a fit."""
        whole = self.structure.whole
        return Extra(whole[:, :0], whole * math.sqrt(self.variance))


def hit_of(projection: Projection, structure: Structure, gain: float, probability: float) -> Hit:
    """The structure with its variance fitted under a projection."""
    _, variance = random_gain(projection, structure.whole)
    return Hit(structure, float(variance), gain, probability)


@dataclass
class StructureSearch:
    """The search for structure outside the catalogue; stores the gain that is just significant for the folds."""

    catalogue: Catalogue
    seed: int
    critical: float = field(default_factory=lambda: policy().unsimulated)

    def __call__(self, projection: Projection, linear: LinearCampaign) -> Hit | None:
        """The structure of highest gain beside the projected columns, if it is significant."""
        found = clearest(projection, self.catalogue)
        if found is None or found[1] < 0.0:
            return None
        structure, gain = found
        probability = 0.0
        if gain < policy().accepted_from:
            probability = self._probability(projection, linear, structure, gain)
            if probability >= policy().false_structure:
                return None
        return hit_of(projection, structure, gain, probability)

    def _probability(self, projection: Projection, linear: LinearCampaign, structure: Structure, gain: float) -> float:
        catalogue = self.catalogue
        y = simulate(linear, projection.noise, np.full(STRUCTURE_CAMPAIGNS, projection.noise.offset), self.seed + 1)
        null = linear.projection(projection.noise, y, projection.extra)
        tests = 1 + len(catalogue.fine)
        if structure in catalogue.fine:
            sample, _ = random_gain(null, structure.design)
            return tests * float(tail_probability(sample, float(np.min(sample)) - 1.0, gain))
        maxima = np.max(score(null, catalogue.stack(null.whitened)).gain, axis=0)
        floor = -2.0 * float(np.log1p(projection.rows))
        grid = np.linspace(2.0, 30.0, 57)
        good = grid[tests * tail_probability(maxima, floor, grid) < policy().false_structure]
        self.critical = float(good[0]) if len(good) else 30.0
        return tests * float(tail_probability(maxima, floor, gain))


@dataclass(frozen=True)
class FoldStructureSearch:
    """The same with a run left out, by the critical gain on all rows."""

    catalogue: Catalogue
    critical: float

    def __call__(self, projection: Projection, linear: LinearCampaign) -> Hit | None:
        del linear
        found = clearest(projection, self.catalogue)
        if found is None or found[1] < self.critical:
            return None
        return hit_of(projection, found[0], found[1], 0.0)


def clearest(projection: Projection, catalogue: Catalogue) -> tuple[Structure, float] | None:
    """The structure of highest gain and that gain; None where there is no structure to test."""
    gains: list[float] = []
    if len(catalogue.structures):
        gains.extend(score(projection, catalogue.stack(projection.whitened)).gain)
    gains.extend(float(random_gain(projection, s.design)[0]) for s in catalogue.fine)
    if not gains:
        return None
    top = int(np.argmax(gains))
    return (*catalogue.structures, *catalogue.fine)[top], float(gains[top])
