"""A correction of what is left without a cause, as a smooth function of columns: on request, and where runs left out are better."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hil.diagnosis.campaign import AllRows
from hil.diagnosis.model.evidence import Candidate, Part
from hil.diagnosis.model.force import Folds, Force, improves
from hil.diagnosis.model.intervals import terms_of
from hil.diagnosis.model.search import Search
from hil.diagnosis.result import Diagnosis, Figures
from hil.effects import Term
from hil.effects.non_parametric import CAUSE_UNKNOWN, NonParametric, smooth_form, spread_of
from hil.effects.survey import READ_AFTER_MOTION

OPTION = "--non-parametric"
AFTERWARDS = frozenset({"run", "row_order", "measured_mm", *READ_AFTER_MOTION})
"""Columns that are not known when a command is issued: counted in the records, or read at the capture after the
motion.
"""


def smooth_part(part: Part, search: Search) -> Part | None:
    """A smooth function of a remainder's columns, random as that is; None where they are more than two, or not known when a command is
    issued.
    """
    names = tuple(name for name in part.names if name != "direction")
    columns = search.rows.campaign.columns
    if not 1 <= len(names) <= 2 or not set(names) <= columns.keys() - AFTERWARDS:
        return None
    form = smooth_form(names, [spread_of(name, columns) for name in names], with_direction="direction" in part.names)
    basis = NonParametric().basis(form, (), columns)
    ratio = search.fit(()).random_gain(basis)[1]
    none, one = basis[:, :0], Candidate(NonParametric(), replace(form, shrunk=True), (), ratio)
    return Part(NonParametric.id, form.inputs, none, basis * math.sqrt(ratio), none, 0.0, one)


@dataclass(frozen=True)
class Offer:
    """What a correction without a cause is made of: the search, what is corrected without it, and the rows to leave out."""

    search: Search
    force: Force
    rows: AllRows
    folds: Folds

    def beside(self, diagnosis: Diagnosis) -> Diagnosis:
        """The diagnosis with this correction beside it, and a note where something is unexplained."""
        left = [part for part in self.force.fit.parts if part.is_remainder]
        if not diagnosis.unexplained:
            return diagnosis
        smooth = [one for part in left if (one := smooth_part(part, self.search)) is not None]
        if len(smooth) == len(left) > 0:
            return self._with(diagnosis, smooth)
        unknown = sorted({name for part in left for name in part.names} & AFTERWARDS)
        if unknown:
            return _refused(diagnosis, f"{' and '.join(unknown)} is not known when a command is issued")
        return _refused(diagnosis, "what is left is no smooth function of its columns")

    def _with(self, diagnosis: Diagnosis, smooth: Sequence[Part]) -> Diagnosis:
        fit = self.search.fit([*(part for part in self.force.fit.parts if not part.is_remainder), *smooth])
        terms = terms_of(fit)
        fitted = {part: _plain(terms[part]) for part in smooth}
        live = {key: term for key, term in terms.items() if key in self.force.live}
        taken, whole = Force(fit, {**live, **fitted}), Force(fit, terms)
        left_um = taken.left_out_um(self.rows, self.folds)
        before, after = diagnosis.after, Figures.of(left_um)
        if not improves(diagnosis.after_um, left_um, self.folds.of_all) or after.rms_um >= before.rms_um:
            why = f"on runs left out it does not help for sure ({after.rms_um:.3g} µm RMS, without it {before.rms_um:.3g})"
            return _refused(diagnosis, why)
        along = "; ".join(" × ".join(part.names) for part in smooth)
        worth = f"on runs left out it leaves {after.rms_um:.3g} µm RMS instead of {before.rms_um:.3g}"
        told = [f"{OPTION}: {term.effect.explain(term)}" for term in fitted.values()]
        model = taken.model()
        other = replace(
            diagnosis,
            extended=replace(model, about={**model.about, "non_parametric": f"follows {along}; {CAUSE_UNKNOWN}"}),
            after_um=left_um,
            setup_um=whole.left_out_um(self.rows, self.folds),
            residual_um=self.rows.error_um - whole.model().error_um(self.rows.columns),
            recommended=after.rms_um < Figures.of(self.rows.error_um).rms_um,
            notes=(*diagnosis.notes, *told, f"{OPTION}: {worth}"),
        )
        note = f"{OPTION} adds a smooth function of {along} to the extended model, though {CAUSE_UNKNOWN}: {worth}"
        return replace(diagnosis, non_parametric=other, notes=(*diagnosis.notes, note))


def _plain(term: Term) -> Term:
    """A term as a model holds it, which does not know how it was fitted."""
    return replace(term, form=replace(term.form, shrunk=False))


def _refused(diagnosis: Diagnosis, why: str) -> Diagnosis:
    note = f"no correction without a known cause either ({OPTION}): {why}"
    return replace(diagnosis, non_parametric=why, notes=(*diagnosis.notes, note))
