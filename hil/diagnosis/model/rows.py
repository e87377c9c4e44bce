"""The rows of a campaign as the model has them: errors, columns of the table and of the runs' offsets, and whitening."""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows, Floats, Ints, Singles
from hil.diagnosis.model.numeric import inverse_of_lower
from hil.diagnosis.table import DeclaredShape, Shape, SplineShape
from hil.effects import Term
from hil.effects.model import Model

Real = TypeVar("Real", np.float32, np.float64)

LONGEST = 125
"""Rows of a run over which its memory is followed; of longer runs each such stretch has its own."""
LEFT_OUT = 1e4
"""Noise of rows that are left out, over their own."""
MOST_BYTES = 4_000_000
"""Bytes of columns that are whitened together."""
SAME = 0.02
"""Singular value, over the largest, below which two tables have absorbed the same."""
ROUGH = 300.0
"""Variance of a table, over the white noise, that holds whatever a table can."""
EVEN, ODD, OFFSET, GIVEN, KNOWN = 0, 1, 2, 3, 4
"""Random columns: table alike in both directions, unlike, offsets of runs; a declared table's and its terms', of variance 1."""


@dataclass(frozen=True)
class NoiseMemory:
    """White noise and an AR(1) of `ar` white noise within a run, correlated by rho from row to row."""

    ar: float
    rho: float


NO_MEMORY = NoiseMemory(0.0, 0.0)
MEMORIES = (
    NO_MEMORY,
    *(NoiseMemory(0.35, rho) for rho in (0.5, 0.85)),
    *(NoiseMemory(0.7, rho) for rho in (0.5, 0.8, 0.93)),
    *(NoiseMemory(1.1, rho) for rho in (0.6, 0.85)),
)


@dataclass(frozen=True)
class Whitened:
    """Columns and errors over the noise of their rows: columns (n, q + f), their products, y (n,), log determinant of the noise."""

    columns: Floats
    gram: Floats
    y: Floats
    log_noise: float


@dataclass(frozen=True)
class Given:
    """A declared model as a prior: its table's shape, and the square root of each term's coefficient covariance over the noise's."""

    model: Model
    shape: DeclaredShape
    roots: tuple[Floats, ...]

    @classmethod
    def of(cls, model: Model, noise_um: float) -> Given:
        """noise_um: standard deviation of the white noise."""
        roots = []
        for term in model.terms:
            k = len(term.coefficients)
            values, vectors = np.linalg.eigh(np.array(term.covariance)[:k, :k])
            roots.append(np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)) / noise_um))
        return cls(model, DeclaredShape.of(model.table, noise_um), tuple(roots))

    def columns(self, campaign: CampaignRows) -> list[Floats]:
        """Of the terms, random with variance 1."""
        pairs = zip(self.model.terms, self.roots, strict=True)
        return [term.effect.basis(term.form, term.theta, campaign.columns) @ root for term, root in pairs]

    def moved(self, beta: Floats) -> tuple[Term, ...]:
        """The terms as the coefficients of their columns move them."""
        out, at = [], 0
        for term, root in zip(self.model.terms, self.roots, strict=True):
            moved = np.array(term.coefficients) + root @ beta[at : at + root.shape[1]]
            at += root.shape[1]
            out.append(replace(term, coefficients=tuple(moved.tolist())))
        return tuple(out)


class RoughTable:
    """What a rough table of these rows holds of further columns."""

    def __init__(self, campaign: CampaignRows) -> None:
        self._shape = SplineShape(campaign.basis)
        columns = self._shape.columns(campaign.x, campaign.d)
        self._columns, self._free = columns.stacked, columns.free.shape[1]
        ridge = np.full(self._columns.shape[1], 1.0 / ROUGH)
        ridge[: columns.free.shape[1]] = 1e-9
        self._gram = self._columns.T @ self._columns
        self._inverse = np.linalg.inv(self._gram + np.diag(ridge))

    def coefficients(self, columns: Floats) -> Floats:
        """Of the spline's columns (`SplineShape.columns`), (w, k)."""
        return np.asarray(self._inverse @ (self._columns.T @ columns))

    def beside(self, columns: Floats) -> Floats:
        """Share of the norm of each that it does not hold, (k,)."""
        onto = self._columns.T @ columns
        beta = self._inverse @ onto
        whole = np.sum(columns * columns, axis=0)
        left = whole - 2.0 * np.sum(beta * onto, axis=0) + np.sum(beta * (self._gram @ beta), axis=0)
        return np.asarray(np.sqrt(np.maximum(left, 0.0) / np.maximum(whole, 1e-24)))

    def at(self, x_mm: Floats, direction: Floats) -> Floats:
        """The spline's columns at other places, (m, w)."""
        return self._shape.columns(x_mm, direction).stacked

    def held(self, columns: Floats) -> Floats:
        """Its values, (n, k)."""
        return np.asarray(self._columns @ self.coefficients(columns))

    def absorbed(self, columns: Floats) -> Floats:
        """What a table can have absorbed, however smooth: as the roughest and as a straight line has it, in orthogonal columns of
        RMS 1, (n, m), so that each costs unit information.
        """
        line = self._columns[:, : self._free]
        straight = line @ np.linalg.lstsq(line, columns, rcond=None)[0]
        both = np.hstack([self.held(columns), straight])
        axes, size, _ = np.linalg.svd(both / np.maximum(np.linalg.norm(both, axis=0), 1e-12), full_matrices=False)
        return np.asarray(axes[:, size > SAME * size[0]] * math.sqrt(len(both)))


