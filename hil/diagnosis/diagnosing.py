"""From records to a diagnosis: noise, search, structure outside the catalogue, held-out gain, joint refit, in this
order.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri
from threadpoolctl import threadpool_limits

from hil.diagnosis.campaign import AllRows, CampaignRows
from hil.diagnosis.model import diagnosing as model_diagnosing
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.noise.noise_fit import noise_with_speed
from hil.diagnosis.noise.repeats import PureError, pure_error
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import LeftOver, left_over
from hil.diagnosis.remainder.null import row_scale
from hil.diagnosis.result import Blind, Carrier, Diagnosis, Figures, Finding, NoiseParts, RivalFound
from hil.diagnosis.search.choose import Chosen, Problem, beside_table, choose, of_equal_rows, problem_of, settle
from hil.diagnosis.search.fit import Choice, JointFit, joint_fit
from hil.diagnosis.search.likelihood import at_the_maximum, with_regions
from hil.diagnosis.search.structure_estimate import StructureEstimate, rms_of_term, sizes
from hil.diagnosis.stored import can_be_held_out
from hil.diagnosis.verdict.courses import (
    BY_TEMPERATURE,
    bounded_note,
    course_note,
    courses_as_good,
    start_as_good,
    steadier,
    within_what_was_seen,
)
from hil.diagnosis.verdict.held_out import (
    HeldOut,
    held_out,
    is_below_noise,
    suspected_note,
    unproven_choice,
)
from hil.diagnosis.verdict.offer import offered
from hil.diagnosis.verdict.rivals import (
    beaten_by_runs,
    columns_as_good,
    is_unsure,
    separating,
    weights_of,
    with_rivals,
)
from hil.diagnosis.verdict.sift import refitted_without, sift, wanders
from hil.diagnosis.verdict.unlogged import not_told_apart, unrecorded
from hil.effects import ALL, Action, Effect, Estimate, Term
from hil.effects.history import stand_ins
from hil.effects.model import Model
from hil.effects.warming import is_bounded
from hil.records.rows import UM_PER_MM, Records

Floats = NDArray[np.float64]

ENGINE = os.environ.get("HIL_DIAGNOSIS_ENGINE", "search")
"""Which engine diagnoses: "search", or "model" while the two are compared."""
SATURATED = "the table takes every degree of freedom of these rows, so nothing can be left beside it: measure each target once more"


def diagnose(
    records: Records, declared: Model | None = None, *, effects: Sequence[Effect] = ALL, seed: int = 0
) -> Diagnosis:
    """Finds the effects that the declared model lacks.

    declared: the known model or that in force; without it a bidirectional table is fitted from the records themselves
    Raises InputError when the records are too few.
    """
    with threadpool_limits(1, "blas"):  # many small products, slower with threads
        if ENGINE == "model":
            return model_diagnosing.diagnose(records, declared, effects, seed)
        return _diagnose(records, declared, effects, seed)


def _diagnose(records: Records, declared: Model | None, effects: Sequence[Effect], seed: int) -> Diagnosis:
    started = time.perf_counter()
    rows = AllRows.of(records, seed)
    problem, chosen = _choose(rows.searched, effects, declared, seed)
    campaign, is_saturated = problem.campaign, _is_saturated(problem, chosen)
    left_out = held_out(problem, chosen, rows)
    sifted = sift(chosen, left_out, is_saturated=is_saturated)
    chosen, noise, sharper = _at_its_best(sifted.chosen, rows)
    parts = _noise_parts(chosen.fit.white_um, noise)
    found = _findings(chosen, campaign.columns, noise)
    below_noise = {finding.effect: finding for finding in found if is_below_noise(finding, parts.within_run_um)}
    findings = tuple(finding for finding in found if finding.effect not in below_noise)
    if below_noise:
        kept = [choice for choice in chosen.kept if choice.effect.id not in below_noise]
        chosen = replace(chosen, fit=chosen.last.searcher.fit_of_unknown_noise(kept, noise))
    doubtful = {f.effect: f.rms for f in findings if f.doubtful}
    unexplained = sifted.unexplained or bool(doubtful)
    structures = sifted.structures if unexplained else ()
    said = bool(sifted.missing or any(sifted.notes) or below_noise or unexplained)
    extended, courses, said_of_it = _put_into_force(problem, chosen, parts.within_run_um, rows, is_alone=not said)
    base = declared if declared is not None else joint_fit(problem.free, problem.plain, campaign.error_um, ()).extended
    floor = pure_error(rows.columns, rows.error_um - np.sum([t.error_um(rows.columns) for t in extended.found], axis=0))
    residual_um = rows.error_um - extended.whole.error_um(rows.columns)
    alike = noise_of_repeats(floor, campaign, rows, residual_um)
    explained_um = predicted_um(
        floor, parts, len(campaign), _held(problem, noise), alike=1.0 if campaign.scale is None else alike
    )
    apart = can_be_held_out(left_out.how)
    unpredicted = apart and not wanders(chosen) and left_out.usual_um > policy().unpredicted * explained_um
    unexplained = unexplained or unpredicted or exceeds_repeats(floor, parts, alike)
    start = start_as_good(chosen.last.searcher, noise, chosen.kept)
    doubted = sifted.required | _doubted(
        findings,
        chosen,
        courses,
        left_out,
        noise_um=parts.within_run_um,
        unpredicted=unpredicted,
        has_start=bool(start),
    )
    carriers = tuple(_carriers(chosen, doubtful, structures, sifted.left, campaign)) if unexplained else ()
    of_course, findings = _beside_rivals(
        findings, doubted, carriers, effects=effects, records=records, campaign=campaign
    )
    if apart and not unexplained and _predicts_nothing(of_course, left_out, explained_um):
        unexplained, carriers = True, tuple(_carried_without(chosen, of_course, noise, campaign))
    worse = _corrects_worse(findings, left_out) if declared is None else set()
    if worse:  # the table alone predicts runs left out better; a declared one may be of these rows
        extended = within_what_was_seen(refitted_without(chosen, worse, noise).fit, courses, rows.columns)
    if declared is None and not extended.extended.terms:  # the file holds the table alone
        left_out = replace(left_out, after=left_out.before)
    after, alone = Figures.of(left_out.after), Figures.of(rows.error_um)
    found_out = Diagnosis(
        pure_error=floor,
        noise=parts,
        declared=base,
        extended=extended.extended,
        findings=findings,
        unexplained=unexplained,
        carriers=carriers,
        blind=_blind(problem),
        before_um=left_out.before,
        after_um=left_out.after,
        setup_um=left_out.setup,
        residual_um=residual_um,
        held_out=left_out.how,
        recommended=after.rms_um < alone.rms_um,
        notes=(
            *_notes(records, rows, sifted.missing, after, alone, held_out=apart),
            *([SATURATED] if is_saturated else []),
            *sifted.notes,
            *(f"{name} is not corrected: runs left out are worse with it than without" for name in sorted(worse)),
            *map(suspected_note, below_noise.values()),
            *sifted.misfit_notes,
            *said_of_it,
            *([start] if start else []),
            *sharper,
            *beyond_noise(
                floor,
                parts,
                Figures.of(left_out.setup).rms_um if apart else 0.0,
                explained_um,
                len(campaign),
                alike=alike,
            ),
        ),
    )
    fitted_um = sum((structure.error_um(rows.columns) for structure in structures), np.zeros(len(rows)))
    told = offered(found_out, structures, left_out, fitted_um, alone, bare=extended.bare, formless=bool(sifted.left))
    return replace(told, seconds=time.perf_counter() - started)


def _doubted(
    findings: Sequence[Finding],
    chosen: Chosen,
    courses: Collection[str],
    left_out: HeldOut,
    *,
    noise_um: float,
    unpredicted: bool,
    has_start: bool,
) -> set[str]:
    """The effects whose names may be those of causes that nobody recorded.

    courses: effects by a temperature that a course of time replaces; noise_um: of the rows, its standard deviation
    unpredicted: runs left out vary by more than noise explains
    has_start: a body that starts away from what its sensor says fits as well as what was found of temperatures
    """
    campaign = chosen.last.searcher.linear.campaign
    return beaten_by_runs(chosen) | {
        f.effect
        for f in findings
        if unpredicted
        or f.effect in courses
        or (has_start and f.effect in BY_TEMPERATURE)
        or is_unsure(f, findings, campaign, noise_um)
        or f.is_implausible
        or _is_mostly_in_table(f, chosen, campaign)
        or (left_out.is_worse and f.term.effect.static)
    }


def _beside_rivals(
    findings: Sequence[Finding],
    doubted: Collection[str],
    carriers: Sequence[Carrier],
    *,
    effects: Sequence[Effect],
    records: Records,
    campaign: CampaignRows,
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """The findings as sure as their courses, then as sure as their names: a course that two causes share is explained all the same."""
    recorded = [name for name, values in records.columns.items() if np.all(np.isfinite(values))]
    unseen = unrecorded(effects, campaign.survey, recorded)
    two = not_told_apart(findings, recorded, campaign.columns)
    alike = {f.effect: (*two.get(f.effect, ()), *f.term.effect.stands_for(f.term.form)) for f in findings}
    of_course, of_name = (with_rivals(findings, doubted, unseen, one, carriers) for one in ({}, alike))
    return of_course, of_name


def _is_saturated(problem: Problem, chosen: Chosen) -> bool:
    """Whether the table leaves no rows to tell anything else by, as one run with a knot at each target does."""
    return len(problem.campaign) - _held(problem, chosen.last.noise) < policy().least_dof


def _choose(
    campaign: CampaignRows, effects: Sequence[Effect], declared: Model | None, seed: int
) -> tuple[Problem, Chosen]:
    """The choice with its problem; made again with rows weighted where what it leaves grows with the speed."""
    problem = problem_of(campaign, effects, declared, seed)
    chosen = choose(problem)
    left_um = campaign.error_um - chosen.fit.whole.error_um(campaign.columns) - chosen.fit.nuisance_um
    scale = noise_with_speed(left_um, campaign)
    if scale is not None:
        problem = problem_of(replace(campaign, scale=scale), effects, declared, seed)
        chosen = choose(problem)
    return problem, settle(chosen)


def _put_into_force(
    problem: Problem, chosen: Chosen, noise_um: float, rows: AllRows, *, is_alone: bool
) -> tuple[JointFit, dict[str, float], list[str]]:
    """The fit of which the extended model is made, the temperatures that a course of time replaces (`courses_as_good`), and notes.

    is_alone: nothing was found, or taken away, beside which an effect could be suspected
    """
    suspected = _unproven(problem, chosen, noise_um) if is_alone else None
    fit, choices = (chosen.fit, chosen.kept) if suspected is None else suspected
    courses = courses_as_good(chosen.last.searcher, chosen.last.noise, choices)
    bounded = within_what_was_seen(fit, courses, rows.columns, is_suspected=suspected is not None)
    declared = [term for term in bounded.extended.terms if term not in bounded.found]
    names = {choice.effect.id: choice.form.inputs[0] for choice in choices if choice.effect.id in courses}
    notes = [bounded_note(term) for term in declared if is_bounded(term)]
    if suspected is not None:  # what a course of time says of it is in that note
        return bounded, courses, [*notes, *map(_suspicion, bounded.found)]
    notes = [*(course_note(effect, column, courses[effect]) for effect, column in names.items()), *notes]
    return bounded, courses, notes


def _unproven(problem: Problem, chosen: Chosen, noise_um: float) -> tuple[JointFit, tuple[Choice, ...]] | None:
    """The fit with an effect that is suspected only, and its choice, where it is more than noise that wanders."""
    choice = unproven_choice(problem, chosen)
    if choice is None:
        return None
    searcher = chosen.last.searcher
    fit = searcher.fit_of_unknown_noise((choice,), searcher.smooth((choice,), chosen.last.noise))
    if rms_of_term(fit.found[0], problem.campaign.columns).value < policy().wander * noise_um:
        return None
    return fit, (choice,)


def _at_its_best(chosen: Chosen, rows: AllRows) -> tuple[Chosen, Noise, list[str]]:
    """The choice as it is corrected, with its parameters where they are likeliest beside a table as smooth as the rows show; its noise
    model, and notes.
    """
    last, kept = chosen.last, chosen.kept
    noise = last.searcher.smooth(kept, last.noise)
    steady, notes = steadier(last.searcher, noise, kept, rows.searched_as_read)
    moved = at_the_maximum(last.searcher, steady, noise)
    fit = with_regions(last.searcher, last.searcher.fit_of_unknown_noise(moved, noise), moved, noise)
    best = replace(last, choices=(*moved, *(one for one in last.choices if one not in kept)))
    return replace(chosen, selections=(*chosen.selections[:-1], best), fit=fit), noise, notes


def _noise_parts(white_um: float, noise: Noise) -> NoiseParts:
    rows = -1.0 / math.log(noise.rho) if 0.0 < noise.rho < 1.0 and noise.ar else 0.0
    return NoiseParts(white_um, white_um * noise.ar, rows, white_um * noise.offset)


def _held(problem: Problem, noise: Noise) -> float:
    """Degrees of freedom that the table takes: the trace of its projection."""
    table = problem.free.linear.table
    w = table.table_width
    gram = table.stacked[:, :w].T @ table.stacked[:, :w]
    return float(np.trace(np.linalg.solve(gram + np.diag(table.ridge(noise)[:w]) + 1e-9 * np.eye(w), gram)))


def predicted_um(floor: PureError | None, parts: NoiseParts, rows: int, table: float, *, alike: float = 1.0) -> float:
    """RMS of the residual of rows left out that noise, its memory and the offsets of the runs explain, where the table took so many
    degrees of freedom. alike: as in `exceeds_repeats`.
    """
    least_um = parts.white_um if floor is None else floor.std_um.value / alike
    explained_um = math.hypot(least_um, parts.memory_um, parts.run_offset_um)
    return explained_um * math.sqrt(1.0 + 2.0 * table / max(rows - table, 1.0))


def beyond_noise(
    floor: PureError | None,
    parts: NoiseParts,
    held_out_um: float,
    explained_um: float,
    rows: int,
    *,
    alike: float = 1.0,
) -> Iterator[str]:
    """A note where the rows that were left out, or those that were fitted, vary by more than the noise explains. alike: as in
    `exceeds_repeats`.
    """
    dof = rows if floor is None else floor.dof
    limit = float(fdtri(rows, dof, 1.0 - policy().false_findings))
    if held_out_um > explained_um * math.sqrt(limit):
        yield (
            f"on rows left out {held_out_um:.3g} µm RMS remain, and noise, its memory and the offsets of the runs explain"
            f" {explained_um:.3g} µm: something that does not repeat from run to run is not in the model"
        )
    if floor is not None and parts.white_um * alike > floor.std_um.value * math.sqrt(limit):
        yield (
            f"from row to row {parts.white_um:.3g} µm remain, and repeats differ by {floor.std_um} µm ({floor.dof} degrees of"
            " freedom): what is left beside the model is more than noise"
        )


def exceeds_repeats(floor: PureError | None, parts: NoiseParts, alike: float = 1.0) -> bool:
    """Whether what is left from row to row is far more than repeats of one target differ by, even at the upper end of their 95 %.

    alike: noise of the rows that were repeated over that of all; it may grow with the speed, and repeats are often at rest
    """
    if floor is None:
        return False
    upper_um = floor.std_um.value * math.sqrt(floor.dof / float(chdtri(floor.dof, 0.975)))
    return parts.white_um * alike > policy().beyond_repeats * upper_um


def noise_of_repeats(floor: PureError | None, campaign: CampaignRows, rows: AllRows, residual_um: Floats) -> float:
    """Noise of the rows that were repeated over that of all rows: by the speed, where it was found to grow with that, else by the run,
    the speed and the quarter of the travel of each.
    """
    mine = np.isin(rows.kept, () if floor is None else floor.rows)
    if not np.any(mine):
        return 1.0
    scale = row_scale(residual_um[rows.kept], campaign) if campaign.scale is None else campaign.scale
    return float(np.sqrt(np.mean(scale[mine] ** 2)))


def _notes(
    records: Records, rows: AllRows, dropped: Sequence[str], after: Figures, alone: Figures, *, held_out: bool
) -> Iterator[str]:
    """held_out: whole runs were left out, which a single run does not have."""
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
    yield from (f"{name} fits these rows but does not help on runs left out: not taken" for name in dropped)
    if not held_out:
        yield "one run only: a second one has to show whether the correction holds"
    elif after.rms_um >= alone.rms_um:
        yield (
            f"not recommended: on rows that were not fitted the correction leaves {after.rms_um:.3g} µm RMS,"
            f" and no correction at all {alone.rms_um:.3g} µm"
        )


def _suspicion(term: Term) -> str:
    column = term.form.inputs[0] if term.form.inputs else ""
    bound = (
        f" The correction follows {column} as far as it went on these rows, and no further." if is_bounded(term) else ""
    )
    return (
        f"{term.effect.id} is suspected: more likely than not, and better on runs left out, so the extended model holds it; noise may"
        f" make as much, so it is no finding. {term.effect.explain(term)}{bound}"
    )


def _is_mostly_in_table(finding: Finding, chosen: Chosen, campaign: CampaignRows) -> bool:
    """Whether the table can hold most of an effect of position and direction: its size and name rest on what is left."""
    if not finding.term.effect.static:
        return False
    terms = finding.terms if finding.summed else (finding.term,)
    whole_um = np.sum([term.error_um(campaign.columns) for term in terms], axis=0)
    size_um = float(np.std(whole_um)) if finding.summed else finding.rms_um
    return of_equal_rows(chosen).rms_left(whole_um) < policy().in_table * size_um


def _findings(chosen: Chosen, columns: Mapping[str, Floats], noise: Noise) -> tuple[Finding, ...]:
    """The findings, largest first."""
    findings: list[Finding] = []
    named: set[str] = set()
    free = {choice.effect.id for choice in chosen.selections[0].choices}
    for term in sorted(chosen.fit.found, key=lambda one: -float(np.std(one.error_um(columns)))):
        effect = term.effect
        if effect.id in named:
            continue
        named.add(effect.id)
        weights = weights_of(chosen, effect.id)
        rivals = [
            RivalFound(name, weight, separating(effect, name))
            for name, weight in weights.items()
            if name != effect.id and weight > policy().least_confidence
        ]
        confidence = weights.get(effect.id, 1.0)
        mine = [one for one in chosen.fit.found if one.effect.id == effect.id and one is not term]
        more = tuple(sorted(mine, key=lambda one: -float(np.std(one.error_um(columns)))))
        of_rows = np.sum([one.error_um(columns) for one in (term, *more)], axis=0)
        if more and not effect.several and effect.id in free:  # the rows determine their sum, and only beside the table
            of_rows = beside_table(chosen, of_rows)
        rms, peak = float(np.std(of_rows)), float(np.max(np.abs(of_rows - np.mean(of_rows))))
        std = rms * _unsure_of_size(chosen, effect.id, of_rows) if more else rms_of_term(term, columns).std
        follows = () if more else columns_as_good(chosen, term, noise)
        vague = not more and _is_vague(term, rms, columns)
        findings.append(
            Finding(term, confidence, tuple(rivals), rms, std, peak, more, effect.id in free, follows, vague)
        )
    return in_order(findings)


def _is_vague(term: Term, rms_um: float, columns: Mapping[str, Floats]) -> bool:
    """Whether the rows determine the course of an effect, of this RMS, and none of its coefficients: the standard uncertainty of each
    alone would make a larger one.
    """
    basis = term.effect.basis(term.form, term.theta, columns)
    std = np.sqrt(np.maximum(np.diag(np.array(term.covariance))[: basis.shape[1]], 0.0))
    return bool(np.all(std * np.std(basis, axis=0) > rms_um))


def in_order(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The findings, largest first, but the mean of one that varies along the axis after that one."""
    size = {finding.effect: finding.rms_um for finding in findings}

    def key(finding: Finding) -> tuple[float, bool]:
        whole = size.get(finding.term.effect.mean_of)
        return (-finding.rms_um, False) if whole is None else (-min(finding.rms_um, whole), True)

    return tuple(sorted(findings, key=key))


