"""One complete selection on some rows: noise, catalogue search, structure outside the catalogue, removal of weak terms,
in this order.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import score
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.judge import FoldStructureSearch, Hit, StructureSearch, hit_of
from hil.diagnosis.search.rank import rank
from hil.diagnosis.search.search import Judge, Stage, search
from hil.diagnosis.search.searcher import Memory, Searcher, memory
from hil.diagnosis.search.structure import Catalogue
from hil.effects.air import SENSORS
from hil.effects.survey import Survey

Floats = NDArray[np.float64]

MOST_STRUCTURES = 3
MOST_SWAPS = 4


@dataclass(frozen=True)
class ForeignStructure:
    """The best structure of other columns in place of an effect: log odds against the effect, gain over none."""

    columns: tuple[str, ...]
    log_odds: float
    gain: float


@dataclass(frozen=True)
class Selected:
    """The result of a selection.

    searcher: with the outlier-limited errors and the nuisance columns (unexplained structure, drift within the noise)
    hits: unexplained structures; shapes: small misfits of the terms' own forms
    foreign: by effect, the best structure of other columns in its place
    memory: correlation from row to row beyond that of noise
    """

    searcher: Searcher
    choices: tuple[Choice, ...]
    noise: Noise
    stages: tuple[Stage, ...]
    hits: tuple[Hit, ...] = ()
    shapes: tuple[Hit, ...] = ()
    foreign: dict[str, ForeignStructure] = field(default_factory=dict)
    memory: Memory | None = None

    def beyond(self, log_odds: float) -> set[str]:
        """Effects that were taken with more than these log odds."""
        return {
            r.effect
            for stage in self.stages
            if stage.taken
            for i, r in enumerate(stage.ranking)
            if (r.effect == stage.about or (i == 0 and not stage.about)) and r.evidence - stage.before > log_odds
        }


def select(
    searcher: Searcher,
    structure_search: StructureSearch | FoldStructureSearch | None,
    judge: Judge,
    noise: Noise,
    start: Sequence[Choice] = (),
) -> Selected:
    """The terms that the records require beside those of `start`, and the remaining structure where `structure_search` is
    given.
    """
    noise = searcher.fit_noise(start, noise)
    searcher.limit_outliers(start, noise)
    found = search(searcher, noise, judge, start)
    stages = list(found.stages)
    chosen, noise = list(found.choices), found.noise
    if len(chosen) > len(start) + 1:
        chosen = drop(searcher, chosen, noise, len(start), policy().strong)
    hits: list[Hit] = []
    shapes: list[Hit] = []
    foreign: dict[str, ForeignStructure] = {}
    swaps = 0
    while structure_search is not None and len(hits) < MOST_STRUCTURES:
        hit = structure_search(searcher.projection(noise, searcher.extra(chosen)), searcher.linear)
        if hit is None:
            if isinstance(structure_search, FoldStructureSearch):
                break
            foreign, chosen, taken = _foreign(searcher, structure_search.catalogue, chosen, noise, len(start))
            if taken is None:
                break
            if isinstance(taken, Stage):
                stages.append(taken)
                chosen.append(taken.ranking[0].choice)
                noise = searcher.fit_noise(chosen, taken.ranking[0].noise)
                chosen = (
                    drop(searcher, chosen, noise, len(start), policy().strong)
                    if len(chosen) > len(start) + 1
                    else chosen
                )
                swaps += 1
                if swaps >= MOST_SWAPS:
                    break
                continue
            hit = taken
        elif _is_shape(searcher, hit, chosen, noise):
            shapes.append(hit)
            searcher.add_nuisance(hit.extra)
            if len(shapes) >= MOST_STRUCTURES:
                break
            continue
        hits.append(hit)
        searcher.add_nuisance(hit.extra)
        chosen = drop(searcher, _not_outgrown(searcher, hit, chosen, noise, len(start)), noise, len(start))
        noise = searcher.fit_noise(chosen, noise)
        found = search(searcher, noise, judge, chosen)
        stages.extend(found.stages)
        chosen, noise = drop(searcher, found.choices, found.noise, len(start)), found.noise
    searcher.limit_outliers(chosen, noise)
    if structure_search is not None and not isinstance(structure_search, FoldStructureSearch):
        stages.extend(_contests(searcher, chosen, noise, stages, len(start)))
    left = None if structure_search is None else memory(searcher, chosen, noise)
    return Selected(searcher, tuple(chosen), noise, tuple(stages), tuple(hits), tuple(shapes), foreign, left)


def drop(
    searcher: Searcher, chosen: Sequence[Choice], noise: Noise, fixed: int = 0, least: float | None = None
) -> list[Choice]:
    """Removes the terms after the first `fixed` that contribute less than `least` (the policy's `decisive`) beside the others, the
    weakest first.
    """
    least = policy().decisive if least is None else least
    current = list(chosen)
    while len(current) > fixed:
        whole, _ = searcher.profiled_evidence(current, noise)
        worth = [
            whole - searcher.profiled_evidence(current[:i] + current[i + 1 :], noise)[0]
            for i in range(fixed, len(current))
        ]
        weakest = int(np.argmin(worth))
        if worth[weakest] >= least:
            break
        del current[fixed + weakest]
    return current


def _foreign(
    searcher: Searcher, catalogue: Catalogue, chosen: Sequence[Choice], noise: Noise, fixed: int
) -> tuple[dict[str, ForeignStructure], list[Choice], Hit | Stage | None]:
    """Tests whether a structure of other columns fits better than some terms: all together, those of one effect, a
    single one.

    Returns the best structure for each effect. Where one fits better: the remaining terms, and the structure, or the
    stage at which an effect as good as the structure is taken.
    """
    odds: dict[str, ForeignStructure] = {}
    worth = searcher.profiled_evidence(chosen, noise)[0]
    for group in _groups(chosen, fixed):
        rest = [choice for i, choice in enumerate(chosen) if i not in group]
        mine, survey = [chosen[i] for i in group], searcher.linear.campaign.survey
        own = {"target_mm", "direction"}.union(*(choice.form.inputs for choice in mine))
        base, calm = searcher.profiled_evidence(rest, noise)
        of_other_columns = np.array(
            [not (set(s.columns) <= own or is_of_a_wander(s.columns, mine, survey)) for s in catalogue.structures],
            dtype=np.bool_,
        )
        if not np.any(of_other_columns):
            continue
        best: ForeignStructure | None = None
        for trial in dict.fromkeys((noise, calm)):
            projection = searcher.projection(trial, searcher.extra(rest))
            gains = np.where(of_other_columns, score(projection, catalogue.stack(projection.whitened)).gain, -np.inf)
            top = int(np.argmax(gains))
            total = searcher.evidence(rest, trial) + float(gains[top])
            if total > worth + policy().decisive / len(group) and total > base + policy().decisive:
                ranking = rank(searcher, rest, noise)
                if ranking and ranking[0].evidence > max(total - policy().decisive, worth):
                    return odds, rest, Stage(base, ranking, True)
                return odds, rest, hit_of(projection, catalogue.structures[top], float(gains[top]), 0.0)
            if best is None or total - worth > best.log_odds:
                best = ForeignStructure(catalogue.structures[top].columns, total - worth, float(gains[top]))
        names = {chosen[i].effect.id for i in group}
        if len(names) == 1 and best is not None:
            (name,) = names
            odds[name] = max(odds.get(name, best), best, key=lambda foreign_structure: foreign_structure.log_odds)
    return odds, list(chosen), None


def is_of_a_wander(columns: Collection[str], choices: Sequence[Choice], survey: Survey) -> bool:
    """Whether a function of some columns is a course of the time, beside a reading that wanders: then it is no other cause.

    Beside other effects it must read the time; a function of temperatures or of the air is one where all of the choices wander.
    """
    wander = [choice.form.shrunk for choice in choices]
    if not any(wander) or not (survey.time_column in columns or all(wander)):
        return False
    return set(columns) <= {survey.time_column, *survey.temperatures, *SENSORS}


def _contests(
    searcher: Searcher, chosen: Sequence[Choice], noise: Noise, stages: Sequence[Stage], fixed: int
) -> Iterator[Stage]:
    """The ranking beside the others for each effect that no stage took as its best."""
    known = {stage.ranking[0].effect for stage in stages if stage.taken}
    for i in range(fixed, len(chosen)):
        if chosen[i].effect.id not in known:
            rest = [*chosen[:i], *chosen[i + 1 :]]
            base, _ = searcher.profiled_evidence(rest, noise)
            yield Stage(base, rank(searcher, rest, noise), True, chosen[i].effect.id)


def _groups(chosen: Sequence[Choice], fixed: int) -> list[tuple[int, ...]]:
    """Terms after the first `fixed` that one structure may replace: all, those of one effect, each."""
    free = range(fixed, len(chosen))
    same = [
        tuple(i for i in free if chosen[i].effect.id == name)
        for name in dict.fromkeys(chosen[i].effect.id for i in free)
    ]
    return [group for group in dict.fromkeys([tuple(free), *same, *((i,) for i in free)]) if group]


def _is_shape(searcher: Searcher, hit: Hit, chosen: Sequence[Choice], noise: Noise) -> bool:
    """Whether the structure is a small misfit of a chosen effect's own form, or the rest of a reading that wanders."""
    columns, survey = set(hit.structure.columns) - {"target_mm", "direction"}, searcher.linear.campaign.survey
    if any(is_of_a_wander(hit.structure.columns, [choice], survey) for choice in chosen):
        return True
    rms = structure_rms(searcher, hit, chosen, noise)
    for choice, size in zip(chosen, _sizes(searcher, chosen, noise), strict=True):
        own = set(choice.form.inputs) - {"target_mm", "direction"}
        if columns <= own | {survey.time_column} and rms < policy().shape * size:
            return True
    return False


def _not_outgrown(searcher: Searcher, hit: Hit, chosen: Sequence[Choice], noise: Noise, fixed: int) -> list[Choice]:
    """Removes the terms after the first `fixed` that are only a part of a structure of the same columns."""
    columns = set(hit.structure.columns) - {"direction"}
    rms = structure_rms(searcher, hit, chosen, noise)
    sizes = _sizes(searcher, chosen, noise)
    return [
        choice
        for i, (choice, size) in enumerate(zip(chosen, sizes, strict=True))
        if i < fixed or not (set(choice.form.inputs) - {"direction"} <= columns and rms > policy().outgrown * size)
    ]


def _sizes(searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> list[float]:
    """RMS of each term over the rows, µm."""
    columns = searcher.linear.campaign.columns
    return [float(np.std(term.error_um(columns))) for term in searcher.fit(chosen, noise, uncertain=False).found]


def structure_rms(searcher: Searcher, hit: Hit, chosen: Sequence[Choice], noise: Noise) -> float:
    """RMS of a structure over the rows beside some choices, µm."""
    projection = searcher.projection(noise, searcher.extra(chosen))
    a, b = projection.normal(hit.structure.whole)
    coefficients = np.linalg.solve(a + np.eye(len(a)) / hit.variance, b)
    return float(np.std(hit.structure.whole @ coefficients))
