"""The complete choice of terms for one campaign: first the effects that vary beside any table, then those that a
declared table lacks.

It is made on all rows, and again with runs left out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection
from hil.diagnosis.noise.noise_fit import fit_noise
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import Candidates, enumerate_candidates, score
from hil.diagnosis.search.fit import Choice, JointFit, Known, Setting, start_noise, static_part
from hil.diagnosis.search.judge import FoldJudge, FoldStructureSearch, Hit, NullJudge, StructureSearch
from hil.diagnosis.search.rank import settled
from hil.diagnosis.search.searcher import FULL, LIGHT, Searcher
from hil.diagnosis.search.select import Selected, select
from hil.diagnosis.search.structure import Catalogue, static_structures, structures
from hil.diagnosis.table import DeclaredShape
from hil.effects import Effect, Form, Survey
from hil.effects.model import Model
from hil.effects.warming import as_far_as_seen, is_bounded

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Problem:
    """A campaign with the settings and candidates of its search.

    free: the setting with a table fitted from the records; candidates, catalogue: for it
    plain: noise model of table and noise alone; visible: largest share of each effect that remains beside the table
    declared: the known model or that in force, with its own setting, candidates and catalogue
    """

    campaign: CampaignRows
    free: Setting
    candidates: Candidates
    catalogue: Catalogue
    plain: Noise
    visible: dict[str, float]
    seed: int
    declared: Model | None = None
    given: Setting | None = None
    static: Candidates | None = None
    static_catalogue: Catalogue | None = None


def problem_of(campaign: CampaignRows, effects: Sequence[Effect], declared: Model | None, seed: int) -> Problem:
    """Computes everything that is needed once per campaign."""
    candidates = enumerate_candidates(campaign, [effect for effect in effects if not effect.is_table])
    catalogue = structures(campaign)
    n = len(campaign)
    linear = LinearCampaign(campaign)
    given = None if declared is None else _as_far_as_these_rows(declared, campaign)
    terms = () if given is None else given.terms
    error = campaign.error_um - sum((term.error_um(campaign.columns) for term in terms), np.zeros(n))
    plain = fit_noise(linear, error, Extra.none(n), start_noise(campaign), correlations=((0.0, 0.0),))
    projection = linear.projection(plain, error)
    share = score(projection, candidates.stack(projection.whitened)).visible
    visible = {effect.id: 0.0 for effect in effects if effect.is_table and effect.forms(campaign.survey)}
    visible |= {name: float(np.max(share[candidates.effect == i])) for i, name in enumerate(candidates.effects)}
    if given is None:
        free = Setting(linear, error, Known.none(n))
        return Problem(campaign, free, candidates, catalogue, plain, visible, seed)
    noise_um = float(np.sqrt(projection.solve(np.zeros((n, 0))).variance))
    lacking_um = campaign.error_um - given.error_um(campaign.columns)
    known = Known.of(given, campaign, noise_um)
    shape = DeclaredShape.of(given.table, noise_um)
    lacking = [e for e in effects if e.static or visible.get(e.id, 0.0) < policy().blind]
    return Problem(
        campaign,
        Setting(linear, error, known),
        candidates,
        catalogue,
        plain,
        visible,
        seed,
        declared,
        Setting(LinearCampaign(campaign, shape), lacking_um, known),
        enumerate_candidates(campaign, lacking),
        static_structures(campaign),
    )


def _as_far_as_these_rows(declared: Model, campaign: CampaignRows) -> Model:
    """A declared model, the temperatures of which count as far as on these rows too, where they are bounded."""
    return declared.with_terms(
        [as_far_as_seen(term, campaign.columns) if is_bounded(term) else term for term in declared.terms]
    )


@dataclass(frozen=True)
class Critical:
    """Gains that are just significant on all rows, used in the folds: of each effect, and of a structure."""

    effects: dict[str, float]
    structure: float


@dataclass(frozen=True)
class Chosen:
    """The result: selections in order (the last one counts), the joint fit, critical gains for the folds."""

    selections: tuple[Selected, ...]
    fit: JointFit
    critical: tuple[Critical, ...] = ()

    @property
    def last(self) -> Selected:
        """The selection that counts."""
        return self.selections[-1]

    @property
    def hits(self) -> tuple[Hit, ...]:
        """The unexplained structures, all of them in the fit of the last selection."""
        return tuple(hit for selected in self.selections for hit in selected.hits)

    @property
    def unclaimed(self) -> tuple[Hit, ...]:
        """The same, and the misfits that no effect in the fit may have: its columns are others, or it was taken away."""
        survey = self.last.searcher.linear.campaign.survey
        shapes = [shape for selected in self.selections for shape in selected.shapes]
        mine = [choice.form for choice in self.kept]
        nobodys = [
            one for one in shapes if not any(may_be_misfit(one.structure.columns, form, survey) for form in mine)
        ]
        return (*self.hits, *nobodys)

    @property
    def kept(self) -> tuple[Choice, ...]:
        """The choices of the last selection whose effects are in the fit."""
        names = {term.effect.id for term in self.fit.found}
        return tuple(choice for choice in self.last.choices if choice.effect.id in names)


def may_be_misfit(columns: Collection[str], form: Form, survey: Survey) -> bool:
    """Whether what is left in some columns may be a misfit of an effect of this form: it reads them, beside direction and time."""
    return set(columns) <= {"direction", survey.time_column, *form.inputs}


def beside_table(chosen: Chosen, course_um: Floats) -> Floats:
    """What is left of a course of the rows (n,), µm, beside the table that is fitted from them."""
    table = chosen.selections[0].searcher.linear.table
    columns = table.stacked[:, : table.table_width]
    return np.asarray(course_um - columns @ np.linalg.lstsq(columns, course_um, rcond=None)[0])


def of_equal_rows(chosen: Chosen) -> Projection:
    """The projection without the choices, every row counted alike: for sizes in µm."""
    searcher, noise = chosen.last.searcher, chosen.last.noise.calm()
    linear = searcher.linear
    if linear.campaign.scale is None:
        return searcher.projection(noise)
    return LinearCampaign(replace(linear.campaign, scale=None), linear.shape).projection(
        noise, searcher.y, searcher.always
    )


def choose(problem: Problem) -> Chosen:
    """The choice on all rows, tested by simulated null campaigns."""
    judge, structure_search = NullJudge(problem.seed), StructureSearch(problem.catalogue, problem.seed)
    first = select(Searcher(problem.free, problem.candidates), structure_search, judge, start_noise(problem.campaign))
    critical = Critical(judge.critical(), structure_search.critical)
    if problem.given is None or problem.static is None or problem.static_catalogue is None:
        return Chosen((first,), first.searcher.fit(first.choices, first.noise), (critical,))
    judge, structure_search = NullJudge(problem.seed), StructureSearch(problem.static_catalogue, problem.seed)
    searcher = _second(problem, problem.given, problem.static, first, None)
    second = select(searcher, structure_search, judge, first.noise, first.choices)
    fit = second.searcher.fit(second.choices, second.noise)
    return Chosen((first, second), fit, (critical, Critical(judge.critical(), structure_search.critical)))


def settle(chosen: Chosen) -> Chosen:
    """The choice with the parameters of all its effects refined together."""
    last = chosen.last
    choices = settled(last.searcher, last.choices, last.noise)
    last.searcher.limit_outliers(choices, last.noise)
    kept = {term.effect.id for term in chosen.fit.found}
    fit = last.searcher.fit([choice for choice in choices if choice.effect.id in kept], last.noise)
    return replace(chosen, selections=(*chosen.selections[:-1], replace(last, choices=tuple(choices))), fit=fit)


def choose_without(problem: Problem, out: Mask, whole: Chosen) -> Chosen:
    """The choice with rows left out, by the critical gains on all rows; the noise fit starts at that of all rows."""
    searcher = Searcher(problem.free, problem.candidates, out, LIGHT)
    noise = whole.selections[0].noise
    first = select(
        searcher, _fold_structure_search(problem.catalogue, whole, 0), FoldJudge(whole.critical[0].effects), noise
    )
    if problem.given is None or problem.static is None or problem.static_catalogue is None:
        return Chosen((first,), first.searcher.fit(first.choices, first.noise, uncertain=False))
    searcher = _second(problem, problem.given, problem.static, first, out)
    structure_search, judge = (
        _fold_structure_search(problem.static_catalogue, whole, 1),
        FoldJudge(whole.critical[1].effects),
    )
    second = select(searcher, structure_search, judge, first.noise, first.choices)
    return Chosen((first, second), second.searcher.fit(second.choices, second.noise, uncertain=False))


def _fold_structure_search(catalogue: Catalogue, whole: Chosen, step: int) -> FoldStructureSearch | None:
    """The search for structure without some rows, where all rows showed any."""
    selected = whole.selections[step]
    return FoldStructureSearch(catalogue, whole.critical[step].structure) if selected.hits or selected.shapes else None


def _second(problem: Problem, given: Setting, static: Candidates, first: Selected, out: Mask | None) -> Searcher:
    """The searcher against the declared table, with the part of the found effects that it may have absorbed."""
    setting = replace(given, static=static_part(problem.free.linear, first.choices, problem.plain))
    searcher = Searcher(setting, static, out, LIGHT if out is not None else FULL)
    searcher.nuisance = first.searcher.nuisance
    return searcher
