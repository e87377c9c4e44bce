"""The noise model and the evidence for columns under it; every comparison of the search uses these.

error = table + run offsets + effects + correlated noise (AR(1) within a pass) + white noise. The table's roughness and
the run offsets are normal random effects, so the marginal likelihood (REML; Patterson & Thompson 1971, Harville 1974)
gives roughness, offsets and correlation of the campaign; a block of effect columns has Zellner's g-prior with unit
information (Liang et al. 2008), so that blocks of different width compare. All variances are relative to the white
noise's.

Everything is computed from cross products, so that one whitening serves every trial of the other parameters, and a run
is left out by subtracting its part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dtrtri

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.policy import policy
from hil.diagnosis.table import Shape, ShapeColumns, SplineShape

Floats = NDArray[np.float64]
Reals = NDArray[np.floating]
Ints = NDArray[np.int64]
Precision = TypeVar("Precision", np.float64, np.float32)


VARIANCES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Variance ratios tried for a random effect of unit columns."""


LONG_FROM = 0.8
"""Correlation from one row to the next above which memory is long."""


def prior_scale(rho: float) -> float:
    """Scale of the half-normal prior on `ar`: strong noise of long correlation is drift, and so an effect."""
    return policy().short_memory if rho <= LONG_FROM else policy().slow_noise


def log_prior(ar: float, rho: float, offset: float) -> float:
    """Log prior of the parameters of a noise model, up to a constant."""
    return -0.5 * (ar / prior_scale(rho)) ** 2 - 0.5 * (offset / policy().slow_noise) ** 2


@dataclass(frozen=True)
class Noise:
    """Standard deviations relative to the white noise's, AR(1) coefficient, and the table's variance ratios (even, odd part)."""

    ar: float = 0.0
    rho: float = 0.0
    offset: float = 0.0
    even: float = math.inf
    odd: float = math.inf

    def log_prior(self) -> float:
        """Log prior of these parameters, up to a constant."""
        return log_prior(self.ar, self.rho, self.offset)

    def calm(self) -> Noise:
        """The same table, white noise only."""
        return replace(self, ar=0.0, rho=0.0, offset=0.0)


@dataclass(frozen=True)
class TableColumns:
    """The columns of the table and the run offsets at the rows of a campaign.

    shape: of the table; offset (n, r): run indicators
    """

    shape: ShapeColumns
    offset: Floats

    @classmethod
    def of(cls, campaign: CampaignRows, shape: Shape) -> TableColumns:
        """The columns of a table shape at a campaign's rows."""
        return cls(shape.columns(campaign.x, campaign.d), run_columns(campaign))

    @cached_property
    def stacked(self) -> Floats:
        """All columns (n, p), the table's first."""
        return np.asarray(np.hstack([self.shape.stacked, self.offset]), dtype=np.float64)

    @property
    def table_width(self) -> int:
        """Number of the table's columns."""
        return int(self.stacked.shape[1] - self.offset.shape[1])

    def ridge(self, noise: Noise) -> Floats:
        """Ridge of each column, shape (p,): inverse variance ratio, 0 where free."""
        table = self.shape
        widths = [part.shape[1] for part in (table.free, table.even, table.odd, table.given, self.offset)]
        values = (0.0, 1.0 / noise.even, 1.0 / noise.odd, 1.0, 1.0 / max(noise.offset, 1e-5) ** 2)
        return np.asarray(np.repeat(values, widths), dtype=np.float64)


@dataclass(frozen=True)
class Extra:
    """Columns beside the table: free (n, q), and random (n, s) with unit prior variance ratio."""

    free: Floats
    random: Floats

    @classmethod
    def none(cls, rows: int) -> Extra:
        """No columns, for `rows` rows."""
        return cls(np.zeros((rows, 0)), np.zeros((rows, 0)))

    def plus(self, other: Extra) -> Extra:
        """The columns of both."""
        return Extra(side_by_side(self.free, other.free), side_by_side(self.random, other.random))


def side_by_side(first: Floats, second: Floats) -> Floats:
    """The columns of both; the first itself where the second has none."""
    return np.hstack([first, second]) if second.shape[1] else first


def run_columns(campaign: CampaignRows) -> Floats:
    """Indicator of each run, shape (n, r); none for a single run."""
    count = campaign.runs if campaign.runs > 1 else 0
    return np.asarray(campaign.run[:, None] == np.arange(count), dtype=np.float64)


