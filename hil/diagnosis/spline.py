"""The pitch table as columns of a linear model: natural cubic splines on knots, split into a free and a penalised part.

The columns are bases of a smooth function of position per direction, f(x) + d·g(x). The penalised columns are scaled so
that a normal prior of one common variance on them is the smoothing spline (Green & Silverman 1994, ch. 2; Ruppert, Wand
& Carroll 2003, ch. 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]

SAME_TARGET = 0.05
"""Targets nearer than this fraction of the mean spacing of a pass count as one target repeated."""
MOST_KNOTS = 60
"""Most knots of a table."""
KNOTS_PER_TARGET = 1.5


def clusters(target_mm: Floats, spacing_mm: float) -> tuple[Floats, NDArray[np.int64]]:
    """Groups near-equal targets: their mean positions (mm), ascending, and the index of each row's group, shape
    (n,).
    """
    order = np.argsort(target_mm, kind="stable")
    ordered = target_mm[order]
    starts = np.concatenate([[True], np.diff(ordered) > SAME_TARGET * spacing_mm])
    label_ordered = np.cumsum(starts) - 1
    label = np.empty(len(target_mm), dtype=np.int64)
    label[order] = label_ordered
    means = np.bincount(label_ordered, weights=ordered) / np.bincount(label_ordered)
    return np.asarray(means, dtype=np.float64), label


def mean_spacing(target_mm: Floats, rows_per_pass: int) -> float:
    """Travel over the steps of one pass, mm; never zero."""
    travel = float(np.ptp(target_mm))
    return max(travel / max(rows_per_pass - 1, 1), 1e-9)


def choose_knots(target_mm: Floats, rows_per_pass: int) -> tuple[Floats, bool]:
    """Knots for the table, mm, and whether the targets repeat (then the knots are the targets themselves)."""
    centres, _ = clusters(target_mm, mean_spacing(target_mm, rows_per_pass))
    most = int(min(MOST_KNOTS, max(6, round(KNOTS_PER_TARGET * rows_per_pass))))
    repeated = len(centres) <= 1.3 * rows_per_pass and len(target_mm) >= 1.5 * len(centres)
    if len(centres) <= most:
        return centres, repeated
    return np.asarray(np.quantile(centres, np.linspace(0.0, 1.0, most)), dtype=np.float64), False


@dataclass(frozen=True)
class TableBasis:
    """Knots (K,) in mm and whether both directions are present; columns are even (f) and odd (d·g) functions of
    direction.
    """

    knots_mm: Floats
    both_directions: bool

    @property
    def parts(self) -> int:
        """Number of parts: 2 (even, odd), or 1 for one direction."""
        return 2 if self.both_directions else 1

    def at(self, x_mm: Floats) -> Floats:
        """Natural cubic spline cardinal functions, shape (n, K); straight lines beyond the outer knots."""
        return cardinal(self.knots_mm, x_mm)

    def free(self, x_mm: Floats, direction: Floats) -> Floats:
        """Unpenalised columns, shape (n, f): 1, u (and d, d·u)."""
        centre, half = self._scale()
        line = np.column_stack([np.ones(len(x_mm)), (x_mm - centre) / half])[:, : min(2, len(self.knots_mm))]
        return np.hstack([line, line * direction[:, None]]) if self.both_directions else line

    def penalised(self, x_mm: Floats) -> Floats:
        """Penalised columns of one part, shape (n, K - 2), unit prior variance = the smoothing spline's."""
        if len(self.knots_mm) < 3:
            return np.zeros((len(x_mm), 0))
        return np.asarray(self.at(x_mm) @ self._roots)

    def _scale(self) -> tuple[float, float]:
        low, high = float(self.knots_mm[0]), float(self.knots_mm[-1])
        return (low + high) / 2, max((high - low) / 2, 1e-9)

    @cached_property
    def _roots(self) -> Floats:
        """Knot values of the penalised columns, shape (K, K - 2)."""
        centre, half = self._scale()
        t = (self.knots_mm - centre) / half
        h = np.diff(t)
        K = len(t)
        Q = np.zeros((K, K - 2))
        R = np.zeros((K - 2, K - 2))
        for j in range(1, K - 1):
            Q[j - 1, j - 1] = 1 / h[j - 1]
            Q[j, j - 1] = -1 / h[j - 1] - 1 / h[j]
            Q[j + 1, j - 1] = 1 / h[j]
            R[j - 1, j - 1] = (h[j - 1] + h[j]) / 3
            if j < K - 2:
                R[j - 1, j] = R[j, j - 1] = h[j] / 6
        penalty = Q @ np.linalg.solve(R, Q.T)
        values, vectors = np.linalg.eigh((penalty + penalty.T) / 2)
        return np.asarray(vectors[:, 2:] / np.sqrt(values[2:]))


def cardinal(knots_mm: Floats, x_mm: Floats) -> Floats:
    """Natural spline functions that are 1 at one knot and 0 at the others, at x, shape (n, K)."""
    K = len(knots_mm)
    if K == 1:
        return np.ones((len(x_mm), 1))
    if K == 2:
        share = (x_mm - knots_mm[0]) / (knots_mm[1] - knots_mm[0])
        return np.column_stack([1 - share, share])
    spline = CubicSpline(knots_mm, np.eye(K), bc_type="natural")
    inside = np.clip(x_mm, knots_mm[0], knots_mm[-1])
    values = np.asarray(spline(inside))
    beyond = x_mm - inside
    outside = np.flatnonzero(beyond)
    if len(outside):
        values[outside] += beyond[outside, None] * np.asarray(spline(inside[outside], 1))
    return values
