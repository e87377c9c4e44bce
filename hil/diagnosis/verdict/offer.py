"""An optional correction of the unexplained part: its conditions, and the diagnosis with it.

It is never part of a diagnosis by itself, only on request (`Diagnosis.non_parametric`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hil.diagnosis.result import Diagnosis, Figures
from hil.diagnosis.search.structure_estimate import StructureEstimate
from hil.diagnosis.verdict.held_out import HeldOut, improves_held_out
from hil.effects.model import Model
from hil.effects.non_parametric import CAUSE_UNKNOWN
from hil.effects.survey import READ_AFTER_MOTION
from hil.records.rows import Floats

OPTION = "--non-parametric"
AFTERWARDS = frozenset({"run", "row_order", "measured_mm", *READ_AFTER_MOTION})
"""Columns that are not known when a command is issued: counted in the records, or read at the capture after the
motion.
"""


def offered(
    diagnosis: Diagnosis,
    structures: Sequence[StructureEstimate],
    left_out: HeldOut,
    fitted_um: Floats,
    alone: Figures,
    *,
    bare: Model,
    formless: bool = False,
) -> Diagnosis:
    """The diagnosis with this correction beside it, and a note where something is unexplained.

    structures: the unexplained ones; fitted_um: their sum on the rows of the residual, (n,); alone: figures without any
    correction; bare: the extended model, whose table holds nothing of the structures; formless: something is left that has no
    smooth form which could be applied to other rows
    """
    reason = _reason(diagnosis, structures, left_out, formless=formless)
    if reason:
        notes = (f"no correction without a known cause either ({OPTION}): {reason}",) if diagnosis.unexplained else ()
        return replace(diagnosis, non_parametric=reason, notes=(*diagnosis.notes, *notes))
    terms = tuple(term for structure in structures for term in structure.terms)
    after = Figures.of(left_out.bare - left_out.structure_term_um)
    along = "; ".join(" × ".join(structure.columns) for structure in structures)
    extended = replace(
        bare,
        terms=(*bare.terms, *terms),
        about={**bare.about, "non_parametric": f"follows {along}; {CAUSE_UNKNOWN}"},
    )
    worth = f"on runs left out it leaves {after.rms_um:.3g} µm RMS instead of {diagnosis.after.rms_um:.3g}"
    taken = replace(
        diagnosis,
        extended=extended,
        after_um=left_out.bare - left_out.structure_term_um,
        setup_um=left_out.setup - left_out.structure_term_um,
        residual_um=diagnosis.residual_um - fitted_um,
        recommended=after.rms_um < alone.rms_um,
        notes=(*diagnosis.notes, *(f"{OPTION}: {term.effect.explain(term)}" for term in terms), f"{OPTION}: {worth}"),
    )
    note = f"{OPTION} adds a smooth function of {along} to the extended model, though {CAUSE_UNKNOWN}: {worth}"
    return replace(diagnosis, non_parametric=taken, notes=(*diagnosis.notes, note))


def _reason(diagnosis: Diagnosis, structures: Sequence[StructureEstimate], left_out: HeldOut, *, formless: bool) -> str:
    """Why there is no such correction; empty where there is one."""
    if not diagnosis.unexplained:
        return "nothing is left unexplained"
    if not structures:
        doubted = [finding.effect for finding in diagnosis.findings if finding.doubtful]
        if doubted:
            return f"what is left is corrected already as {' and '.join(doubted)}, whose name is in doubt"
        hangs = "hangs together from row to row and follows no column"
        how = hangs if diagnosis.carriers else "does not repeat from run to run"
        return f"what is left {'is no smooth function of its columns' if formless else how}"
    unknown = {name for structure in structures for name in structure.columns} & AFTERWARDS
    if unknown:
        return f"{' and '.join(sorted(unknown))} is not known when a command is issued"
    before, after = Figures.of(left_out.after), Figures.of(left_out.bare - left_out.structure_term_um)
    if not improves_held_out(left_out.structure_term_gain) or after.rms_um >= before.rms_um:
        return f"on runs left out it does not help for sure ({after.rms_um:.3g} µm RMS, without it {before.rms_um:.3g})"
    return ""
