"""The table part of a fit: its columns, and the conversion of its coefficients into a table.

Two shapes: a spline fitted from the records themselves, and a declared table that may only change within its stated uncertainty. The
spline's columns are bases of a smooth function of position per direction, f(x) + d·g(x): natural cubic splines on knots, split into a
free and a penalised part. The penalised columns are scaled so that a normal prior of one common variance on them is the smoothing
spline (Green & Silverman 1994, ch. 2; Ruppert, Wand & Carroll 2003, ch. 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.effects.model import PitchTable
from hil.records.rows import Floats

SAME_TARGET = 0.05
"""Targets nearer than this fraction of the mean spacing of a pass count as one target repeated."""
MOST_KNOTS = 60
"""Most knots of a table."""
KNOTS_PER_TARGET = 1.5
UNKNOWN_SHARE = 0.5
"""Standard deviation of the nodes of a declared table that states none, over the white noise."""


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
    inside = np.clip(x_mm, knots_mm[0], knots_mm[-1])
    values, slopes = _natural_spline(knots_mm, inside)
    return np.asarray(values + (x_mm - inside)[:, None] * slopes)


def _natural_spline(knots_mm: Floats, x_mm: Floats) -> tuple[Floats, Floats]:
    """The same within the knots, three or more, with its slope (de Boor, A Practical Guide to Splines, ch. IV)."""
    K = len(knots_mm)
    h = np.diff(knots_mm)
    slope = np.diff(np.eye(K), axis=0) / h[:, None]
    matrix = np.diag((h[:-1] + h[1:]) / 3.0) + np.diag(h[1:-1] / 6.0, 1) + np.diag(h[1:-1] / 6.0, -1)
    second = np.vstack([np.zeros(K), np.linalg.solve(matrix, np.diff(slope, axis=0)), np.zeros(K)])
    j = np.clip(np.searchsorted(knots_mm, x_mm, side="right") - 1, 0, K - 2)
    a = ((knots_mm[j + 1] - x_mm) / h[j])[:, None]
    b = 1.0 - a
    square = (h[j] ** 2 / 6.0)[:, None]
    eye = np.eye(K)
    values = a * eye[j] + b * eye[j + 1] + square * ((a**3 - a) * second[j] + (b**3 - b) * second[j + 1])
    third = (h[j] / 6.0)[:, None]
    slopes = slope[j] + third * ((1.0 - 3.0 * a**2) * second[j] + (3.0 * b**2 - 1.0) * second[j + 1])
    return np.asarray(values), np.asarray(slopes)


FINE = 8
"""Linear pieces per knot interval that approximate the spline."""
MOST_NODES = 20
"""Most nodes that carry the table's uncertainty in a model."""


@dataclass(frozen=True)
class ShapeColumns:
    """Columns of a table at some rows: free (n, f), even and odd (n, …) of one prior variance each, given (n, v) of unit variance."""

    free: Floats
    even: Floats
    odd: Floats
    given: Floats

    @property
    def stacked(self) -> Floats:
        """All columns side by side, shape (n, w)."""
        return np.asarray(np.hstack([self.free, self.even, self.odd, self.given]), dtype=np.float64)


class Shape(Protocol):
    """The table's representation in a fit."""

    def columns(self, x_mm: Floats, direction: Floats) -> ShapeColumns:
        """Columns at positions and directions, shape (n, …)."""

    def tabulate(self, coefficients: Floats, covariance: Floats | None = None) -> PitchTable:
        """The table of some coefficients (w,), with their covariance (w, w) in µm² where it is given."""


