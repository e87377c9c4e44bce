"""What the rows say of an effect's parameters beyond a linearisation: the maximum of the likelihood, and the region about it.

An interval of profile likelihood holds the values of a quantity at which the likelihood, with everything else at its best, is not less
than at the maximum by more than χ² of one degree of freedom allows (Venzon & Moolgavkar, Applied Statistics 37, 1988). It is the range
of the quantity over the region of all parameters where the likelihood is no less, so that one region serves every quantity. Given the
non-linear parameters the region is an ellipsoid of the coefficients; over those it is found by going out from the maximum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Extra, Noise, Projection, explained_by
from hil.diagnosis.search.fit import Choice, JointFit
from hil.diagnosis.search.rank import moved
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Term
from hil.effects.base import COVERS, Likely, slopes_of

Floats = NDArray[np.float64]

DROP = COVERS**2
"""Twice the drop of the log likelihood at the end of an interval: that of a normal distribution at its expanded uncertainty."""
STEPS = 4
"""Gauss-Newton steps: the search ends within a tenth of a grid step of the maximum, from which two are enough."""
LONGEST = 0.7
"""Longest of them, of the logarithm of a parameter."""
OUTWARD = (0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 11.0, 17.0, 26.0, 40.0)
"""Standard deviations at which the end of the region is looked for; beyond it the bounds of the parameter end it."""
HALVINGS = 6
INSIDE = (0.35, 0.6, 0.8, 0.92)
"""Shares of the way to the end at which its surface is taken too: of the coefficients it is widest inside."""
EVEN, DRAWN = 16, 40
"""Ways out from the maximum with two non-linear parameters, evenly, and with more, at random."""


def at_the_maximum(searcher: Searcher, choices: Sequence[Choice], noise: Noise) -> list[Choice]:
    """The choices with their non-linear parameters at the maximum of the likelihood, all together, by Gauss-Newton steps.

    The grid of a search is coarse where rows are many: what it leaves is not in the uncertainty.
    """
    current = list(choices)
    if not any(map(_is_smooth, current)):
        return current
    projection = searcher.projection(noise, searcher.extra([one for one in current if one.form.shrunk]))
    best = _worth(projection, current)
    for _ in range(STEPS):
        steps = _steps(projection, current)
        for share in (1.0, 0.5, 0.2):
            trial = [
                one if step is None else replace(one, theta=moved(one, (share * step).tolist()))
                for one, step in zip(current, steps, strict=True)
            ]
            worth = _worth(projection, trial)
            if worth > best:
                break
        else:
            break
        gained, best, current = worth - best, worth, trial
        if gained < 1e-3:
            break
    return current


def _is_smooth(choice: Choice) -> bool:
    """Whether the likelihood is smooth in the non-linear parameters of a choice, and it has any."""
    return bool(choice.theta) and not choice.form.exhaustive and not choice.form.shrunk


def _scale(choice: Choice) -> Floats:
    """Change of each parameter on the scale on which it is searched, per change of the parameter, (t,)."""
    return np.array(
        [1.0 / v if p.logarithmic else 1.0 for p, v in zip(choice.form.nonlinear, choice.theta, strict=True)]
    )


def _worth(projection: Projection, choices: Sequence[Choice]) -> float:
    """Log likelihood with the choices' coefficients at their best, up to a constant, with the priors of their parameters."""
    campaign = projection.whitened.campaign
    columns = np.hstack([one.columns(campaign) for one in choices if not one.form.shrunk])
    left = max(float(projection.rss) - explained_by(*projection.normal(columns)), 1e-300)
    return -0.5 * projection.dof * math.log(left) + sum(one.log_prior for one in choices)


def _steps(projection: Projection, choices: Sequence[Choice]) -> list[Floats | None]:
    """One step of the parameters of each choice, on the scale on which they are searched; None where the likelihood is not smooth."""
    campaign = projection.whitened.campaign
    linear = [one.columns(campaign) for one in choices if not one.form.shrunk]
    coefficients = projection.estimate(np.hstack(linear))
    slopes, at = [], 0
    for one, columns in zip((one for one in choices if not one.form.shrunk), linear, strict=True):
        if _is_smooth(one):
            slopes.append(slopes_of(campaign.columns, one, coefficients[at : at + columns.shape[1]]))
        at += columns.shape[1]
    step = projection.estimate(np.hstack([*linear, *slopes]))
    found: list[Floats | None] = []
    for one in choices:
        if not _is_smooth(one):
            found.append(None)
            continue
        by = step[at : at + len(one.theta)] * _scale(one)
        found.append(np.where([p.logarithmic for p in one.form.nonlinear], np.clip(by, -LONGEST, LONGEST), by))
        at += len(one.theta)
    return found


