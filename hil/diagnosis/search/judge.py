"""Tests whether a finding of the search is more than noise, with the look-elsewhere effect.

Decisions use the null distribution of the maximum. It is simulated only for gains near the decision, neither far below
nor far above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import MOST_OFFSET, Extra, LinearCampaign, Noise, Projection, random_gain
from hil.diagnosis.search.candidates import score
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.null import CAMPAIGNS, Null, null_maxima, simulate, tail_probability
from hil.diagnosis.search.rank import smoother
from hil.diagnosis.search.search import Stage
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.search.structure import Catalogue, Structure

Floats = NDArray[np.float64]

FALSE_FINDINGS = 0.003
"""Rate of findings on a campaign without effects, over the whole catalogue."""
FALSE_STRUCTURE = 0.002
"""Rate of structures found on a campaign without any."""
WINNER = 0.02
"""Largest probability in noise of the winning effect by itself, once any effect is significant."""
ACCEPTED_FROM = 35.0
"""Log Bayes factor accepted without a simulation."""
REJECTED_BELOW = 2.0
"""Log Bayes factor below which no simulation is made."""
REFINEMENT = 5.0
"""Log Bayes factor that refinement of a grid point may add."""
STRUCTURE_CAMPAIGNS = 300
NEAR_OFFSET = 0.2
"""Difference of run offsets from which the null is also profiled at their median."""
OFFSETS = np.linspace(0.0, MOST_OFFSET, 9)
DEFAULT_CRITICAL = 12.0
DEFAULT_CRITICAL_STRUCTURE = 12.0
"""Critical log Bayes factors of effects and of structures where no null was simulated."""


@dataclass
class NullJudge:
    """Decides the stages of one search on all rows; caches its simulations."""

    seed: int
    null: Null | None = None
    asked: dict[int, Null] = field(default_factory=dict)

    def __call__(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> bool:
        top = stage.ranking[0].evidence - stage.before
        if top > ACCEPTED_FROM:
            return True
        if top < REJECTED_BELOW:
            return False
        if self.probability(stage, searcher, chosen, noise) >= FALSE_FINDINGS:
            return False
        winner = stage.ranking[0].effect
        return self.null is None or winner not in self.null.maxima or float(self.null.probability(winner, top)) < WINNER

    def may_become_significant(self, effect: str, gain: float) -> bool:
        """Whether this gain of a grid point may become significant by refinement."""
        del effect
        return gain > REJECTED_BELOW - REFINEMENT

    def probability(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> float:
        """Probability in noise alone that any effect reaches the gain of the best one."""
        key = len(chosen)
        if key not in self.asked:
            offsets = run_offsets(searcher, [*chosen, stage.ranking[0].choice], noise, self.seed)
            typical = replace(noise, offset=float(np.median(offsets)))
            far = abs(typical.offset - noise.offset) > NEAR_OFFSET
            smooth = smoother(noise) if searcher.linear.rough else ()
            noises = tuple(dict.fromkeys((noise, noise.calm(), *((typical,) if far else ()))))
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
        wanted = FALSE_FINDINGS / max(len(self.null.maxima), 1)
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
    trials = [replace(noise, offset=float(offset)) for offset in OFFSETS]
    odds = np.array([searcher.evidence(choices, trial) for trial in trials])
    weight = np.exp(odds - np.max(odds))
    return np.random.default_rng(seed).choice(OFFSETS, CAMPAIGNS, p=weight / np.sum(weight))


@dataclass(frozen=True)
class FoldJudge:
    """Decides the stages of a search with a run left out, by the critical gains on all rows."""

    critical: dict[str, float]

    def __call__(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> bool:
        return any(r.evidence - stage.before > self.critical.get(r.effect, DEFAULT_CRITICAL) for r in stage.ranking)

    def may_become_significant(self, effect: str, gain: float) -> bool:
        """Whether this gain of a grid point may become significant by refinement."""
        return gain > self.critical.get(effect, DEFAULT_CRITICAL) - REFINEMENT


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
    critical: float = DEFAULT_CRITICAL_STRUCTURE

    def __call__(self, projection: Projection, linear: LinearCampaign) -> Hit | None:
        """The structure of highest gain beside the projected columns, if it is significant."""
        found = clearest(projection, self.catalogue)
        if found is None or found[1] < 0.0:
            return None
        structure, gain = found
        probability = 0.0
        if gain < ACCEPTED_FROM:
            probability = self._probability(projection, linear, structure, gain)
            if probability >= FALSE_STRUCTURE:
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
        good = grid[tests * tail_probability(maxima, floor, grid) < FALSE_STRUCTURE]
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
