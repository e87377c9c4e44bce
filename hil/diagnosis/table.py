"""The table part of a fit: its columns, and the conversion of its coefficients into a table.

Two shapes: a spline fitted from the records themselves, and a declared table that may only change within its stated
uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.spline import TableBasis
from hil.effects.model import PitchTable

Floats = NDArray[np.float64]

FINE = 8
"""Linear pieces per knot interval that approximate the spline."""
MOST_NODES = 20
"""Most nodes that carry the table's uncertainty in a model."""
UNKNOWN_SHARE = 0.5
"""Standard deviation, over the noise's, of the nodes of a declared table that states none."""


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


@dataclass(frozen=True)
class StaticPart:
    """The part of further columns that a table can hold: their spline fit, one column of coefficients each, shape (w,
    q).
    """

    shape: SplineShape
    coefficients: Floats

    def at(self, x_mm: Floats, direction: Floats) -> Floats:
        """Values of the columns' static part, shape (n, q)."""
        return np.asarray(self.shape.columns(x_mm, direction).stacked @ self.coefficients, dtype=np.float64)

    def added_to(self, table: PitchTable, share: Floats) -> PitchTable:
        """The table plus `share` (q,) of each column, on the table's positions."""
        x = np.array(table.positions_mm)
        forward, backward = (self.at(x, np.full(len(x), d)) @ share for d in (1.0, -1.0))
        return PitchTable(
            table.positions_mm,
            _floats(np.array(table.forward_um) + forward),
            _floats(np.array(table.backward_um) + backward),
            table.nodes,
            table.covariance_um2,
        )


def _table(x: Floats, error: Floats, nodes: NDArray[np.int64], root: Floats, covariance: Floats | None) -> PitchTable:
    """error: forward and backward, shape (2, m); root: values at the nodes in each direction, shape (2k, w), per coefficient."""
    forward, backward = (_floats(values) for values in error)
    if covariance is None:
        return PitchTable(_floats(x), forward, backward)
    spread = tuple(tuple(float(f"{v:.6g}") for v in row) for row in root @ covariance @ root.T)
    return PitchTable(_floats(x), forward, backward, tuple(int(i) for i in nodes), spread)


def _floats(values: Floats) -> tuple[float, ...]:
    return tuple(values.tolist())
