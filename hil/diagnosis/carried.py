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

from hil.diagnosis.evidence import Noise
from hil.diagnosis.fit import Choice
from hil.diagnosis.judge import Hit
from hil.diagnosis.searcher import Searcher
from hil.diagnosis.structure import Structure
from hil.effects import Columns, Estimate, Term
from hil.effects.non_parametric import NonParametric

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Carried:
    """What follows some columns, in one structure or in several on the same columns, which only together have a size.

    coefficients (w,), of all structures in turn, and their covariance (w, w), in µm and µm²; probability: of as much in noise
    """

    structures: tuple[Structure, ...]
    coefficients: Floats
    covariance: Floats
    probability: float

    @property
    def columns(self) -> tuple[str, ...]:
        return max((structure.columns for structure in self.structures), key=len)

    @property
    def rms(self) -> Estimate:
        """Over the rows of the campaign, of the part that a smooth function of the columns can hold, µm."""
        whole = np.hstack([structure.whole for structure in self.structures])
        return rms_of(whole, self.coefficients, self.covariance)

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
    frame = searcher.frame(noise, extra)
    solution = frame.solve(np.zeros((len(searcher.y), 0)))
    posterior = frame.inverse_lower.T @ frame.inverse_lower * solution.variance
    first = frame.whitened.table.shape[1]
    out = []
    for group in _groups(hits):
        places, roots = [], []
        for hit in group:
            own = hit.extra.random
            start = first + _where(extra.random, own)
            places.append(np.arange(start, start + own.shape[1]))
            roots.append(np.full(own.shape[1], math.sqrt(hit.variance)))
        place, root = np.concatenate(places), np.concatenate(roots)
        spread = posterior[np.ix_(place, place)] * np.outer(root, root)
        probability = min(hit.probability for hit in group)
        out.append(Carried(tuple(hit.structure for hit in group), solution.table[place] * root, spread, probability))
    return tuple(out)


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


def _where(columns: Floats, block: Floats) -> int:
    """Index of the first of the columns (n, s) at which the block (n, w) stands."""
    width = block.shape[1]
    return next(i for i in range(columns.shape[1] - width + 1) if np.array_equal(columns[:, i : i + width], block))


def rms_of(design: Floats, coefficients: Floats, covariance: Floats) -> Estimate:
    """RMS about the mean of design (n, k) @ coefficients, where these are normal about their estimate with that covariance.

    The mean square is c'Gc + tr GV with variance 4 c'GVGc + 2 tr GVGV (quadratic form of normal variables; Mathai & Provost 1992,
    ch. 3), G the centred cross products per row; its root by the delta method.
    """
    centred = design - np.mean(design, axis=0)
    gram = centred.T @ centred / len(design)
    spread = gram @ covariance
    square = float(coefficients @ gram @ coefficients + np.trace(spread))
    variance = float(4.0 * coefficients @ spread @ gram @ coefficients + 2.0 * np.sum(spread * spread.T))
    rms = math.sqrt(max(square, 1e-300))
    return Estimate(rms, math.sqrt(max(variance, 0.0)) / (2.0 * rms))


def rms_of_term(term: Term, columns: Columns) -> Estimate:
    """The same of a fitted effect over rows, its non-linear parameters held."""
    k = len(term.coefficients)
    basis = term.effect.basis(term.form, term.theta, columns)
    return rms_of(basis, np.array(term.coefficients), np.array(term.covariance)[:k, :k])
