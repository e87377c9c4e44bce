"""The fit of a campaign's noise model by evidence: roughness of its table, run offsets, correlation of its rows.

It uses cross products only, one factorisation per trial.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf
from scipy.optimize import minimize

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, bayes_factor, log_prior
from hil.diagnosis.policy import policy

Floats = NDArray[np.float64]

CORRELATIONS = ((0.0, 0.0), (0.5, 0.5), (0.35, 0.9), (1.0, 0.5), (0.7, 0.9), (1.2, 0.75), (2.5, 0.7))
"""Grid of (ar, rho): noise may be strong where its correlation lasts a few rows, weak where it lasts longer."""
WEAK_CORRELATIONS = 2
"""If so many correlations in the grid do not improve on none, the stronger ones are not tried."""
GROWTHS = np.geomspace(0.25, 16.0, 25)
"""How many times the noise at rest the fastest rows have beside it: tried."""


def robust_std(off: Floats) -> float:
    """Standard deviation of rows (n,) about zero, as of normal noise of their median magnitude: few that lie far off do not count."""
    return 1.4826 * float(np.median(np.abs(off)))


class Profile:
    """Evidence of noise parameters of one (ar, rho), from cross products alone: cheap enough to optimise over."""

    def __init__(
        self, linear: LinearCampaign, start: Noise, y: Floats, extra: Extra, out: NDArray[np.bool_] | None = None
    ) -> None:
        self.linear, self.start = linear, start
        whitened = linear.whitened(start)
        keep = slice(None) if out is None else ~out
        self.columns = whitened.columns
        self.random = extra.random.shape[1]
        self.p, self.k = whitened.table.shape[1] + self.random, extra.free.shape[1]
        more = whitened.whiten(np.hstack([extra.random, extra.free, y[:, None]]))[keep]
        wide = np.hstack([whitened.table[keep], more])
        self.gram = wide.T @ wide
        self.rows = len(wide)
        self.log_v = float(np.sum(whitened.log_v[keep]))
        table = self.columns.shape
        ends = np.cumsum(
            [part.shape[1] for part in (table.free, table.even, table.odd, table.given, self.columns.offset)]
        )
        self.given = int(ends[0])
        self.penalised = tuple(slice(int(ends[i - 1]), int(ends[i])) for i in (1, 2, 4))
        unit = np.arange(int(ends[2]), int(ends[3])), np.arange(int(ends[4]), self.p)
        for index in unit:
            self.gram[index, index] += 1.0
        self.smooth = math.isfinite(start.even) and self.columns.shape.even.shape[1] > 0
        self.smooth_odd = math.isfinite(start.odd) and self.columns.shape.odd.shape[1] > 0
        self.offsets = self.columns.offset.shape[1] > 0

    def pack(self, noise: Noise) -> Floats:
        """The optimised parameters of a noise model, logarithms."""
        values = [math.log(noise.even)] if self.smooth else []
        values += [math.log(noise.odd)] if self.smooth_odd else []
        values += [math.log(max(noise.offset, 0.05))] if self.offsets else []
        return np.array(values)

    def unpack(self, v: Floats) -> Noise:
        """The noise model of such parameters."""
        even, odd, offset = self._values(v)
        return replace(self.start, even=even, odd=odd, offset=offset)

    def _values(self, v: Floats) -> tuple[float, float, float]:
        """The table's variance ratios (even, odd part) and the run offset."""
        values = v.tolist()
        even = math.exp(min(max(values.pop(0), -20.0), 20.0)) if self.smooth else self.start.even
        odd = math.exp(min(max(values.pop(0), -20.0), 20.0)) if self.smooth_odd else self.start.odd
        offset = min(math.exp(max(values.pop(0), -6.0)), policy().most_offset) if self.offsets else self.start.offset
        return even, odd, offset

    def log_evidence(self, v: Floats) -> float:
        """Log marginal likelihood of table, noise and extra columns, the free ones under the g-prior."""
        p = self.p
        even, odd, offset = self._values(v)
        variances = (1.0 / even, 1.0 / odd, 1.0 / max(offset, 1e-5) ** 2)
        gram = self.gram.copy(order="F")  # the order in which it is factored without another copy
        diagonal = np.einsum("ii->i", gram)  # a view
        log_ridge, free = 0.0, self.given
        for where, ridge in zip(self.penalised, variances, strict=True):
            size = where.stop - where.start
            if ridge > 0.0:
                diagonal[where] += ridge
                log_ridge += size * math.log(ridge)
            else:
                free += size
        diagonal[:p] += 1e-11 * np.maximum(diagonal[:p], 1e-12 * float(diagonal[:p].max()))
        diagonal[p:-1] += 1e-9 * diagonal[p:-1] + 1e-30
        factor, failed = dpotrf(gram, lower=1, clean=0, overwrite_a=1)
        if failed and failed < len(gram):
            raise np.linalg.LinAlgError("table columns are not independent")
        root = np.einsum("ii->i", factor)
        last = factor[-1, p:-1]
        seen = float(last @ last)  # what the free columns explain beside the rest
        rss = max(seen + (0.0 if failed else float(root[-1]) ** 2), 1e-300)
        dof = self.rows - free
        constant = self.log_v + 2.0 * float(np.log(root[:p]).sum()) - log_ridge
        value = -0.5 * (constant + dof * math.log(rss)) + log_prior(self.start.ar, self.start.rho, offset)
        if self.k:
            value += float(bayes_factor(np.array(seen), np.array(rss), dof, self.k, self.rows))
        return value

    def best(self, point: Floats, step: float, trials: int = 30) -> tuple[float, Floats]:
        """Highest evidence and where, from a starting point, by at most `trials` evaluations per parameter."""
        if len(point) == 0:
            return self.log_evidence(point), point
        simplex = np.vstack([point, point + step * np.eye(len(point))])
        options = {"initial_simplex": simplex, "maxfev": trials * len(point), "xatol": 0.1, "fatol": 0.03}
        result = minimize(lambda v: -self.log_evidence(v), point, method="Nelder-Mead", options=options)
        return -float(result.fun), np.asarray(result.x, dtype=np.float64)