class Whitened:
    """Rows of a campaign under one (ar, rho), table columns whitened: over the scale of each row, their noise has covariance
    1 + ar²·rho^|lag| within each pass.
    """

    def __init__(self, campaign: CampaignRows, table: TableColumns, ar: float, rho: float) -> None:
        self.campaign, self.columns, self.ar, self.rho = campaign, table, ar, rho
        self._bounds = np.flatnonzero(np.concatenate([[True], np.diff(campaign.sweep) != 0, [True]]))
        self._inverse: dict[int, Floats] = {}
        self._lower: dict[int, Floats] = {}
        self.log_v = np.zeros(len(campaign))
        if campaign.scale is not None:
            self.log_v += 2.0 * np.log(campaign.scale)
        for start, stop in pairwise(self._bounds):
            size = int(stop - start)
            if size not in self._inverse:
                lag = np.abs(np.subtract.outer(np.arange(size), np.arange(size)))
                lower = cholesky(np.eye(size) + ar**2 * rho**lag)
                self._lower[size] = lower
                self._inverse[size] = inverse_of_lower(lower)
            self.log_v[start:stop] -= 2.0 * np.log(np.diag(self._inverse[size]))
        self.table = self.whiten(table.stacked)
        self.gram = self.table.T @ self.table

    def whiten(self, columns: NDArray[Precision]) -> NDArray[Precision]:
        """Columns (n, …) transformed so that the noise is white and of one size; single precision stays single."""
        if self.campaign.scale is not None:
            columns = columns / _beside(self.campaign.scale, columns)
        if self.ar == 0.0:
            return columns
        out = np.empty_like(columns)
        for start, stop in pairwise(self._bounds):
            inverse = self._inverse[int(stop - start)].astype(columns.dtype, copy=False)
            out[start:stop] = inverse @ columns[start:stop]
        return out

    def colour(self, white: Floats) -> Floats:
        """Inverse of `whiten`."""
        out = white
        if self.ar != 0.0:
            out = np.empty_like(white)
            for start, stop in pairwise(self._bounds):
                out[start:stop] = self._lower[int(stop - start)] @ white[start:stop]
        return out if self.campaign.scale is None else out * _beside(self.campaign.scale, white)


def _beside(scale: Floats, columns: NDArray[Precision]) -> NDArray[Precision]:
    """The scale of each row, (n,), shaped to go with columns (n, …)."""
    return scale.astype(columns.dtype).reshape(-1, *(1,) * (columns.ndim - 1))


