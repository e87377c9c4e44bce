"""Terms of a fit with their uncertainty: the covariance linearised at the estimate, and the region of profile likelihood about it.

An interval of profile likelihood holds the values of a quantity at which the likelihood, with everything else at its best, is not less
than at the maximum by more than χ² of one degree of freedom allows (Venzon & Moolgavkar, Applied Statistics 37, 1988). Given the
non-linear parameters the region is an ellipsoid of the coefficients; over those it is found by going out from the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import Floats
from hil.diagnosis.model.evidence import Candidate, Fit, Part
from hil.effects import Term
from hil.effects.base import COVERS, Likely, slopes_of

DROP = COVERS**2
"""Twice the drop of the log likelihood at the end of an interval."""
OUTWARD = (0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 11.0, 17.0, 26.0, 40.0)
"""Standard deviations at which the end of the region is looked for."""
HALVINGS = 6
INSIDE = (0.35, 0.6, 0.8, 0.92, 1.0)
"""Shares of the way to the end at which its surface is taken: of the coefficients it is widest inside."""
EVEN, DRAWN = 16, 40
"""Ways out with two non-linear parameters, evenly, and with more, at random."""


def terms_of(fit: Fit) -> dict[Part, Term]:
    """The term of each effect of a fit, by its part, with the covariance of coefficients and parameters."""
    return {part: _term(fit, part) for part in fit.parts if part.of is not None}


def _term(fit: Fit, part: Part) -> Term:
    one = part.of
    assert one is not None
    beta = fit.coefficients(part)
    if one.form.shrunk:
        at = fit.where(part, "random")
        return as_term(one, beta, fit.covariance[at, at] * one.ratio)
    term = as_term(one, beta, np.zeros((len(beta) + len(one.theta),) * 2))
    beside = Fit(fit.rows, [_with_slopes(fit, other) for other in fit.parts if other is not part], fit.noise)
    normal, _ = beside.normal(np.hstack([part.free, slopes_of(fit.rows.campaign.columns, one, beta)]))
    size = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    covariance = np.outer(size, size) * np.linalg.pinv(normal * np.outer(size, size), rcond=1e-12, hermitian=True)
    term = as_term(one, beta, covariance * fit.sigma**2)
    if one.form.exhaustive or not np.all(np.diag(covariance) > 0.0):
        return term
    return replace(term, likely=_Region(beside, one, fit.sigma**2, np.array(term.covariance)).likely())


def _with_slopes(fit: Fit, part: Part) -> Part:
    """Another part with its non-linear parameters free too."""
    if part.of is None or not part.of.theta or part.of.form.exhaustive or part.of.form.shrunk:
        return part
    slopes = slopes_of(fit.rows.campaign.columns, part.of, fit.coefficients(part))
    return replace(part, free=np.hstack([part.free, slopes]))


def as_term(one: Candidate, coefficients: Floats, covariance: Floats) -> Term:
    """A candidate with its coefficients (k,), and their covariance with its t parameters, (k + t, k + t)."""
    known = tuple(tuple(row) for row in covariance.tolist())
    return Term(one.effect, one.form, tuple(one.theta), tuple(coefficients.tolist()), known)


@dataclass(frozen=True)
class _Region:
    """beside: the fit of everything else; variance: of the white noise, µm²; covariance: of coefficients and parameters"""

    beside: Fit
    one: Candidate
    variance: float
    covariance: Floats

    @cached_property
    def _logs(self) -> NDArray[np.bool_]:
        return np.array([p.logarithmic for p in self.one.form.nonlinear], dtype=np.bool_)

    @cached_property
    def _root(self) -> Floats:
        """Square root of the covariance of the parameters on the scale of their search, (t, t)."""
        theta = np.array(self.one.theta)
        scale = np.where(self._logs, 1.0 / np.maximum(np.abs(theta), 1e-300), 1.0)
        k = len(self.covariance) - len(theta)
        values, vectors = np.linalg.eigh(self.covariance[k:, k:] * np.outer(scale, scale))
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))

    def _solved(self, theta: Sequence[float]) -> tuple[float, Floats, Floats]:
        """At these parameters: explained sum of squares, coefficients (k,), and their covariance over the variance (k, k)."""
        columns = self.one.effect.basis(self.one.form, theta, self.beside.rows.campaign.columns)
        a, b = self.beside.normal(columns)
        inverse = np.linalg.pinv(a, rcond=1e-12, hermitian=True)
        return float(b @ inverse @ b), np.asarray(inverse @ b), np.asarray(inverse)

    def _height(self, theta: Sequence[float]) -> float:
        """Twice the log likelihood, up to a constant, with the prior of the parameters."""
        return self._solved(theta)[0] / self.variance + 2.0 * self.one.form.log_prior(theta)

    @cached_property
    def _best(self) -> float:
        return self._height(self.one.theta)

    def _drop(self, theta: Sequence[float]) -> float:
        return max(self._best - self._height(theta), 0.0)

    def _out(self, way: Floats, distance: float) -> tuple[float, ...]:
        """Parameters so many standard deviations away, within their bounds."""
        by = distance * (self._root @ way)
        moved = []
        for parameter, value, step in zip(self.one.form.nonlinear, self.one.theta, by.tolist(), strict=True):
            new = value * math.exp(min(step, 50.0)) if parameter.logarithmic else value + step
            moved.append(min(max(new, parameter.lower), parameter.upper))
        return tuple(moved)

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
        """Its ellipsoids of the coefficients, at the estimate and on the ways out."""
        thetas = [tuple(self.one.theta)]
        for way in _ways(len(self.one.theta)):
            end = self._end(way)
            thetas += [self._out(way, share * end) for share in INSIDE]
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