class ModelRows:
    """y = fixed a + random b + … + ε + memory, all over the white noise.

    given: the declared model, or None for a table that is fitted from these rows; scale: of each row's noise, large of those left out
    """

    def __init__(self, campaign: CampaignRows, given: Given | None = None) -> None:
        self.campaign, self.given = campaign, given
        self.shape: Shape = SplineShape(campaign.basis) if given is None else given.shape
        self.n = len(campaign)
        self.scale = np.ones(self.n)
        self.y = campaign.error_um - (0.0 if given is None else given.model.error_um(campaign.columns))
        table = self.shape.columns(campaign.x, campaign.d)
        own = (campaign.run[:, None] == np.arange(campaign.runs)).astype(float)
        offsets = own if campaign.runs > 1 else own[:, :0]
        self.fixed = table.free
        parts = [table.even, table.odd, offsets, table.given, *([] if given is None else given.columns(campaign))]
        self.random = np.hstack(parts)
        widths = [part.shape[1] for part in parts]
        kinds = [EVEN, ODD, OFFSET, GIVEN, *[KNOWN] * (len(parts) - 4)]
        self.group: Ints = np.repeat(kinds, widths).astype(np.int64)
        self._white: dict[NoiseMemory, Whitened] = {}
        self._reduced: dict[tuple[Hashable, NoiseMemory], tuple[Singles, Singles]] = {}
        self._roots: dict[tuple[int, NoiseMemory], Floats] = {}

    @property
    def is_declared(self) -> bool:
        """Whether the table was given, so that what depends on position and direction alone can be found beside it."""
        return self.given is not None

    @cached_property
    def table(self) -> RoughTable:
        """A rough table of these rows."""
        return RoughTable(self.campaign)

    @cached_property
    def of_table(self) -> Ints:
        """Random columns of the table in the order of `ShapeColumns.stacked`."""
        return np.concatenate([np.flatnonzero(self.group == kind) for kind in (EVEN, ODD, GIVEN)]).astype(np.int64)

    def without(self, out: NDArray[np.bool_]) -> ModelRows:
        """The same rows, of which those left out count for nothing."""
        other = copy(self)
        other.scale = self.scale * np.where(out, LEFT_OUT, 1.0)
        other._white, other._reduced = {}, {}
        return other

    @cached_property
    def stretches(self) -> list[slice]:
        """Rows of each run, of long ones in stretches."""
        edges = np.concatenate([[0], np.flatnonzero(np.diff(self.campaign.run)) + 1, [self.n]])
        found = []
        for first, last in itertools.pairwise(edges):
            pieces = -(-int(last - first) // LONGEST)
            cuts = np.linspace(first, last, pieces + 1).astype(int)
            found += [slice(int(a), int(b)) for a, b in itertools.pairwise(cuts)]
        return found

    def _root(self, rows: int, memory: NoiseMemory) -> Floats:
        """Inverse of the Cholesky factor of the noise of so many neighbouring rows."""
        key = rows, memory
        if key not in self._roots:
            apart = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
            lower = np.asarray(np.linalg.cholesky(np.eye(rows) + memory.ar**2 * memory.rho**apart), dtype=np.float64)
            self._roots[key] = inverse_of_lower(lower)
        return self._roots[key]

    def white(self, columns: NDArray[Real], memory: NoiseMemory) -> NDArray[Real]:
        """Columns (n, k), or values (n,), over the noise of their rows, in their own precision."""
        scaled = np.divide(columns.T, self.scale, dtype=columns.dtype).T
        for rows in self.stretches if memory.ar else ():
            scaled[rows] = self._root(rows.stop - rows.start, memory).astype(columns.dtype) @ scaled[rows]
        return scaled

    def unwhite(self, values: Floats, memory: NoiseMemory) -> Floats:
        """The transpose of `white`: sums of whitened columns times values are those of the columns times this, (n,)."""
        out = values.copy()
        if memory.ar:
            for rows in self.stretches:
                out[rows] = self._root(rows.stop - rows.start, memory).T @ values[rows]
        return np.asarray((out.T / self.scale).T)

    def reduced(self, rows: Singles, k: int, memory: NoiseMemory, of: Hashable) -> tuple[Singles, Singles]:
        """Groups of k columns, one a row, (G·k, n), in single precision: their products (G, k, k), and those with the columns of the
        table and the offsets, (G·k, q + f); of: what they are the columns of, by which they are kept for the next time.
        """
        key = of, memory
        if key not in self._reduced:
            base = self.whitened(memory).columns.astype(np.float32)
            size = k * max(MOST_BYTES // (4 * k * self.n), 1)
            products, by_base = [], []
            for first in range(0, len(rows), size):
                white = self.white(rows[first : first + size].T, memory).T
                groups = white.reshape(-1, k, self.n)
                products.append(groups @ groups.transpose(0, 2, 1))
                by_base.append(white @ base)
            self._reduced[key] = np.concatenate(products), np.concatenate(by_base)
        return self._reduced[key]

    def whitened(self, memory: NoiseMemory) -> Whitened:
        """Table, offsets and errors under a memory; made once."""
        if memory not in self._white:
            base = self.white(np.hstack([self.random, self.fixed]), memory)
            y = self.white(self.y, memory)
            log_noise = 2.0 * float(np.sum(np.log(self.scale)))
            if memory.ar:
                roots = (self._root(rows.stop - rows.start, memory) for rows in self.stretches)
                log_noise -= 2.0 * sum(float(np.sum(np.log(np.diag(root)))) for root in roots)
            self._white[memory] = Whitened(base, base.T @ base, y, log_noise)
        return self._white[memory]