def _unsure_of_size(chosen: Chosen, effect: str, of_rows: Floats) -> float:
    """Relative standard uncertainty of the size of a course of the rows (n,), µm, beside table and other effects, its form given."""
    last = chosen.last
    others = [choice for choice in chosen.kept if choice.effect.id != effect]
    projection = last.searcher.projection(last.noise, last.searcher.extra(others))
    return chosen.fit.white_um / (projection.rms_left(of_rows) * math.sqrt(len(of_rows)))


def _carriers(
    chosen: Chosen,
    doubtful: Mapping[str, Estimate],
    structures: Sequence[StructureEstimate],
    left: Sequence[LeftOver],
    campaign: CampaignRows,
) -> Iterator[Carrier]:
    """doubtful: RMS, µm, of findings that a cause outside the catalogue explains better than their own effect

    What is left of any form counts before the structures, which were found on the way and are in it.
    """
    last = chosen.last
    for one in left:
        yield Carrier(one.columns, one.rms, one.probability, one.equivalent)
    if left:
        structures = ()
    sizes_um = sizes(last.searcher, chosen.hits, chosen.kept, last.noise) if structures else ()
    for structure, size_um in zip(structures, sizes_um, strict=True):
        yield Carrier(structure.columns, size_um, structure.probability)
    for selected in chosen.selections:
        for effect, foreign_structure in selected.foreign.items():
            if effect in doubtful:
                probability = math.exp(-max(foreign_structure.gain, 0.0))
                yield Carrier(foreign_structure.columns, doubtful[effect], probability)
    if last.memory is not None:
        found = last.memory
        yield Carrier((campaign.survey.time_column,), found.rms_um, math.exp(-found.log_odds))