def with_regions(searcher: Searcher, fit: JointFit, choices: Sequence[Choice], noise: Noise) -> JointFit:
    """The fit of the choices, whose terms know the region of their parameters that is likely (`Term.likely`).

    Its scale is that of the covariances of the terms: the noise is not known, see `fit_of_unknown_noise`.
    """
    found = []
    for i, (choice, term) in enumerate(zip(choices, fit.found, strict=True)):
        if choice.form.shrunk or choice.form.exhaustive:
            found.append(term)
            continue
        beside = searcher.extra([*choices[:i], *choices[i + 1 :]])
        for other, known in zip(choices, fit.found, strict=True):
            if known is not term and _is_smooth(other):
                slopes = slopes_of(searcher.linear.campaign.columns, other, np.array(known.coefficients))
                beside = beside.plus(Extra(slopes, slopes[:, :0]))
        region = _Region.of(searcher.projection(noise, beside), choice, term)
        found.append(term if region is None else replace(term, likely=region.likely()))
    return fit.with_terms(found)


@dataclass(frozen=True)
class _Region:
    """projection: with everything else in the fit, the slopes of other effects too
    variance: of the white noise, as the covariance of the term has it: that of the parameter which the noise models widen most
    root: square root of the covariance of the parameters on the scale of their search, (t, t)
    """

    projection: Projection
    choice: Choice
    variance: float
    root: Floats

    @classmethod
    def of(cls, projection: Projection, choice: Choice, term: Term) -> _Region | None:
        """None where the linearised fit of the term is singular."""
        columns = choice.columns(projection.whitened.campaign)
        k = columns.shape[1]
        slopes = slopes_of(projection.whitened.campaign.columns, choice, np.array(term.coefficients))
        normal, _ = projection.normal(np.hstack([columns, slopes]))
        linear = np.diag(np.linalg.pinv(normal, rcond=1e-13, hermitian=True))
        known = np.array(term.covariance)
        if np.any(linear <= 0.0) or np.any(np.diag(known) <= 0.0):
            return None
        variance = float(np.max(np.diag(known) / linear))
        scale = _scale(choice)
        values, vectors = np.linalg.eigh(known[k:, k:] * np.outer(scale, scale))
        return cls(projection, choice, variance, vectors * np.sqrt(np.maximum(values, 0.0)))

    @cached_property
    def _best(self) -> float:
        """Twice the log likelihood at the maximum."""
        return self._height(self.choice.theta)

    def _solved(self, theta: Sequence[float]) -> tuple[float, Floats, Floats]:
        """At these parameters: explained sum of squares, coefficients (k,), and their covariance over the variance (k, k)."""
        columns = replace(self.choice, theta=tuple(theta)).columns(self.projection.whitened.campaign)
        a, b = self.projection.normal(columns)
        inverse = np.linalg.pinv(a, rcond=1e-12, hermitian=True)
        return float(b @ inverse @ b), np.asarray(inverse @ b), np.asarray(inverse)

    def _height(self, theta: Sequence[float]) -> float:
        """Twice the log likelihood at these parameters, up to a constant, with their prior."""
        prior = replace(self.choice, theta=tuple(theta)).log_prior
        return self._solved(theta)[0] / self.variance + 2.0 * prior

    def _drop(self, theta: Sequence[float]) -> float:
        return max(self._best - self._height(theta), 0.0)

    def _out(self, way: Floats, distance: float) -> tuple[float, ...]:
        """Parameters so many standard deviations away, within their bounds."""
        return moved(self.choice, (distance * (self.root @ way)).tolist())

    def _end(self, way: Floats) -> float:
        """Distance at which the region ends on a way out."""
        inside = 0.0
        for outside in OUTWARD:
            if self._drop(self._out(way, outside)) > DROP:
                break
            inside = outside
        else:
            return inside
        for _ in range(HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (inside, middle) if self._drop(self._out(way, middle)) > DROP else (middle, outside)
        return inside

    def likely(self) -> tuple[Likely, ...]:
        """Its ellipsoids of the coefficients, at the maximum and on the ways out."""
        thetas = [self.choice.theta]
        for way in _ways(len(self.choice.theta)):
            end = self._end(way)
            thetas += [self._out(way, share * end) for share in (*INSIDE, 1.0)]
        return tuple(map(self._ellipsoid, thetas))

    def _ellipsoid(self, theta: tuple[float, ...]) -> Likely:
        _, middle, inverse = self._solved(theta)
        radius = math.sqrt(max(DROP - self._drop(theta), 0.0) * self.variance)
        values, vectors = np.linalg.eigh(inverse)
        return Likely(theta, middle, np.asarray(radius * vectors * np.sqrt(np.maximum(values, 0.0))))


def _ways(dimensions: int) -> Floats:
    """Unit vectors, (m, dimensions): both ways of a line, evenly on a circle, else at random."""
    if dimensions == 0:
        return np.zeros((0, 0))
    if dimensions == 1:
        return np.array([[1.0], [-1.0]])
    if dimensions == 2:
        angle = 2.0 * np.pi * np.arange(EVEN) / EVEN
        return np.column_stack([np.cos(angle), np.sin(angle)])
    drawn = np.random.default_rng(0).normal(size=(DRAWN, dimensions))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