@dataclass(frozen=True)
class SplineShape:
    """A smoothing spline per direction part."""

    basis: TableBasis

    def columns(self, x_mm: Floats, direction: Floats) -> ShapeColumns:
        even = self.basis.penalised(x_mm)
        odd = even * direction[:, None] if self.basis.both_directions else even[:, :0]
        return ShapeColumns(self.basis.free(x_mm, direction), even, odd, even[:, :0])

    def tabulate(self, coefficients: Floats, covariance: Floats | None = None) -> PitchTable:
        """FINE linear pieces per knot interval, half a spacing wider than the knots at each end."""
        x, forward, backward, nodes = self._grid
        root = np.vstack([forward[nodes], backward[nodes]])
        return _table(x, np.stack([forward @ coefficients, backward @ coefficients]), nodes, root, covariance)

    @cached_property
    def _grid(self) -> tuple[Floats, Floats, Floats, NDArray[np.int64]]:
        """Positions of the table, the columns there in each direction, and its nodes."""
        knots = self.basis.knots_mm
        if len(knots) > 1:
            pieces = [np.linspace(a, b, FINE, endpoint=False) for a, b in pairwise(knots)]
            margin = 0.5 * float(np.median(np.diff(knots)))
            x = np.concatenate([[knots[0] - margin], *pieces, [knots[-1], knots[-1] + margin]])
        else:
            x = knots
        forward, backward = (self.columns(x, np.full(len(x), d)).stacked for d in (1.0, -1.0))
        chosen = np.unique(np.round(np.linspace(0, len(knots) - 1, min(len(knots), MOST_NODES))).astype(int))
        return x, forward, backward, (chosen * FINE + 1 if len(knots) > 1 else chosen).astype(np.int64)


@dataclass(frozen=True)
class DeclaredShape:
    """A declared table that may change by a constant, and within its own uncertainty.

    root: (2k, v), square root of the covariance of (forward, backward) at the table's nodes over the noise variance
    """

    table: PitchTable
    root: Floats

    @classmethod
    def of(cls, table: PitchTable, noise_um: float) -> DeclaredShape:
        """From a table and the white noise's standard deviation in µm."""
        k = len(table.nodes)
        if k == 0 or not table.covariance_um2:
            nodes = np.unique(np.round(np.linspace(0, len(table.positions_mm) - 1, MOST_NODES)).astype(int))
            table = PitchTable(table.positions_mm, table.forward_um, table.backward_um, tuple(int(i) for i in nodes))
            return cls(table, np.eye(2 * len(nodes)) * UNKNOWN_SHARE)
        values, vectors = np.linalg.eigh(np.array(table.covariance_um2))
        kept = values > 1e-9 * max(float(values[-1]), 1e-300)
        return cls(table, np.asarray(vectors[:, kept] * np.sqrt(values[kept]) / noise_um))

    def columns(self, x_mm: Floats, direction: Floats) -> ShapeColumns:
        nodes = np.array(self.table.positions_mm)[list(self.table.nodes)]
        k = len(nodes)
        hats = np.column_stack([np.interp(x_mm, nodes, np.eye(k)[i]) for i in range(k)])
        forward = (direction > 0)[:, None]
        given = np.hstack([hats * forward, hats * ~forward]) @ self.root
        none = np.zeros((len(x_mm), 0))
        return ShapeColumns(np.ones((len(x_mm), 1)), none, none, given)

    def tabulate(self, coefficients: Floats, covariance: Floats | None = None) -> PitchTable:
        x = np.array(self.table.positions_mm)
        forward, backward = (self.columns(x, np.full(len(x), d)).stacked for d in (1.0, -1.0))
        nodes = np.array(self.table.nodes)
        root = np.vstack([forward[nodes], backward[nodes]])
        before = np.stack([self.table.forward_um, self.table.backward_um])
        moved = np.stack([forward @ coefficients, backward @ coefficients])
        return _table(x, before + moved, nodes, root, covariance)


def _table(x: Floats, error: Floats, nodes: NDArray[np.int64], root: Floats, covariance: Floats | None) -> PitchTable:
    """error: forward and backward, shape (2, m); root: values at the nodes in each direction, shape (2k, w), per coefficient."""
    forward, backward = (_floats(values) for values in error)
    if covariance is None:
        return PitchTable(_floats(x), forward, backward)
    spread = tuple(tuple(float(f"{v:.6g}") for v in row) for row in root @ covariance @ root.T)
    return PitchTable(_floats(x), forward, backward, tuple(int(i) for i in nodes), spread)


def _floats(values: Floats) -> tuple[float, ...]:
    return tuple(values.tolist())
