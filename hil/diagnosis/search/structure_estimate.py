"""The size of an unexplained structure with its uncertainty, and the structure as a term of a model.

Structures are random effects of their columns in every fit, so that coefficients and covariance come from the same
joint estimate as table and terms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Extra, Noise
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.judge import Hit
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.search.structure import Structure
from hil.effects import Columns, Estimate, Term
from hil.effects.base import slopes_of
from hil.effects.non_parametric import NonParametric

Floats = NDArray[np.float64]


FEW = 0.1
"""Columns of a structure, over the rows, up to which they are free in the fit that gives its size."""
FREE = 1e3
"""Variance ratio of columns that are practically free."""


@dataclass(frozen=True)
class StructureEstimate:
    """The dependence on some columns, by one structure or by several on the same columns, whose size is that of their
    sum.

    coefficients (w,), of all structures in turn, and their covariance (w, w), in µm and µm², as random effects
    probability: of as much in noise
    """

    structures: tuple[Structure, ...]
    coefficients: Floats
    covariance: Floats
    probability: float

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the widest structure."""
        return max((structure.columns for structure in self.structures), key=len)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The structures as terms of a model."""
        out, start = [], 0
        for structure in self.structures:
            mine = slice(start, start + structure.whole.shape[1])
            values = tuple(self.coefficients[mine].tolist())
            spread = tuple(tuple(row) for row in self.covariance[mine, mine].tolist())
            out.append(Term(NonParametric(), structure.form, (), values, spread))
            start = mine.stop
        return tuple(out)

    def error_um(self, columns: Columns) -> Floats:
        """The sum of the structures on rows, µm, (n,)."""
        return np.asarray(np.sum([term.error_um(columns) for term in self.terms], axis=0), dtype=np.float64)


def structure_estimates(
    searcher: Searcher, hits: Sequence[Hit], choices: Sequence[Choice], noise: Noise
) -> tuple[StructureEstimate, ...]:
    """The structures of the hits, estimated beside the table and some terms; the hits are among the searcher's nuisance
    columns.
    """
    if not hits:
        return ()
    extra = searcher.extra(choices)
    coefficients, covariance = _solved(searcher, extra, noise)
    places = places_of(extra.random, [hit.extra for hit in hits])
    out = []
    for group in _groups(hits):
        place = np.concatenate([places[i] for i in group])
        root = np.concatenate([np.full(len(places[i]), math.sqrt(hits[i].variance)) for i in group])
        spread = covariance[np.ix_(place, place)] * np.outer(root, root)
        probability = min(hits[i].probability for i in group)
        out.append(
            StructureEstimate(tuple(hits[i].structure for i in group), coefficients[place] * root, spread, probability)
        )
    return tuple(out)


def sizes(searcher: Searcher, hits: Sequence[Hit], choices: Sequence[Choice], noise: Noise) -> tuple[Estimate, ...]:
    """RMS over the rows of each structure, µm, as far as a smooth function of its columns represents it.

    The size is taken beside a straight line in each direction: a component that the table can represent as well cannot
    be attributed to a structure. A column that is in several structures counts for the first.
    """
    if not hits:
        return ()
    extra = searcher.extra(choices)
    columns = extra.random.copy()
    places = places_of(extra.random, [hit.extra for hit in hits])
    for hit, place, design in zip(hits, places, _apart(hits), strict=True):
        columns[:, place] = design * math.sqrt(FREE if _few(hit) else hit.variance)
    coefficients, covariance = _solved(searcher, Extra(extra.free, columns), noise)
    line = searcher.linear.table.shape.free
    out = []
    for group in _groups(hits):
        place = np.concatenate([places[i] for i in group])
        mine = columns[:, place]
        shrunk = not all(_few(hits[i]) for i in group)
        out.append(rms_of(mine, coefficients[place], covariance[np.ix_(place, place)], line, shrunk=shrunk))
    return tuple(out)


def _apart(hits: Sequence[Hit]) -> list[Floats]:
    """The columns of each structure, zero where an earlier one has the same."""
    seen: set[bytes] = set()
    out = []
    for hit in hits:
        whole = hit.structure.whole
        keys = [column.tobytes() for column in whole.T]
        out.append(whole * np.array([float(key not in seen) for key in keys]))
        seen.update(keys)
    return out


def _few(hit: Hit) -> bool:
    rows, columns = hit.structure.whole.shape
    return bool(columns <= FEW * rows)


def _solved(searcher: Searcher, extra: Extra, noise: Noise) -> tuple[Floats, Floats]:
    """Coefficients of the random columns of a fit, (s,), and their covariance (s, s), with everything else free beside them."""
    projection = searcher.projection(noise, extra)
    solution = projection.solve(np.zeros((len(searcher.y), 0)))
    posterior = projection.inverse_lower.T @ projection.inverse_lower * solution.variance
    first = projection.whitened.table.shape[1]
    random = slice(first, first + extra.random.shape[1])
    return solution.table[random], posterior[random, random]


def _groups(hits: Sequence[Hit]) -> list[list[int]]:
    """Indices of the hits, grouped where the columns of one are among those of another."""
    names = [set(hit.structure.columns) for hit in hits]
    groups: list[list[int]] = []
    for i in sorted(range(len(hits)), key=lambda i: -len(names[i])):
        home = next((group for group in groups if names[i] <= names[group[0]]), None)
        if home is None:
            groups.append([i])
        else:
            home.append(i)
    return groups


def places_of(columns: Floats, extras: Sequence[Extra]) -> list[NDArray[np.int64]]:
    """Indices of the random columns of each among the columns (n, s). Raises LookupError for a missing one."""
    out: list[NDArray[np.int64]] = []
    taken: set[int] = set()
    for extra in extras:
        block = extra.random
        width = block.shape[1]
        starts = (i for i in range(columns.shape[1] - width + 1) if i not in taken)
        start = next((i for i in starts if np.array_equal(columns[:, i : i + width], block)), None)
        if start is None:
            raise LookupError("a structure is not among the columns of the fit")
        out.append(np.arange(start, start + width))
        taken.update(range(start, start + width))
    return out


def rms_of(
    design: Floats, coefficients: Floats, covariance: Floats, beside: Floats, *, shrunk: bool = False
) -> Estimate:
    """RMS of design (n, k) @ true coefficients, beside some columns (n, f), from an estimate with its covariance, in
    the unit of the errors.

    With G the remaining cross products per row, c'Gc of a free estimate is too large by tr GV on average, that of a
    shrunk one too small by as much; its variance is 4 c'GVGc + 2 tr GVGV (quadratic form of normal variables; Mathai &
    Provost 1992, ch. 3), and the root's is by the delta method.
    """
    left = design - beside @ np.linalg.lstsq(beside, design, rcond=None)[0]
    gram = left.T @ left / len(design)
    spread = gram @ covariance
    seen, bias = float(coefficients @ gram @ coefficients), float(np.trace(spread))
    square = max(seen + bias if shrunk else seen - bias, 0.25 * seen, 1e-300)
    variance = float(4.0 * coefficients @ spread @ gram @ coefficients + 2.0 * np.sum(spread * spread.T))
    rms = math.sqrt(square)
    return Estimate(rms, math.sqrt(max(variance, 0.0)) / (2.0 * rms))


def rms_of_term(term: Term, columns: Columns) -> Estimate:
    """RMS of a fitted effect over rows about its mean, µm; its non-linear parameters enter by their first-order effect.

    Where the rows do not determine them that says nothing: the size is then that of the fitted course, as uncertain as it is large.
    """
    basis = term.effect.basis(term.form, term.theta, columns)
    coefficients = np.array(term.coefficients)
    slopes = basis[:, :0] if term.form.shrunk else slopes_of(columns, term, coefficients)
    design = np.hstack([basis, slopes])
    width = design.shape[1]
    covariance = np.array(term.covariance)[:width, :width]
    whole = np.concatenate([coefficients, np.zeros(width - len(coefficients))])
    rms = rms_of(design, whole, covariance, np.ones((len(basis), 1)), shrunk=term.form.shrunk)
    if rms.std < rms.value:
        return rms
    size_um = float(np.std(basis @ coefficients))
    return Estimate(size_um, size_um)
