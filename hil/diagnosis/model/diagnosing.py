"""From records to a diagnosis: rows, search, verdict, what is put into force."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from hil.diagnosis.campaign import AllRows, CampaignRows, Floats
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.evidence import Fit, Noise, Part, score
from hil.diagnosis.model.force import Folds, Force, compensated, improves
from hil.diagnosis.model.intervals import terms_of
from hil.diagnosis.model.offer import Offer
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.rows import Given, ModelRows
from hil.diagnosis.model.search import Search
from hil.diagnosis.model.unlogged import share_of
from hil.diagnosis.model.verdict import Verdict
from hil.diagnosis.repeats import pure_error
from hil.diagnosis.result import Blind, Diagnosis, Figures, Finding, NoiseParts
from hil.diagnosis.stored import can_be_held_out
from hil.effects import ALL, Effect, Term
from hil.effects.history import stand_ins
from hil.effects.model import Model
from hil.effects.warming import as_far_as_seen, follows_a_temperature, is_bounded
from hil.records.rows import UM_PER_MM, Records

SATURATED = "the table takes every degree of freedom of these rows, so nothing can be left beside it: measure each target once more"
LEAST_DOF = 4
BLIND = 0.01
"""Share of an effect left beside the table below which the campaign cannot show it."""


def diagnose(
    records: Records, declared: Model | None = None, *, effects: Sequence[Effect] = ALL, seed: int = 0
) -> Diagnosis:
    """Finds the effects that the declared model lacks.

    declared: the known model or that in force; without it a bidirectional table is fitted from the records themselves
    Raises InputError when the records are too few.
    """
    started = time.perf_counter()
    with threadpool_limits(1, "blas"):  # many small products, slower with threads
        return replace(Case(records, declared, effects, seed).diagnosis(), seconds=time.perf_counter() - started)


def own_rows(campaign: CampaignRows, declared: Model | None) -> ModelRows:
    """The rows beside a table of their own, without what the terms of a declared model explain."""
    if declared is None:
        return ModelRows(campaign)
    known_um = sum((t.error_um(campaign.columns) for t in _as_seen(declared, campaign).terms), np.zeros(len(campaign)))
    return ModelRows(replace(campaign, error_um=campaign.error_um - known_um))


def rows_of(campaign: CampaignRows, declared: Model | None, noise_um: float | None = None) -> ModelRows:
    """The rows beside a table of their own, or beside a declared model, whose uncertainty counts against their white noise, µm: that
    beside a table alone, where it is not known.
    """
    own = own_rows(campaign, declared)
    if declared is None:
        return own
    usual_um = Fit(own, (), score(own, ())[0].noise).sigma if noise_um is None else noise_um
    return ModelRows(campaign, Given.of(_as_seen(declared, campaign), usual_um))


def _is_of(declared: Model, campaign: CampaignRows) -> bool:
    """Whether a declared table was fitted from these rows, so that it says nothing which they do not."""
    if declared.terms:
        return False
    rows = ModelRows(campaign)
    own = Force(Fit(rows, (), score(rows, ())[0].noise), {}).model().table
    table = declared.table
    sides = ((table.forward_um, own.forward_um), (table.backward_um, own.backward_um))
    return table.positions_mm == own.positions_mm and all(np.allclose(*side) for side in sides)


def _as_seen(declared: Model, campaign: CampaignRows) -> Model:
    """A declared model whose bounded terms go as far as these rows do."""
    return declared.with_terms([as_far_as_seen(t, campaign.columns) if is_bounded(t) else t for t in declared.terms])


def searched(campaign: CampaignRows, declared: Model | None, effects: Sequence[Effect]) -> tuple[Search, Fit]:
    """The parts. A declared model decides only what it lacks of position and direction: all else is what shows beside any table,
    unless another effect is likelier beside the declared one."""
    search, found = _searched(own_rows(campaign, declared), effects)
    if declared is None:
        return search, found
    rows = rows_of(campaign, declared, found.sigma)
    static = [effect for effect in effects if effect.static]
    _, found = _searched(rows, static, found.parts)
    search = Search(found.rows, Catalogue(rows, effects))
    return search, search.fit(search.exchanged(found.parts))


def _searched(rows: ModelRows, effects: Sequence[Effect], kept: Sequence[Part] = ()) -> tuple[Search, Fit]:
    """The parts beside some that stay."""
    catalogue = Catalogue(rows, effects)
    stay = catalogue.again(kept)
    search = Search(rows, catalogue, stay)
    return search, search.run(stay)


def _not_corrected(name: str) -> str:
    return f"{name} is not corrected: runs left out are no better with it than without"


@dataclass(frozen=True)
class InForce:
    """What is corrected, its left-out residuals, and notes."""

    force: Force
    after_um: Floats
    notes: tuple[str, ...] = ()


class Case:
    """One diagnosis, step by step."""

    def __init__(self, records: Records, declared: Model | None, effects: Sequence[Effect], seed: int) -> None:
        self.records, self.effects = records, effects
        self.rows = AllRows.of(records, seed)
        self.campaign = self.rows.searched
        self.declared = None if declared is None or _is_of(declared, self.campaign) else declared
        self.folds = Folds.of(self.rows, self.campaign.run)
        self.search, self.found = searched(self.campaign, self.declared, effects)
        recorded = [name for name, values in records.columns.items() if np.all(np.isfinite(values))]
        self.verdict = Verdict(self.search, self.found, recorded)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        return self.verdict.findings()

    @cached_property
    def null(self) -> Force:
        """The table, or the declared model, alone."""
        return Force(self.search.fit(()), {})

    @cached_property
    def before_um(self) -> Floats:
        """What the declared model leaves; without one, the table of the other runs."""
        if self.declared is not None:
            return self.rows.error_um - self.declared.error_um(self.rows.columns)
        return self.null.left_out_um(self.rows, self.folds)

    @cached_property
    def in_force(self) -> InForce:
        """What is corrected: each effect of the machine that helps on runs left out, beside everything else that was found."""
        if not self.found.parts:
            return self._suspected()
        parts, notes = self.found.parts, []
        whole = self._left_out(parts)
        for name in dict.fromkeys(term.effect.id for term in compensated(parts, self.verdict.terms).values()):
            fewer = tuple(part for part in parts if part.name != name)
            without = self._left_out(fewer)
            if not improves(without, whole, self.folds.of_all):
                notes.append(_not_corrected(name))
                parts, whole = fewer, without
        fit = self.search.fit(parts)
        terms = self.verdict.terms if parts is self.found.parts else terms_of(fit)
        force = Force(fit, self._bounded(compensated(parts, terms)))
        return self._with_gain(InForce(force, force.left_out_um(self.rows, self.folds), tuple(notes)))

    def _with_gain(self, taken: InForce) -> InForce:
        """What is corrected, where it leaves less than the model before. Beside a cause of the set-up, which both leave and which
        hides the gain, each correction has shown its own."""
        live = taken.force.live
        of_set_up = len(compensated(self.found.parts, self.verdict.terms)) < len(self.verdict.terms)
        if not live or of_set_up or self._gains(taken.after_um):
            return taken
        names = dict.fromkeys(term.effect.id for term in live.values())
        return self._nothing((*taken.notes, *map(_not_corrected, names)))

    def _nothing(self, notes: tuple[str, ...] = ()) -> InForce:
        return InForce(self.null, self.null.left_out_um(self.rows, self.folds), notes)

    def _gains(self, after_um: Floats) -> bool:
        return Figures.of(after_um).rms_um < Figures.of(self.before_um).rms_um

    def _left_out(self, parts: tuple[Part, ...]) -> Floats:
        """What these parts all together leave on runs left out; about each run's mean beside a cause that no run predicts."""
        terms = {part: self.verdict.terms[part] for part in parts if not part.is_remainder}
        left = Force(self.search.fit(parts), terms).left_out_um(self.rows, self.folds)
        if any(term.effect.once for term in self.verdict.terms.values()):
            for index in np.unique(self.folds.of_all):
                mine = self.folds.of_all == index
                left[mine] -= np.mean(left[mine])
        return left

    def _bounded(self, live: Mapping[Part, Term]) -> dict[Part, Term]:
        """The terms, of which those by a temperature that is not sure go no further than it went on these rows."""
        sure = {f.effect: min(f.confidence, f.follows[0][1] if f.follows else 1.0) for f in self.findings}
        return {
            key: as_far_as_seen(term, self.rows.columns)
            if follows_a_temperature(term.form) and sure.get(term.effect.id, 0.0) < USUAL.sure
            else term
            for key, term in live.items()
        }

    def _suspected(self) -> InForce:
        """Where nothing was found: the likeliest effect of the machine that helps runs left out, times its posterior."""
        nothing = self._nothing()
        none = self.search.log_p(())
        for one in self.search.alternatives((), remainder=False):
            if one.log_p <= none:
                break
            if one.part.of is None or one.part.of.effect.static or one.part.of.effect.once:
                continue
            fit = Fit(self.search.rows, [one.part], one.noise)
            live = self._bounded(compensated([one.part], terms_of(fit)))
            if not live:
                continue
            share = share_of({"": none, one.part.name: one.log_p})[one.part.name]
            force = Force(fit, live, share)
            after = force.left_out_um(self.rows, self.folds)
            if not improves(nothing.after_um, after, self.folds.of_all) or not self._gains(after):
                return nothing
            (term,) = force.model().terms[-1:]
            note = (
                f"{one.part.name} is suspected (posterior {share:.2f}): noise may make as much, so it is no finding; the extended"
                f" model holds that share of it. {term.effect.explain(term)}"
            )
            return InForce(force, after, (note,))
        return nothing

    def diagnosis(self) -> Diagnosis:
        force = self.in_force
        carriers = self.verdict.carriers
        whole = Force(self.found, self.verdict.terms)
        clean = self.rows.error_um - sum((t.error_um(self.rows.columns) for t in self.verdict.terms.values()), 0.0)
        after, alone = Figures.of(force.after_um), Figures.of(self.rows.error_um)
        base = self.declared if self.declared is not None else self.null.model()
        diagnosis = Diagnosis(
            pure_error=pure_error(self.rows.columns, clean),
            noise=_noise_parts(self.found.sigma, self.found.noise),
            declared=base,
            extended=force.force.model(),
            findings=self.findings,
            unexplained=bool(carriers),
            carriers=carriers,
            blind=tuple(self._blind()),
            before_um=self.before_um,
            after_um=force.after_um,
            setup_um=whole.left_out_um(self.rows, self.folds),
            residual_um=self.rows.error_um - whole.model().error_um(self.rows.columns),
            held_out=self.folds.how,
            recommended=after.rms_um < alone.rms_um,
            notes=(*self._notes(after, alone), *force.notes),
        )
        return Offer(self.search, force.force, self.rows, self.folds).beside(diagnosis)

    def _blind(self) -> Iterator[Blind]:
        beside = self.search.catalogue.beside
        for effect in self.effects:
            share = 0.0 if effect.is_table and not self.search.rows.is_declared else beside.get(effect.id, 1.0)
            if share < BLIND and not (self.search.rows.is_declared and effect.static):
                yield Blind(effect.id, f"only {100 * share:.2g} % of it is left beside the table")

    def _notes(self, after: Figures, alone: Figures) -> Iterator[str]:
        records, rows = self.records, self.rows
        yield from (f"{name} is missing: made up from the row order" for name in stand_ins(records.columns))
        for name, values in records.columns.items():
            absent = int(np.sum(~np.isfinite(values)))
            if 0 < absent < len(records):
                yield f"{name} is missing in {absent} of {len(records)} rows: the column is not used"
        if "time_s" in records.columns and (back := int(np.sum(np.diff(records["time_s"]) < 0.0))):
            often = "once" if back == 1 else f"{back} times"
            yield f"time_s goes back {often}: what depends on the time cannot be trusted; give each row the time since the first"
        if rows.step_mm is not None:
            step_um = rows.step_mm * UM_PER_MM
            yield f"the readings move in steps of {step_um:g} µm, coarser than their noise: below half a step nothing is found"
        if len(rows.kept) < len(records):
            yield f"searched and fitted on {len(rows.kept)} of {len(records)} rows, drawn evenly; the held-out figures are on all"
        if len(self.campaign) - self.null.fit.spent < LEAST_DOF:
            yield SATURATED
        if not can_be_held_out(self.folds.how):
            yield "one run only: a second one has to show whether the correction holds"
        elif after.rms_um >= alone.rms_um:
            yield (
                f"not recommended: on rows that were not fitted the correction leaves {after.rms_um:.3g} µm RMS,"
                f" and no correction at all {alone.rms_um:.3g} µm"
            )


def _noise_parts(white_um: float, noise: Noise) -> NoiseParts:
    memory = noise.memory
    rows = -1.0 / math.log(memory.rho) if 0.0 < memory.rho < 1.0 and memory.ar else 0.0
    return NoiseParts(white_um, white_um * memory.ar, rows, white_um * noise.offset)