def _predicts_nothing(findings: Sequence[Finding], left_out: HeldOut, explained_um: float) -> bool:
    """Whether runs left out vary far more than noise explains while a name is not sure, or there is none."""
    if findings and not _unsure(findings):
        return False
    return Figures.of(left_out.setup).rms_um > policy().unsure_beyond * explained_um


def _corrects_worse(findings: Sequence[Finding], left_out: HeldOut) -> set[str]:
    """The effects that are not to be corrected: their names are not sure, and runs left out are worse with what is corrected."""
    return _unsure(findings) & _corrected(findings) if left_out.corrects_worse else set()


def _corrected(findings: Sequence[Finding]) -> set[str]:
    return {finding.effect for finding in findings if finding.action is Action.COMPENSATE}


def _unsure(findings: Sequence[Finding]) -> set[str]:
    """The effects whose names are not sure."""
    return {finding.effect for finding in findings if finding.confidence < policy().sure}


def _carried_without(
    chosen: Chosen, findings: Sequence[Finding], noise: Noise, campaign: CampaignRows
) -> Iterator[Carrier]:
    """What carries the rest where the effects whose names are not sure are taken away."""
    without = refitted_without(chosen, _unsure(findings), noise)
    left = left_over(without.last.searcher, without.kept, noise, without.unclaimed)
    yield from _carriers(without, {}, (), left, campaign)


def _blind(problem: Problem) -> tuple[Blind, ...]:
    seen = problem.static.effects if problem.static is not None else ()
    return tuple(
        Blind(name, f"only {100 * share:.2g} % of it is left beside the table")
        for name, share in problem.visible.items()
        if share < policy().blind and name not in seen
    )