class Projection:
    """A campaign under one noise model, with the table, the offsets and further columns projected out.

    whitened: the rows; noise: with the same (ar, rho); y: errors (n,) or (n, b), raw
    beside: raw columns in every fit; out: rows left out, shape (n,) bool, or None
    Raises numpy.linalg.LinAlgError for columns that are not independent.
    """

    def __init__(
        self,
        whitened: Whitened,
        noise: Noise,
        y: Floats,
        beside: Extra | None = None,
        out: NDArray[np.bool_] | None = None,
    ) -> None:
        self.whitened, self.noise = whitened, noise
        self.keep = None if out is None else (~out).astype(np.float64)
        self.out = None if out is None else np.flatnonzero(out)
        self.extra = Extra.none(len(y)) if beside is None else beside
        self.beside = self.prepared(np.hstack([self.extra.random, self.extra.free]))
        self.errors, self.y = y, self.prepared(y)
        q, s = self.extra.free.shape[1], self.extra.random.shape[1]
        ridge = np.concatenate([whitened.columns.ridge(noise), np.ones(s), np.zeros(q)])
        gram = whitened.gram
        table = whitened.table
        if self.out is not None:
            gram = gram - table[self.out].T @ table[self.out]
        if q + s:
            cross = table.T @ self.beside
            gram = np.block([[gram, cross], [cross.T, self.beside.T @ self.beside]])
        else:
            gram = gram.copy()
        diagonal = np.einsum("ii->i", gram)  # a view
        diagonal += ridge
        diagonal += 1e-11 * np.maximum(diagonal, 1e-12 * diagonal.max())
        self.lower = cholesky(gram)
        self.inverse_lower = inverse_of_lower(self.lower)
        self.y_shadow = self.shadow(self.y)
        self.rows = len(y) - (0 if self.out is None else len(self.out))
        self.dof = self.rows - int(np.sum(ridge == 0.0))
        self.rss = np.maximum(np.sum(self.y**2, axis=0) - np.sum(self.y_shadow**2, axis=0), 1e-300)
        random = ridge[ridge > 0]
        log_v = float(np.sum(whitened.log_v if self.keep is None else whitened.log_v * self.keep))
        p = len(ridge) - q
        self._constant = (
            log_v + 2.0 * float(np.sum(np.log(np.diag(self.lower)[:p]))) - float(np.sum(np.log(random)))
        ) - 2.0 * noise.log_prior()

    def prepared(self, columns: Floats) -> Floats:
        """Whitened columns, with the rows left out set to zero."""
        w = self.whitened.whiten(columns)
        if self.keep is None:
            return w
        return w * (self.keep if w.ndim == 1 else self.keep[:, None])

    def shadow(self, prepared: Floats) -> Floats:
        """R⁻ᵀC'z, the components of z along the projected columns C = QR; z'Pz = z'z - shadow'shadow."""
        cross = self.whitened.table.T @ prepared
        if self.beside.shape[1]:
            cross = np.concatenate([cross, self.beside.T @ prepared])
        return self.solve_lower(cross)

    @cached_property
    def projected(self) -> Floats:
        """Whitened columns N of everything projected out, (n, p), with Py = y - N N'y."""
        return np.asarray(np.hstack([self.whitened.table, self.beside]) @ self.inverse_lower.T)

    @cached_property
    def rest(self) -> Floats:
        """Prepared errors with everything projected out, shape (n,) or (n, b).

        z'Py = z'rest for whitened columns z, of the rows kept.
        """
        fitted = self.whitened.table @ self._coefficients[: self.whitened.table.shape[1]]
        fitted += self.beside @ self._coefficients[self.whitened.table.shape[1] :]
        rest = self.y - fitted
        if self.out is not None:
            rest[self.out] = 0.0
        return np.asarray(rest)

    @property
    def unexplained(self) -> Floats:
        """Whitened errors less what the rows that were not left out give the projected columns, of every row, shape (n,)."""
        design = np.hstack([self.whitened.table, self.whitened.whiten(np.hstack([self.extra.random, self.extra.free]))])
        return np.asarray(self.whitened.whiten(self.errors) - design @ self._coefficients)

    @cached_property
    def _coefficients(self) -> Floats:
        """Of the projected columns, table first, shape (p + q,) or (p + q, b)."""
        return np.asarray(self.inverse_lower.T @ self.y_shadow)

    def solve_lower(self, cross: Floats) -> Floats:
        """R⁻ᵀ of cross products with the projected columns, shape (p + q, …)."""
        return self.inverse_lower @ cross

    @property
    def log_null(self) -> Floats:
        """Log marginal likelihood of table and noise (REML) up to a constant of the rows, shape () or (b,).

        With columns beside it is that of noise alone only when the same `beside` is compared.
        """
        return np.asarray(-0.5 * (self._constant + self.dof * np.log(self.rss)))

    def normal(self, z: Floats) -> tuple[Floats, Floats]:
        """Z'PZ (k, k) and Z'Py (k,) of raw columns z (n, k)."""
        w = self.prepared(z)
        shadow = self.shadow(w)
        return w.T @ w - shadow.T @ shadow, w.T @ self.y - shadow.T @ self.y_shadow

    def rms_left(self, course: Floats) -> float:
        """Root mean square of what is left of a course of the rows (n,) beside everything projected out, in its unit, above 0."""
        normal, _ = self.normal(course[:, None])
        return math.sqrt(max(float(normal[0, 0]), 1e-300) / len(course))

    def gain(self, z: Floats) -> float:
        """Log Bayes factor of the columns against none, by the g-prior with unit information."""
        k = z.shape[1]
        if k == 0:
            return 0.0
        a, b = self.normal(z)
        explained = explained_by(a, b)
        return float(bayes_factor(np.asarray(explained), np.asarray(self.rss), self.dof, k, self.rows))

    def estimate(self, z: Floats) -> Floats:
        """Coefficients of the columns z (n, k) beside the table, shape (k,)."""
        a, b = self.normal(z)
        return np.asarray(np.linalg.lstsq(a, b, rcond=1e-12)[0], dtype=np.float64)

    def solve(self, z: Floats) -> Solution:
        """Generalised least squares of the columns z (n, k) beside the table."""
        k = z.shape[1]
        a, b = self.normal(z)
        inverse = np.linalg.pinv(a, rcond=1e-12, hermitian=True) if k else np.zeros((0, 0))
        coefficients = inverse @ b
        rss = float(self.rss) - float(b @ coefficients)
        variance = max(rss, 0.0) / max(self.dof - k, 1)
        rest = self.y - self.prepared(z) @ coefficients if k else self.y
        design = np.hstack([self.whitened.table, self.beside])
        table = np.asarray(cho_solve((self.lower, True), design.T @ rest))
        return Solution(coefficients, inverse * variance, variance, table, rest - design @ table)


@dataclass(frozen=True)
class Solution:
    """coefficients (k,), their covariance (k, k), white variance, table coefficients (p + q,), whitened residual (n,)."""

    coefficients: Floats
    covariance: Floats
    variance: float
    table: Floats
    residual: Floats


