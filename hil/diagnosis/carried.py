"""How large an unexplained structure is, and how well that is known; and the structure as a term that a model can hold.

What may go in: what the fit already says of the structures that were found, read out of it. They stand in every fit as random effects
of their columns, so that coefficients and covariance come from the same joint estimate as table and terms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.evidence import Extra, Noise
from hil.diagnosis.fit import Choice
from hil.diagnosis.judge import Hit
from hil.diagnosis.searcher import Searcher
from hil.diagnosis.structure import Structure
from hil.effects import Columns, Estimate, Term
from hil.effects.non_parametric import NonParametric

Floats = NDArray[np.float64]


FEW = 0.1
"""Columns of a structure, over the rows, up to which they are free in the fit that says its size."""
FREE = 1e3
"""Variance ratio of columns that are as good as free."""


@dataclass(frozen=True)
class Carried:
    """What follows some columns, in one structure or in several on the same columns, which only together have a size.

    coefficients (w,), of all structures in turn, and their covariance (w, w), in µm and µm², as random effects
    probability: of as much in noise
    """

    structures: tuple[Structure, ...]
    coefficients: Floats
    covariance: Floats
    probability: float

    @property
    def columns(self) -> tuple[str, ...]:
        return max((structure.columns for structure in self.structures), key=len)

    @property
    def terms(self) -> tuple[Term, ...]:
        """For a model."""
        out, start = [], 0
        for structure in self.structures:
            mine = slice(start, start + structure.whole.shape[1])
            values = tuple(self.coefficients[mine].tolist())
            spread = tuple(tuple(row) for row in self.covariance[mine, mine].tolist())
            out.append(Term(NonParametric(), structure.form, (), values, spread))
            start = mine.stop
        return tuple(out)

    def error_um(self, columns: Columns) -> Floats:
        """On rows, (n,)."""
        return np.asarray(np.sum([term.error_um(columns) for term in self.terms], axis=0), dtype=np.float64)


def carried(searcher: Searcher, hits: Sequence[Hit], choices: Sequence[Choice], noise: Noise) -> tuple[Carried, ...]:
    """What follows the columns of the hits, beside the table and some terms; the hits are among the searcher's nuisance columns."""
    if not hits:
        return ()
    extra = searcher.extra(choices)
    coefficients, covariance = _solved(searcher, extra, noise)
    out = []
    for group in _groups(hits):
        place = np.concatenate([_place(extra.random, hit.extra.random) for hit in group])
        root = np.concatenate([np.full(hit.structure.whole.shape[1], math.sqrt(hit.variance)) for hit in group])
        spread = covariance[np.ix_(place, place)] * np.outer(root, root)
        probability = min(hit.probability for hit in group)
        out.append(Carried(tuple(hit.structure for hit in group), coefficients[place] * root, spread, probability))
    return tuple(out)


def sizes(searcher: Searcher, hits: Sequence[Hit], choices: Sequence[Choice], noise: Noise) -> tuple[Estimate, ...]:
    """RMS of each of the carried over the rows, µm: of the part that a smooth function of its columns can hold.

    It is taken beside a straight line in each direction: of what the table can hold as well nobody can say whose it is. A column that
    stands in several structures counts for the first.
    """
    if not hits:
        return ()
    extra = searcher.extra(choices)
    scale = {id(hit): math.sqrt(FREE if _few(hit) else hit.variance) for hit in hits}
    design = dict(zip(map(id, hits), _apart(hits), strict=True))
    columns = extra.random.copy()
    places = {id(hit): _place(extra.random, hit.extra.random) for hit in hits}
    for key, place in places.items():
        columns[:, place] = design[key] * scale[key]
    coefficients, covariance = _solved(searcher, Extra(extra.free, columns), noise)
    line = searcher.bench.table.shape.free
    out = []
    for group in _groups(hits):
        place = np.concatenate([places[id(hit)] for hit in group])
        mine = columns[:, place]
        shrunk = not all(map(_few, group))
        out.append(rms_of(mine, coefficients[place], covariance[np.ix_(place, place)], line, shrunk=shrunk))
    return tuple(out)


def _apart(hits: Sequence[Hit]) -> list[Floats]:
    """The columns of each structure, zero where one before it has the same."""
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
    frame = searcher.frame(noise, extra)
    solution = frame.solve(np.zeros((len(searcher.y), 0)))
    posterior = frame.inverse_lower.T @ frame.inverse_lower * solution.variance
    first = frame.whitened.table.shape[1]
    random = slice(first, first + extra.random.shape[1])
    return solution.table[random], posterior[random, random]


def _groups(hits: Sequence[Hit]) -> list[list[Hit]]:
    """Hits whose columns are among those of another stand with it."""
    groups: list[list[Hit]] = []
    for hit in sorted(hits, key=lambda hit: -len(hit.structure.columns)):
        mine = set(hit.structure.columns)
        home = next((group for group in groups if mine <= set(group[0].structure.columns)), None)
        if home is None:
            groups.append([hit])
        else:
            home.append(hit)
    return groups


def _place(columns: Floats, block: Floats) -> NDArray[np.int64]:
    """Indices of the block (n, w) among the columns (n, s)."""
    width = block.shape[1]
    for start in range(columns.shape[1] - width + 1):
        if np.array_equal(columns[:, start : start + width], block):
            return np.arange(start, start + width)
    raise LookupError("a structure is not among the columns of the fit")


def rms_of(
    design: Floats, coefficients: Floats, covariance: Floats, beside: Floats, *, shrunk: bool = False
) -> Estimate:
    """RMS of design (n, k) @ true coefficients, beside what some columns (n, f) can hold, from an estimate with its covariance.

    With G the cross products per row that are left, c'Gc of a free estimate is too large by tr GV on average, that of a shrunk one too
    small by as much; its variance is 4 c'GVGc + 2 tr GVGV (quadratic form of normal variables; Mathai & Provost 1992, ch. 3), and the
    root's is by the delta method.
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
    """The same of a fitted effect over rows about its mean, its non-linear parameters held."""
    k = len(term.coefficients)
    basis = term.effect.basis(term.form, term.theta, columns)
    covariance = np.array(term.covariance)[:k, :k]
    return rms_of(basis, np.array(term.coefficients), covariance, np.ones((len(basis), 1)), shrunk=term.form.shrunk)
