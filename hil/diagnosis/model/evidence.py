"""The evidence: the probability of the errors under parts and a noise model, by one Cholesky factor, with its gradient.

With the rows over their noise, A = [Z X R] (random columns with ridge 1/variance, fixed ones without), C the columns of the effects
and L the Cholesky factor of the bordered Gram matrix [A C y]'[A C y] + ridge:

    rss₁ = L²yy,  rss₀ = rss₁ + Σ L²y,C,  left = rss₁ / rss₀,  ν = n - columns of X,  g = max(n, 10 / left)
    log p = -½ (log|A'A + ridge| - Σ log ridge + log|V| + ν log rss₀)
            + ½ (ν - k) log(1 + g) - ½ ν log(1 + g left) + log prior(noise) + Σ log prior(part)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.campaign import Floats, Ints, Singles
from hil.diagnosis.model.numeric import highest, inverse_of_lower
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.rows import MEMORIES, NO_MEMORY, OFFSET, ModelRows, NoiseMemory
from hil.effects import Effect, Form

LOWEST = np.array([-7.0, -7.0, -5.0])
HIGHEST = np.array([7.0, 7.0, 7.0])
"""Bounds of the log standard deviations of the table's two parts and of the runs' offsets, over the white noise."""
START = np.array([1.0, 0.0, -1.5])
LEAST_LEFT = 1e-4
"""Share of a column's squares that must be left beside everything else for it to count, in single precision."""
KINDS = ("random", "absorbed", "free")
"""Columns of a part, in their order."""
RATIOS = 10.0 ** np.arange(-3.0, 4.1, 0.5)
"""Variances of a random part that are tried."""


@dataclass(frozen=True)
class Noise:
    """Memory, and log standard deviations of the table's parts and of the runs' offsets over the white noise, (3,)."""

    memory: NoiseMemory
    log_sd: Floats

    @property
    def offset(self) -> float:
        """Standard deviation of the runs' offsets, in white noise."""
        return math.exp(float(self.log_sd[OFFSET]))

    @property
    def log_prior(self) -> float:
        return -0.5 * (self.memory.ar / USUAL.correlated) ** 2 - math.log1p((self.offset / USUAL.correlated) ** 2)

    @property
    def has_large_offsets(self) -> bool:
        """Whether the runs' offsets are beyond the scale of their prior: a cause may be all of them."""
        return self.offset > USUAL.correlated

    def with_usual_offsets(self) -> Noise:
        """The same with offsets of the scale of their prior."""
        return replace(self, log_sd=np.minimum(self.log_sd, np.array([np.inf, np.inf, math.log(USUAL.correlated)])))