OF_NOISE = 10.0
"""Least g times the share of the squares that is left: a g-prior counts 1 / (g · left) of the noise more, out of the effect.

With g = n a cause of 28 times the noise was worth no more under white noise than under one with memory (the information paradox: Liang
et al., J. Am. Stat. Assoc. 103, 2008). Causes below sqrt(n / 10) of the noise, 5 times of 300 rows, have g = n. With 1 one of two such
causes was still missed. On the demo's rows after the loop 0.18 µm are left with 1 to 3, 0.21 with g = n and with 5 and 10; with 1 to
3, though, a declared table of the same rows changes the verdict of a machine with three causes.
"""


def cholesky(gram: Floats) -> Floats:
    """Lower Cholesky factor. Raises numpy.linalg.LinAlgError for a matrix that is not positive definite."""
    return np.asarray(np.linalg.cholesky(gram), dtype=np.float64)


def inverse_of_lower(lower: Floats) -> Floats:
    """L⁻¹, so that many right-hand sides are one product."""
    inverse, _ = dtrtri(lower, lower=1)
    return np.asarray(inverse, dtype=np.float64)


def explained_by(a: Floats, b: Floats) -> float:
    """b'a⁻¹b of normal equations that may be singular."""
    root = np.sqrt(np.maximum(np.diag(a), 1e-300))
    scaled = a / np.outer(root, root) + 1e-9 * np.eye(len(a))
    c = b / root
    return float(c @ np.linalg.solve(scaled, c))


def bayes_factor(explained: Reals, rss: Floats, dof: int, width: Ints | int, information: int) -> Floats:
    """Log Bayes factor of the g-prior for blocks of `width` columns that explain `explained` of `rss`; g: `information`, or more
    (`OF_NOISE`).
    """
    left = np.clip(1.0 - explained / rss, 1e-12, 1.0)
    g = np.maximum(float(information), OF_NOISE / left)
    return np.asarray(0.5 * (dof - width) * np.log1p(g) - 0.5 * dof * np.log1p(g * left))


def random_gain(projection: Projection, design: Floats) -> tuple[Floats, Floats]:
    """Log evidence of the columns (n, r) as one random effect over none, and its best variance ratio.

    Each of shape () or (b,) as the errors of the projection.
    """
    w = projection.prepared(design)
    shadow = projection.shadow(w)
    b = w.T @ projection.y - shadow.T @ projection.y_shadow
    return evidence_of_random(w.T @ w - shadow.T @ shadow, b, projection.rss, projection.dof)


def evidence_of_random(normal: Floats, b: Reals, rss: Floats, dof: int) -> tuple[Floats, Floats]:
    """The same from the normal equations (r, r) and (r,) or (r, b), with the residual sum of squares of none, () or (b,)."""
    values, vectors = np.linalg.eigh(normal)
    c2 = (vectors.T @ b) ** 2
    ratios = np.array(VARIANCES)
    information = ratios[:, None] * np.maximum(values, 0.0)
    left = np.maximum(1.0 - (ratios[:, None] / (1.0 + information)) @ c2 / rss, 1e-12)
    lost = 0.5 * np.sum(np.log1p(information), axis=1) + 1.0
    gains = -0.5 * dof * np.log(left) - (lost if b.ndim == 1 else lost[:, None])
    return np.max(gains, axis=0), ratios[np.argmax(gains, axis=0)]


class LinearCampaign:
    """A campaign as a linear model: the shape of its table, its columns, and the whitenings made so far."""

    def __init__(self, campaign: CampaignRows, shape: Shape | None = None) -> None:
        self.campaign = campaign
        self.shape: Shape = SplineShape(campaign.basis) if shape is None else shape
        self.table = TableColumns.of(campaign, self.shape)
        self._whitened: dict[tuple[float, float], Whitened] = {}

    @property
    def rough(self) -> bool:
        """Whether the roughness of the table is estimated."""
        return bool(self.table.shape.even.shape[1])

    def whitened(self, noise: Noise) -> Whitened:
        """The campaign whitened under (ar, rho) of a noise model; cached."""
        key = (noise.ar, noise.rho if noise.ar else 0.0)
        if key not in self._whitened:
            if len(self._whitened) > 24:
                self._whitened.clear()
            self._whitened[key] = Whitened(self.campaign, self.table, *key)
        return self._whitened[key]

    def projection(
        self, noise: Noise, y: Floats, beside: Extra | None = None, out: NDArray[np.bool_] | None = None
    ) -> Projection:
        """The projection of errors y under a noise model, see `Projection`."""
        return Projection(self.whitened(noise), noise, y, beside, out)
