"""A searcher: candidates against one set of errors under any noise model, on all rows or with some left out.

It provides projections, fits and evidences of choices; `rank` and `search` choose. `memory` asks whether what some choices leave
remembers more than ordinary noise does: a cause that switches or settles faster than any column shows is found only so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from hil.diagnosis.noise.evidence import Extra, Noise, Projection
from hil.diagnosis.noise.noise_fit import CORRELATIONS, fit_noise, robust_std
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import Candidates
from hil.diagnosis.search.fit import START_ROUGHNESS, Choice, JointFit, Setting, joint_fit, joint_terms
from hil.diagnosis.table import DeclaredShape
from hil.effects import Estimate, Term

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


GRID = tuple(
    (ar, rho, offset)
    for ar, rho in ((0.0, 0.0), (0.35, 0.9), (0.6, 0.5), (0.7, 0.9), (1.2, 0.75))
    for offset in (0.0, 0.25, 0.6)
)
"""Noise models over which each candidate is profiled."""
LEAST_WEIGHT = 0.01
"""Weight over that of the best noise model, from which one counts for the uncertainties."""
LEAST_FREEDOM = 2.0
"""Least degrees of freedom of a variance: uncertainties become no more than 2.2 times as wide."""
MOST_PROJECTIONS = 40
CONTENDERS = 8
RICH_CONTENDERS = 3


@dataclass(frozen=True)
class Effort:
    """Extent of a search: effects refined, rounds of refinement, noise models each is profiled over, richer forms
    tried.

    correlations: (ar, rho) tried in a noise fit; empty where the start is close: none and that of the start
    """

    contenders: int
    rounds: int
    grid: tuple[tuple[float, float, float], ...]
    rich: int
    correlations: tuple[tuple[float, float], ...] = CORRELATIONS


FULL = Effort(CONTENDERS, 6, GRID, RICH_CONTENDERS)
LIGHT = Effort(3, 3, GRID[:2], 1, ())


class Searcher:
    """Candidates against one set of errors, on all rows or with some left out."""

    def __init__(
        self, setting: Setting, candidates: Candidates, out: Mask | None = None, effort: Effort = FULL
    ) -> None:
        self.setting, self.candidates, self.out, self.effort = setting, candidates, out, effort
        self.linear = setting.linear
        self.raw = self.y = setting.error_um
        self.nuisance = Extra.none(len(self.y))
        self._projections: dict[Noise, Projection] = {}
        self._limited_for: tuple[tuple[Choice, ...], Noise] | None = None
        self.excluded: frozenset[str] = frozenset()  # effects that are excluded at present

    @property
    def always(self) -> Extra:
        """The columns in every fit: declared ones and nuisance columns."""
        return self.setting.always.plus(self.nuisance)

    def add_nuisance(self, extra: Extra) -> None:
        """Adds nuisance columns to every later fit."""
        self.nuisance = self.nuisance.plus(extra)
        self._projections.clear()
        self._limited_for = None

    def restore(self, y: Floats, nuisance: Extra) -> None:
        """Restores earlier errors and nuisance columns."""
        self.y, self.nuisance = y, nuisance
        self._projections.clear()
        self._limited_for = None

    def fit(self, choices: Sequence[Choice], noise: Noise, *, uncertain: bool = True) -> JointFit:
        """Table and terms estimated together, with covariances if `uncertain`."""
        return joint_fit(
            self.setting, noise, self.y, choices, out=self.out, nuisance=self.nuisance, uncertain=uncertain
        )

    def fit_of_unknown_noise(self, choices: Sequence[Choice], noise: Noise) -> JointFit:
        """The fit under a noise model, with uncertainties that hold although the noise is not known: few runs show little of it.

        The covariance of each term is a mean over the grid of noise models, and the scatter of its coefficients about those of the
        fit. Each model counts by its evidence; the prior on offsets and memory, which serves the search, is left out. The spread of
        the covariances gives their degrees of freedom, and these the factor of Student's t: twice the standard uncertainty covers
        95 % (JCGM 100, G.3 and G.4).
        """
        best = self.fit(choices, noise)
        if not choices:
            return best
        extra = self.extra(choices)
        trials = list(dict.fromkeys([noise, *(with_point(noise, *point) for point in GRID)]))
        odds = np.array([self._evidence(choices, extra, trial) - trial.log_prior() for trial in trials])
        weight = np.exp(odds - np.max(odds))
        kept = np.flatnonzero(weight > LEAST_WEIGHT)
        under = [
            joint_terms(self.setting, trials[i], self.y, choices, out=self.out, nuisance=self.nuisance)[-1]
            for i in kept
        ]
        covariances = [
            mixed_covariance(term, [terms[i] for terms in under], weight[kept] / np.sum(weight[kept]))
            for i, term in enumerate(best.found)
        ]
        return best.with_covariances(covariances)

    def extra(self, choices: Sequence[Choice]) -> Extra:
        """The columns of some choices, and those of every fit."""
        total = self.always
        for choice in choices:
            total = total.plus(choice.extra(self.linear.campaign))
        return total

    def projection(self, noise: Noise, beside: Extra | None = None) -> Projection:
        """The projection with the columns `beside` in the fit, or with those of every fit (cached)."""
        if beside is not None:
            return self.linear.projection(noise, self.y, beside, self.out)
        if noise not in self._projections:
            if len(self._projections) >= MOST_PROJECTIONS:
                self._projections.clear()
            self._projections[noise] = self.linear.projection(noise, self.y, self.always, self.out)
        return self._projections[noise]

    def limit_outliers(self, choices: Sequence[Choice], noise: Noise) -> None:
        """Limits rows far beyond the residual of the bulk of the rows (Huber), for all later steps."""
        asked = tuple(choices), noise
        if asked == self._limited_for:
            return
        self._limited_for = asked
        projection = self.linear.projection(noise, self.raw, self.extra(choices), self.out)
        residual = projection.solve(np.zeros((len(self.raw), 0))).residual
        kept = residual if self.out is None else residual[~self.out]
        off = kept - np.median(kept)
        tail = float(np.quantile(np.abs(off), 0.95))
        limit = max(policy().outlier_limit * robust_std(off), policy().outlier_tail * tail)
        excess = residual - np.clip(residual, -limit, limit)
        self.y = self.raw - projection.whitened.colour(excess) if np.any(excess) else self.raw
        self._projections.clear()

    def fit_noise(self, choices: Sequence[Choice], start: Noise) -> Noise:
        """The noise model of highest evidence with the choices in the fit."""
        grid = self.effort.correlations or tuple(dict.fromkeys(((0.0, 0.0), (start.ar, start.rho))))
        near = not self.effort.correlations
        return fit_noise(self.linear, self.y, self.extra(choices), start, correlations=grid, near=near, out=self.out)

    def smooth(self, choices: Sequence[Choice], noise: Noise) -> Noise:
        """The noise model with a table as smooth as the rows show, for a fit that predicts: a search keeps a free one, so that no
        shape of a target is taken for an effect. What differs between the directions may be as rough as what they share: on a stage
        measured by others a smoother one predicted 1 % worse.
        """
        if isinstance(self.linear.shape, DeclaredShape) or math.isfinite(noise.even):
            return noise
        start = replace(noise, even=START_ROUGHNESS, odd=START_ROUGHNESS)
        points = ((noise.ar, noise.rho),)
        fitted = fit_noise(self.linear, self.y, self.extra(choices), start, correlations=points, out=self.out)
        return replace(noise, even=fitted.even, odd=max(fitted.even, fitted.odd))

    def evidence(self, choices: Sequence[Choice], noise: Noise) -> float:
        """Log marginal likelihood of table, noise and some choices, up to a constant of the rows."""
        return self._evidence(choices, self.extra(choices), noise)

    def _evidence(self, choices: Sequence[Choice], extra: Extra, noise: Noise) -> float:
        always = self.always
        shrunk = extra.random.shape[1] > always.random.shape[1]
        projection = self.projection(noise, Extra(always.free, extra.random) if shrunk else None)
        known = sum(choice.log_prior for choice in choices)
        return float(projection.log_null) + projection.gain(extra.free[:, always.free.shape[1] :]) + known

    def profiled_evidence(self, choices: Sequence[Choice], noise: Noise) -> tuple[float, Noise]:
        """Best evidence of the choices over the grid of noise models."""
        trials = [noise, *(with_point(noise, *point) for point in self.effort.grid)]
        extra = self.extra(choices)
        values = [self._evidence(choices, extra, trial) for trial in trials]
        best = int(np.argmax(values))
        return values[best], trials[best]


def mixed_covariance(term: Term, under: Sequence[Term], weight: Floats) -> Floats:
    """Covariance of a term from its estimates under several noise models of these weights, (m,); see `fit_of_unknown_noise`."""
    each = np.array([one.covariance for one in under])
    moved = np.zeros((len(under), len(each[0])))
    moved[:, : len(term.coefficients)] = np.array([one.coefficients for one in under]) - term.coefficients
    within = np.einsum("m,mij->ij", weight, each)
    variance = np.diag(within)
    spread = weight @ (np.einsum("mii->mi", each) - variance) ** 2
    freedom = np.maximum(2.0 * variance**2 / np.maximum(spread, 1e-12 * variance**2 + 1e-300), LEAST_FREEDOM)
    wider = stdtrit(freedom, 0.975) / stdtrit(1e9, 0.975)
    whole = within + np.einsum("m,mi,mj->ij", weight, moved, moved)
    return np.asarray(whole * np.outer(wider, wider))


class ConditionalSearch:
    """A searcher with some choices in every fit: projections and base evidences, cached."""

    def __init__(self, searcher: Searcher, chosen: Sequence[Choice]) -> None:
        self.searcher, self.chosen = searcher, chosen
        self._extra = searcher.extra(chosen)
        self._projections: dict[Noise, Projection] = {}
        self._base: dict[Noise, float] = {}

    def projection(self, noise: Noise) -> Projection:
        """The projection with the choices in the fit."""
        if not self.chosen:
            return self.searcher.projection(noise)
        if noise not in self._projections:
            self._projections[noise] = self.searcher.projection(noise, self._extra)
        return self._projections[noise]

    def base(self, noise: Noise) -> float:
        """Log evidence of the choices, under a noise model."""
        if noise not in self._base:
            if self.chosen:
                self._base[noise] = self.searcher.evidence(self.chosen, noise)
            else:
                self._base[noise] = float(self.projection(noise).log_null)
        return self._base[noise]


def with_point(noise: Noise, ar: float, rho: float, offset: float) -> Noise:
    """The noise model with other (ar, rho, offset)."""
    return replace(noise, ar=ar, rho=rho, offset=offset)


ORDINARY = tuple(product((0.35, 0.6, 0.85), (0.3, 0.5, 0.7, 0.85, 0.95)))
STRONG = tuple(product((1.2, 1.7, 2.5, 4.0), (0.5, 0.7, 0.85)))
"""(ar, rho): standard deviation of the correlated part over that of the white one, and its correlation one row
later.
"""
AROUND = tuple(product(np.geomspace(0.7, 8.0, 12).tolist(), (0.4, 0.55, 0.7, 0.8, 0.9)))
"""The same, on a grid fine enough for the uncertainty of the strength."""


@dataclass(frozen=True)
class Memory:
    """noise: the strongly correlated model; log_odds: against ordinary noise; rms_um: of the correlated part"""

    noise: Noise
    log_odds: float
    rms_um: Estimate


def memory(searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> Memory | None:
    """The strong correlation in the residual of some terms, if it is beyond that of noise."""
    if noise.ar == 0.0:
        return None

    def best(points: Sequence[tuple[float, float]]) -> tuple[float, Noise]:
        trials = [replace(noise, ar=ar, rho=rho) for ar, rho in points]
        return max(((searcher.evidence(chosen, t) - t.log_prior(), t) for t in trials), key=lambda pair: pair[0])

    ordinary, (strong, model) = best(ORDINARY)[0], best(STRONG)
    if strong <= ordinary + policy().decisive:
        return None
    return Memory(model, strong - ordinary, _strength_um(searcher, chosen, noise))


def _strength_um(searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> Estimate:
    """Standard deviation of the correlated part in µm, averaged over noise models by their evidence."""
    extra = searcher.extra(chosen)
    odds, values = np.zeros(len(AROUND)), np.zeros(len(AROUND))
    for i, (ar, rho) in enumerate(AROUND):
        projection = searcher.projection(replace(noise, ar=ar, rho=rho), extra)
        odds[i] = float(projection.log_null) - projection.noise.log_prior()
        values[i] = ar * float(np.sqrt(projection.rss / projection.dof))
    weight = np.exp(odds - np.max(odds))
    weight /= np.sum(weight)
    mean = float(weight @ values)
    return Estimate(mean, float(np.sqrt(weight @ (values - mean) ** 2)))