def fit_noise(
    linear: LinearCampaign,
    y: Floats,
    extra: Extra,
    start: Noise,
    *,
    correlations: tuple[tuple[float, float], ...] = CORRELATIONS,
    near: bool = False,
    out: NDArray[np.bool_] | None = None,
) -> Noise:
    """The noise model of highest evidence with the extra columns in the fit.

    The table's variances (where they are finite in `start`) and the run offsets are optimised for each (ar, rho) of a
    grid, which is left when more correlation no longer helps. near: the start is already close. Raises
    numpy.linalg.LinAlgError for table columns that are not independent.
    """
    best: tuple[float, Noise] | None = None
    point: Floats | None = None
    for i, (ar, rho) in enumerate(correlations):
        if best is not None and i > WEAK_CORRELATIONS and best[1].ar == 0.0:
            break
        profile = Profile(linear, replace(start, ar=ar, rho=rho), y, extra, out)
        step, trials = (1.2, 30) if point is None and not near else (0.4, 30 if not near else 12)
        value, found = profile.best(profile.pack(start) if point is None else point, step, trials)
        if best is None or value > best[0]:
            best, point = (value, profile.unpack(found)), found
    return start if best is None else best[1]


def noise_with_speed(left_um: Floats, campaign: CampaignRows) -> Floats | None:
    """Relative standard deviation of each row's noise, (n,), its root mean square 1, where it grows with the speed; None where it does
    not.

    left_um: of each row, (n,). It is fitted as 1 + f·speed by the mean magnitude (Laplace's distribution): few rows may lie far off.
    """
    if not campaign.survey.has("velocity_mm_s"):
        return None
    size, speed = np.abs(left_um), np.abs(campaign.columns["velocity_mm_s"])
    size = np.minimum(size, policy().far_off * robust_std(left_um))
    if not np.any(size):
        return None
    scales = 1.0 + GROWTHS[:, None] * speed / float(np.max(speed))
    worth = -len(size) * np.log(np.mean(size / scales, axis=1) / np.mean(size)) - np.sum(np.log(scales), axis=1)
    best = int(np.argmax(worth))
    if worth[best] < policy().decisive:
        return None
    return np.asarray(scales[best] / np.sqrt(np.mean(scales[best] ** 2)))