@dataclass(frozen=True)
class Candidate:
    """An effect in one form with its non-linear parameters.

    ratio: variance of its coefficients over the noise's, of a shrunk form; absorbed: a declared table was measured with some of it
    """

    effect: Effect
    form: Form
    theta: tuple[float, ...]
    ratio: float = 1.0
    absorbed: bool = False


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the model: an effect, or a remainder (`of` is None).

    names: columns that it follows; free (n, k): g-prior; random (n, r): variance 1; absorbed (n, a): g-prior, what a declared table
    took of it; log_prior: with what the choice on its grid costs
    """

    name: str
    names: tuple[str, ...]
    free: Floats
    random: Floats
    absorbed: Floats
    log_prior: float = 0.0
    of: Candidate | None = None

    @property
    def is_remainder(self) -> bool:
        return self.of is None


def log_bayes(left: Floats, dof: float, k: int, n: int) -> Floats:
    """Log Bayes factor of k columns with a g-prior that leave these shares of the squares."""
    left = np.clip(left, 1e-12, 1.0)
    g = np.maximum(n, 10.0 / left)
    return np.asarray(0.5 * (dof - k) * np.log1p(g) - 0.5 * dof * np.log1p(g * left))


def _log_bayes_slope(left: float, dof: float, k: int, n: int) -> float:
    """Its derivative to the share left."""
    left = min(max(left, 1e-12), 1.0)
    g = max(float(n), 10.0 / left)
    if g > n:  # g left = 10 is constant
        return -0.5 * (dof - k) * 10.0 / left**2 / (1.0 + g)
    return -0.5 * dof * g / (1.0 + g * left)


class Profile:
    """The evidence under one memory as a function of the log standard deviations.

    columns: of the parts, (n, r + k); white: Z X R C over the noise of the rows, of which C are the last k. X and R have one prior
    under all of them and are eliminated once.
    """

    def __init__(self, rows: ModelRows, parts: Sequence[Part], memory: NoiseMemory) -> None:
        self.rows, self.memory, base = rows, memory, rows.whitened(memory)
        none = np.zeros((rows.n, 0))
        random, *others = (np.hstack([none, *(getattr(part, kind) for part in parts)]) for kind in KINDS)
        self.columns = np.hstack([random, *others])
        own = rows.white(self.columns, memory)
        self.white, self.y, self._log_noise = np.hstack([base.columns, own]), base.y, base.log_noise
        at, m, q = base.columns.shape[1], self.white.shape[1], len(rows.group)
        self._p = at + random.shape[1]
        self.k, self.dof = m - self._p, rows.n - rows.fixed.shape[1]
        self._variance_1 = np.zeros(m - q)
        self._variance_1[at - q : self._p - q] = 1.0
        gram = np.empty((m + 1, m + 1))
        gram[:at, :at] = base.gram
        gram[at:-1, :-1] = own.T @ self.white
        gram[:at, at:-1] = gram[at:-1, :at].T
        gram[-1, :-1] = gram[:-1, -1] = self.y @ self.white
        gram[-1, -1] = self.y @ self.y
        gram[np.arange(m), np.arange(m)] *= 1.0 + 1e-10
        self._gram = gram

    @cached_property
    def _beside(self) -> tuple[Floats, float]:
        """Products of Z, C and the errors with X and R eliminated, and the log determinant of these."""
        gram, q, p = self._gram, len(self.rows.group), self._p
        z_c_y = np.r_[:q, p : len(gram)]
        root = np.linalg.cholesky(gram[q:p, q:p] + np.diag(self._variance_1[: p - q]))
        onto = inverse_of_lower(root) @ gram[q:p, z_c_y]
        return gram[np.ix_(z_c_y, z_c_y)] - onto.T @ onto, 2.0 * float(np.sum(np.log(np.diag(root))))

    def ridge(self, log_sd: Floats) -> Floats:
        """Inverse variances of the columns, 0 of those without a prior of their own."""
        return np.concatenate([np.exp(-2.0 * np.append(log_sd, [0.0, 0.0])[self.rows.group]), self._variance_1])

    def gram(self, log_sd: Floats) -> Floats:
        """Products of the columns and, last, the errors, with the ridge, (m + 1, m + 1)."""
        return self._gram + np.diag(np.append(self.ridge(log_sd), 0.0))

    def value(self, log_sd: Floats) -> tuple[float, Floats]:
        """Log evidence without the priors of the parts, and its gradient, (3,)."""
        q = len(self.rows.group)
        ridge, (beside, log_x_r) = self.ridge(log_sd)[:q], self._beside
        try:
            lower = np.linalg.cholesky(beside + np.diag(np.append(ridge, np.zeros(self.k + 1))))
        except np.linalg.LinAlgError:
            return -1e9, np.zeros(3)
        diagonal, last = np.diag(lower), lower[-1, :-1]
        rss = float(diagonal[-1]) ** 2
        rss_0 = rss + float(last[q:] @ last[q:])
        inverse = inverse_of_lower(lower[:-1, :-1])[:, :q]
        b_0 = last[:q] @ inverse[:q]
        logs = log_x_r + 2.0 * float(np.sum(np.log(diagonal[:q]))) - float(np.sum(np.log(ridge)))
        value = -0.5 * (logs + self._log_noise + self.dof * math.log(rss_0)) + Noise(self.memory, log_sd).log_prior
        slope = ridge * (np.einsum("ij,ij->j", inverse[:q], inverse[:q]) + self.dof * b_0**2 / rss_0) - 1.0
        if self.k:
            left = rss / rss_0
            value += float(log_bayes(np.array(left), self.dof, self.k, self.rows.n))
            d_left = -2.0 * ridge * ((last @ inverse) ** 2 - left * b_0**2) / rss_0
            slope = slope + _log_bayes_slope(left, self.dof, self.k, self.rows.n) * d_left
        gradient = np.asarray(np.bincount(self.rows.group, slope, 3)[:3], dtype=np.float64)
        offset = (math.exp(float(log_sd[OFFSET])) / USUAL.correlated) ** 2
        gradient[OFFSET] -= 2.0 * offset / (1.0 + offset)
        return value, gradient


@dataclass(frozen=True)
class Scored:
    """Log evidence, priors of the parts included, and the noise model at which it is highest."""

    log_p: float
    noise: Noise


def _prior(parts: Sequence[Part]) -> float:
    return sum(part.log_prior for part in parts)


def score(rows: ModelRows, parts: Sequence[Part], near: Noise | None = None) -> list[Scored]:
    """The parts under noise models, the likeliest first; near: only its memory and none, from its standard deviations."""
    memories = MEMORIES if near is None else tuple(dict.fromkeys((near.memory, NO_MEMORY)))
    start = START if near is None else near.log_sd
    found = []
    for memory in memories:
        profile = Profile(rows, parts, memory)
        value, start = highest(profile.value, start, LOWEST, HIGHEST, 12 if near is None else 6)
        found.append(Scored(value + _prior(parts), Noise(memory, start)))
    return sorted(found, key=lambda one: -one.log_p)


class Fit:
    """Parts under one noise model: coefficients, residual, and what further columns would gain."""

    def __init__(self, rows: ModelRows, parts: Sequence[Part], noise: Noise) -> None:
        self.rows, self.parts, self.noise = rows, tuple(parts), noise
        self._profile = profile = Profile(rows, parts, noise.memory)
        self._base = profile.white.shape[1] - profile.columns.shape[1]
        self.white, self.y = profile.white, profile.y
        self.ridge = profile.ridge(noise.log_sd)
        gram = profile.gram(noise.log_sd)
        self.inverse = inverse_of_lower(np.linalg.cholesky(gram[:-1, :-1]))
        self.beta = np.asarray(self.inverse.T @ (self.inverse @ gram[:-1, -1]))
        self.rest = self.y - self.white @ self.beta
        self.rss = float(self.y @ self.rest)
        self.dof = max(profile.dof - profile.k, 1)

    @cached_property
    def log_p(self) -> float:
        """Log evidence, priors of the parts included."""
        return self._profile.value(self.noise.log_sd)[0] + _prior(self.parts)

    @property
    def sigma(self) -> float:
        """Standard deviation of the white noise, µm."""
        return math.sqrt(max(self.rss, 1e-300) / self.dof)

    @property
    def spent(self) -> float:
        """Degrees of freedom that the fit takes: its columns, random ones as far as the rows determine them."""
        return len(self.ridge) - float(self.ridge @ np.einsum("ij,ij->j", self.inverse, self.inverse))

    @cached_property
    def covariance(self) -> Floats:
        """Of all coefficients, µm²."""
        return np.asarray(self.inverse.T @ self.inverse * self.sigma**2)

    def of_table(self) -> Ints:
        """Where the coefficients of the table's columns are, in the order of `ShapeColumns.stacked`."""
        return np.concatenate([np.arange(len(self.rows.group), self._base), self.rows.of_table]).astype(np.int64)

    def held(self, course_um: Floats) -> Floats:
        """Coefficients of the table's columns that hold what a table as smooth as this one can of a course of the rows, (n,)."""
        white = self.rows.whitened(self.noise.memory)
        right = white.columns.T @ self.rows.white(course_um, self.noise.memory)
        solved = np.linalg.solve(white.gram + np.diag(self.ridge[: self._base] + 1e-9), right)
        return np.asarray(solved[self.of_table()])

    def coefficients(self, part: Part) -> Floats:
        """Of an effect's own columns, µm in the units of its basis."""
        if part.of is not None and part.of.form.shrunk:
            return self.beta[self.where(part, "random")] * math.sqrt(part.of.ratio)
        return self.beta[self.where(part, "free")]

    def where(self, part: Part, kind: str) -> slice:
        """Coefficients of one part's columns of a kind."""
        first = self._base
        for name, one in itertools.product(KINDS, self.parts):
            if name == kind and one is part:
                break
            first += getattr(one, name).shape[1]
        return slice(first, first + getattr(part, kind).shape[1])

    def course_um(self, part: Part) -> Floats:
        """What a part contributes to each row, µm, (n,)."""
        return np.asarray(
            part.random @ self.beta[self.where(part, "random")] + part.free @ self.beta[self.where(part, "free")]
        )

    @cached_property
    def _own(self) -> Singles:
        """What sums columns of the rows to their products with the parts', (n, k)."""
        return self.rows.unwhite(self.white[:, self._base :], self.noise.memory).astype(np.float32)

    @cached_property
    def score(self) -> Singles:
        """Derivative of the likelihood to what each row is said to have, (n,)."""
        return self.rows.unwhite(self.rest, self.noise.memory).astype(np.float32)

    def beside(self, columns: Floats) -> Floats:
        """Columns (n, k) over the noise of their rows, with the fit projected out."""
        white = self.rows.white(columns, self.noise.memory)
        return np.asarray(white - self.white @ (self.inverse.T @ (self.inverse @ (self.white.T @ white))))

    def normal(self, columns: Floats) -> tuple[Floats, Floats]:
        """Normal equations of further columns (n, k) beside the fit: matrix (k, k), right side (k,)."""
        white = self.rows.white(columns, self.noise.memory)
        onto = self.inverse @ (self.white.T @ white)
        return white.T @ white - onto.T @ onto, white.T @ self.rest

    def gain(self, columns: Floats) -> float:
        """Log evidence that further columns with a g-prior would add."""
        a, b = self.normal(columns)
        size = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
        a, b = a * np.outer(size, size) + 1e-9 * np.eye(len(a)), b * size
        left = 1.0 - float(b @ np.linalg.solve(a, b)) / self.rss
        return float(log_bayes(np.array(left), self.dof, len(b), self.rows.n))

    def gains(self, rows: Singles, k: int, of: Hashable) -> Floats:
        """The same of groups of k columns, one a row, (G·k, n): (G,); in single precision; of: see `Rows.reduced`."""
        a, whole, b = self._products(rows, k, of)
        a = a + np.eye(k) * (LEAST_LEFT * np.max(whole, axis=1)[:, None, None] + 1e-20)
        solved = b / a[:, 0] if k == 1 else np.linalg.solve(a, b[:, :, None])[:, :, 0]
        return log_bayes(1.0 - np.sum(b * solved, axis=1) / self.rss, self.dof, k, self.rows.n)

    def _products(self, rows: Singles, k: int, of: Hashable) -> tuple[Floats, Floats, Floats]:
        """Of groups of k columns beside the fit: matrices (G, k, k), their diagonals without the fit (G, k), right sides (G, k)."""
        products, by_base = self.rows.reduced(rows, k, self.noise.memory, of)
        onto = np.hstack([by_base, rows @ self._own]) @ self.inverse.T.astype(np.float32)
        h = onto.reshape(-1, k, onto.shape[1])
        a = (products - h @ h.transpose(0, 2, 1)).astype(float)
        b = (rows @ self.score).reshape(-1, k).astype(float)
        return a, np.diagonal(products, axis1=1, axis2=2).astype(float), b

    def random_gain(self, columns: Floats) -> tuple[float, float]:
        """Log evidence that random columns would add at the best of their variances, and that variance."""
        a, b = self.normal(columns)
        gain, ratio = self._of_random(a[None], b[None])
        return float(gain[0]), float(ratio[0])

    def random_gains(self, rows: Singles, k: int, of: Hashable) -> Floats:
        """The gains of groups of k random columns, one a row, (G·k, n): (G,); in single precision."""
        a, _, b = self._products(rows, k, of)
        return self._of_random(a, b)[0]

    def _of_random(self, a: Floats, b: Floats) -> tuple[Floats, Floats]:
        """Gain and variance of G random blocks from their normal equations, (G, k, k) and (G, k)."""
        size, axes = np.linalg.eigh(a)
        size = size.clip(0.0)[:, None, :]
        b2 = np.einsum("gij,gi->gj", axes, b)[:, None, :] ** 2
        ratio = RATIOS[None, :, None]
        left = 1.0 - np.sum(ratio * b2 / (1.0 + ratio * size), axis=2) / self.rss
        gain = -0.5 * np.sum(np.log1p(ratio * size), axis=2) - 0.5 * self.dof * np.log(np.maximum(left, 1e-12))
        best = np.argmax(gain, axis=1)
        return np.max(gain, axis=1), RATIOS[best]
