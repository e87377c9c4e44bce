"""What is put into force: the machine's effects in a model, and what it leaves on runs that were not fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import AllRows, Floats, Ints
from hil.diagnosis.model.evidence import Fit, Part
from hil.diagnosis.model.rows import KNOWN
from hil.effects import Action, Term
from hil.effects.model import Model, PitchTable

MOST_FOLDS = 8
"""Groups of runs that are left out in turn."""


@dataclass(frozen=True)
class Folds:
    """Fold of each row of all, (n,), and of those that were fitted, (m,); how they were made."""

    of_all: Ints
    of_kept: Ints
    how: str

    @classmethod
    def of(cls, rows: AllRows, run: Ints) -> Folds:
        """Runs, groups of neighbouring runs where there are many, quarters of a single run; run: of the rows fitted."""
        runs = int(np.max(run)) + 1
        if runs == 1:
            fold, how = (np.arange(len(run)) * min(4, len(run)) // len(run)).astype(np.int64), "leave-one-quarter-out"
        elif runs <= MOST_FOLDS:
            fold, how = run, "leave-one-run-out"
        else:
            fold, how = (run * MOST_FOLDS // runs).astype(np.int64), "leave-runs-out in groups"
        return cls(rows.folds(fold), fold, how)


@dataclass(frozen=True)
class Force:
    """A fit, and by its part each term of it of which this share is in force."""

    fit: Fit
    live: Mapping[Part, Term]
    share: float = 1.0

    def model(self) -> Model:
        """The extended model: the table, which keeps the mean of what is not in force and what it can hold of remainders, declared
        terms, and the terms in force.
        """
        return self._model(self.fit, self.live, uncertain=True)

    def _model(self, fit: Fit, live: Mapping[Part, Term], *, uncertain: bool) -> Model:
        rows = fit.rows
        at = fit.of_table()
        coefficients = fit.beta[at].copy()
        rest = np.zeros(rows.n)
        for part in fit.parts:
            if part.is_remainder:
                rest += fit.course_um(part)
            else:
                share = self.share if part in live else 0.0
                coefficients[0] += (1.0 - share) * float(np.mean(fit.course_um(part)))
        if np.any(rest):
            coefficients += fit.held(rest)
        covariance = fit.covariance[np.ix_(at, at)] if uncertain else None
        table = _with_held(rows.shape.tabulate(coefficients, covariance), fit)
        about: dict[str, str | int | float] = {"rows": rows.n, "runs": rows.campaign.runs, "white_noise_um": fit.sigma}
        known = () if rows.given is None else rows.given.moved(fit.beta[: len(rows.group)][rows.group == KNOWN])
        return Model(table, (*known, *(_times(term, self.share) for term in live.values())), about)

    def without(self, out: NDArray[np.bool_]) -> Model:
        """The model fitted without some of the rows, its forms and non-linear parameters as they are."""
        fit = Fit(self.fit.rows.without(out), self.fit.parts, self.fit.noise)
        live = {
            part: replace(term, coefficients=tuple(fit.coefficients(part).tolist())) for part, term in self.live.items()
        }
        return self._model(fit, live, uncertain=False)

    def left_out_um(self, rows: AllRows, folds: Folds) -> Floats:
        """What the model leaves on each row when it is fitted without its fold, µm, (n,)."""
        left = np.zeros(len(rows))
        for index in np.unique(folds.of_kept):
            here = folds.of_all == index
            model = self.without(folds.of_kept == index)
            left[here] = (rows.error_um - model.error_um(rows.columns))[here]
        return left


def _times(term: Term, share: float) -> Term:
    if share == 1.0:
        return term
    return replace(term, coefficients=tuple(share * value for value in term.coefficients), likely=())


def _with_held(table: PitchTable, fit: Fit) -> PitchTable:
    """A declared table with what it had absorbed of the effects set right."""
    held = [part for part in fit.parts if part.absorbed.shape[1]]
    if not held:
        return table
    own = fit.rows.table
    x = np.array(table.positions_mm)
    moved = np.zeros((2, len(x)))
    for part in held:
        coefficients = own.coefficients(part.absorbed) @ fit.beta[fit.where(part, "absorbed")]
        for i, direction in enumerate((1.0, -1.0)):
            moved[i] += own.at(x, np.full(len(x), direction)) @ coefficients
    forward, backward = (
        tuple((np.array(values) + more).tolist())
        for values, more in zip((table.forward_um, table.backward_um), moved, strict=True)
    )
    return replace(table, forward_um=forward, backward_um=backward)


def compensated(parts: Sequence[Part], terms: Mapping[Part, Term]) -> dict[Part, Term]:
    """The terms of effects that a machine is compensated for."""
    found = {part: terms[part] for part in parts if part in terms}
    return {key: term for key, term in found.items() if term.effect.action_for(term) is Action.COMPENSATE}


def improves(before: Floats, after: Floats, fold: Ints) -> bool:
    """Whether the squared error of the folds falls by more than its standard error, in the mean over them."""
    gain = np.array([float(np.sum(before[fold == i] ** 2 - after[fold == i] ** 2)) for i in np.unique(fold)])
    if len(gain) < 2:
        return bool(np.sum(gain) > 0.0)
    return bool(np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(len(gain)))
