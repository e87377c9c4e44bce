"""From records to a diagnosis: noise, search, structure outside the catalogue, held-out gain, joint refit, in this
order.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.thin import AllRows
from hil.diagnosis.result import OUTSIDE, Blind, Carrier, Diagnosis, Figures, Finding, RivalFound
from hil.diagnosis.search.candidates import BLIND
from hil.diagnosis.search.choose import Chosen, Problem, choose, problem_of
from hil.diagnosis.search.fit import joint_fit
from hil.diagnosis.search.judge import ACCEPTED_FROM
from hil.diagnosis.search.select import structure_rms
from hil.diagnosis.search.structure_estimate import StructureEstimate, rms_of_term, sizes, structure_estimates
from hil.diagnosis.verdict.held_out import ONCE, HeldOut, held_out, improves_held_out
from hil.diagnosis.verdict.offer import offered
from hil.diagnosis.verdict.suspected import is_below_noise, suspected_note, unproven_choice
from hil.effects import ALL, Effect, Estimate, Term
from hil.effects.history import stand_ins
from hil.effects.model import Model
from hil.records.rows import Records

Floats = NDArray[np.float64]

TEMPERATURE = 2.0
"""Divisor of the log odds between effects before they become confidences, since no form is exactly right."""
LEAST_CONFIDENCE = 0.02
"""Confidence below which a rival is not listed."""


def diagnose(
    records: Records, declared: Model | None = None, *, effects: Sequence[Effect] = ALL, seed: int = 0
) -> Diagnosis:
    """Finds the effects that the declared model lacks.

    declared: the known model or that in force; without it a bidirectional table is fitted from the records themselves
    Raises InputError when the records are too few.
    """
    with threadpool_limits(1, "blas"):  # many small products, slower with threads
        return _diagnose(records, declared, effects, seed)


def _diagnose(records: Records, declared: Model | None, effects: Sequence[Effect], seed: int) -> Diagnosis:
    started = time.perf_counter()
    rows = AllRows.of(records, seed)
    campaign = rows.searched
    problem = problem_of(campaign, effects, declared, seed)
    chosen = choose(problem)
    left_out = held_out(problem, chosen, rows)
    chosen, unexplained, dropped = without_unproven(chosen, left_out)
    noise = chosen.last.noise
    floor = chosen.fit.white_um * math.hypot(1.0, noise.ar)
    found = _findings(chosen, campaign.columns)
    below_noise = {finding.effect: finding for finding in found if is_below_noise(finding, floor)}
    findings = tuple(finding for finding in found if finding.effect not in below_noise)
    if below_noise:
        chosen = refitted_without(chosen, below_noise)
    doubtful = {finding.effect: finding.term for finding in findings if finding.doubtful}
    unexplained = unexplained or bool(doubtful)
    structures = structure_estimates(chosen.last.searcher, chosen.hits, chosen.kept, noise) if unexplained else ()
    suspected = None if dropped or below_noise or unexplained else unproven_choice(problem, chosen)
    extended = chosen.fit if suspected is None else chosen.last.searcher.fit((suspected,), noise)
    base = declared if declared is not None else joint_fit(problem.free, problem.plain, campaign.error_um, ()).extended
    dof = max(len(campaign) - problem.free.linear.table.table_width, 4)
    after, alone = Figures.of(left_out.after), Figures.of(rows.error_um)
    found_out = Diagnosis(
        noise_floor=Estimate(floor, floor / math.sqrt(2 * dof)),
        declared=base,
        extended=extended.extended,
        findings=findings,
        unexplained=unexplained,
        carriers=tuple(_carriers(chosen, doubtful, structures, campaign)) if unexplained else (),
        blind=_blind(problem),
        before_um=left_out.before,
        after_um=left_out.after,
        setup_um=left_out.setup,
        residual_um=rows.error_um - extended.whole.error_um(rows.columns),
        held_out=left_out.how,
        recommended=after.rms_um < alone.rms_um,
        notes=(
            *_notes(records, campaign, dropped, after, alone),
            *map(suspected_note, below_noise.values()),
            *(_suspicion(term) for term in extended.found if suspected is not None),
        ),
    )
    fitted_um = sum((structure.error_um(rows.columns) for structure in structures), np.zeros(len(rows)))
    told = offered(found_out, structures, left_out, fitted_um, alone)
    return replace(told, seconds=time.perf_counter() - started)


def _notes(
    records: Records, campaign: CampaignRows, dropped: Sequence[str], after: Figures, alone: Figures
) -> Iterator[str]:
    yield from (f"{name} is missing: made up from the row order" for name in stand_ins(records.columns))
    if len(campaign) < len(records):
        yield f"searched and fitted on {len(campaign)} of {len(records)} rows, drawn evenly; the held-out figures are on all"
    yield from (f"{name} fits these rows but does not help on runs left out: not taken" for name in dropped)
    if after.rms_um >= alone.rms_um:
        yield (
            f"not recommended: on rows that were not fitted the correction leaves {after.rms_um:.3g} µm RMS,"
            f" and no correction at all {alone.rms_um:.3g} µm"
        )


def _suspicion(term: Term) -> str:
    return (
        f"{term.effect.id} is suspected: more likely than not, and better on runs left out, so the extended model holds it; noise may"
        f" make as much, so it is no finding. {term.effect.explain(term)}"
    )


def without_unproven(chosen: Chosen, left_out: HeldOut) -> tuple[Chosen, bool, tuple[str, ...]]:
    """Removes the terms that do not improve left-out runs; also returns whether the structure found does, and the
    effects dropped.
    """
    last = chosen.last
    sure = {*ONCE, *(effect for selected in chosen.selections for effect in selected.beyond(ACCEPTED_FROM))}
    kept = tuple(c for c in last.choices if c.effect.id in sure or improves_held_out(left_out.gain[c.effect.id]))
    hits = chosen.hits
    unexplained = bool(hits) and (
        max(hit.gain for hit in hits) > ACCEPTED_FROM or improves_held_out(left_out.structure)
    )
    unexplained = unexplained or last.memory is not None
    if len(kept) == len(last.choices):
        return chosen, unexplained, ()
    dropped = tuple(dict.fromkeys(c.effect.id for c in last.choices if c not in kept))
    return replace(chosen, fit=last.searcher.fit(kept, last.noise)), unexplained, dropped


def refitted_without(chosen: Chosen, effects: Collection[str]) -> Chosen:
    """The fit again without some effects."""
    kept = [choice for choice in chosen.kept if choice.effect.id not in effects]
    return replace(chosen, fit=chosen.last.searcher.fit(kept, chosen.last.noise))


def _findings(chosen: Chosen, columns: Mapping[str, Floats]) -> tuple[Finding, ...]:
    findings: list[Finding] = []
    named: set[str] = set()
    for term in chosen.fit.found:
        effect = term.effect
        if effect.id in named:
            continue
        named.add(effect.id)
        weights = _doubted(_weights(chosen, effect.id), chosen, term)
        rivals = [
            RivalFound(name, weight, _separate_by(effect, name))
            for name, weight in weights.items()
            if name != effect.id and weight > LEAST_CONFIDENCE
        ]
        rms = float(np.std(term.error_um(columns)))
        findings.append(Finding(term, weights.get(effect.id, 1.0), effect.explain(term), tuple(rivals), rms))
    return tuple(sorted(findings, key=lambda f: -f.rms_um))


def _weights(chosen: Chosen, effect: str) -> dict[str, float]:
    """Weight of each effect at the stage at which this one was taken, best first; 'unexplained' for a cause outside the
    catalogue.
    """
    for selected in chosen.selections:
        for stage in selected.stages:
            if stage.taken and stage.ranking and effect in (stage.about, stage.ranking[0].effect):
                top = stage.ranking[0].evidence
                odds = {r.effect: r.evidence - top for r in stage.ranking}
                if effect in selected.foreign:
                    odds[OUTSIDE] = selected.foreign[effect].log_odds
                raw = {name: math.exp(max(value / TEMPERATURE, -40.0)) for name, value in odds.items()}
                total = sum(raw.values())
                return {name: value / total for name, value in raw.items()}
    return {}


def _doubted(weights: dict[str, float], chosen: Chosen, term: Term) -> dict[str, float]:
    """Lowers the weights by the share of unexplained structure in the term's own columns, whose cause may have caused
    all of the term.
    """
    own = set(term.needs) | {"target_mm", "direction"}
    last = chosen.last
    columns = last.searcher.linear.campaign.columns
    hits = [hit for hit in chosen.hits if set(hit.structure.columns) <= own]
    if not hits:
        return weights
    other = sum(structure_rms(last.searcher, hit, last.choices, last.noise) ** 2 for hit in hits)
    mine = float(np.var(term.error_um(columns)))
    share = other / max(mine + other, 1e-300)
    doubted = {name: weight * (1.0 - share) for name, weight in weights.items()}
    return doubted | {OUTSIDE: doubted.get(OUTSIDE, 0.0) + share}


def _separate_by(effect: Effect, rival: str) -> str:
    for known in effect.rivals:
        if known.effect == rival:
            return known.separate_by
    return "a campaign in which the columns the two read vary apart"


def _carriers(
    chosen: Chosen, doubtful: Mapping[str, Term], structures: Sequence[StructureEstimate], campaign: CampaignRows
) -> Iterator[Carrier]:
    """doubtful: the terms of findings that a cause outside the catalogue explains better than their own effect."""
    last = chosen.last
    sizes_um = sizes(last.searcher, chosen.hits, chosen.kept, last.noise)
    for structure, size_um in zip(structures, sizes_um, strict=True):
        yield Carrier(structure.columns, size_um, structure.probability)
    for selected in chosen.selections:
        for effect, foreign_structure in selected.foreign.items():
            if effect in doubtful:
                rms_um = rms_of_term(doubtful[effect], campaign.columns)
                yield Carrier(foreign_structure.columns, rms_um, math.exp(-max(foreign_structure.gain, 0.0)))
    if last.memory is not None:
        found = last.memory
        yield Carrier((campaign.survey.time_column,), found.rms_um, math.exp(-found.log_odds))


def _blind(problem: Problem) -> tuple[Blind, ...]:
    seen = problem.static.effects if problem.static is not None else ()
    return tuple(
        Blind(name, f"only {100 * share:.2g} % of it is left beside the table")
        for name, share in problem.visible.items()
        if share < BLIND and name not in seen
    )
