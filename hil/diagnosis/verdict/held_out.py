"""The value of the models on rows they were not fitted to: every run left out once, the choice repeated without it.

Only the columns of a left-out run enter its prediction. An effect that is more likely than not and better on runs left out, but not
proven, since noise may do as much, is suspected: it is no finding, but the extended model holds it, and a note says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import AllRows
from hil.diagnosis.noise.noise_fit import robust_std
from hil.diagnosis.policy import policy
from hil.diagnosis.result import Finding
from hil.diagnosis.search.choose import Chosen, Problem, choose_without
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.rank import refine
from hil.diagnosis.search.searcher import LIGHT, ConditionalSearch, Searcher
from hil.diagnosis.search.select import Selected
from hil.diagnosis.search.structure_estimate import structure_estimates
from hil.diagnosis.stored import can_be_held_out
from hil.diagnosis.verdict.courses import courses_as_good, within_what_was_seen
from hil.effects import Action

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_FOLDS = 10
"""Most folds; more runs are grouped."""
LEAST_ROWS = 3
"""Fewest rows that count as a few."""


@dataclass(frozen=True)
class HeldOut:
    """Residuals of all rows when they were left out, each shape (n,), µm, and how the rows were left out.

    before: of the declared model; after: with the machine's effects; bare: the same without what the table holds of unexplained
    structure; setup: with the effects of instrument and set-up too
    gain: by effect chosen on all rows, the reduction of squared error in each fold, shape (folds,), µm²: everything
    refitted without the fold, with and without the effect
    structure: the same of unexplained structure, where the choice without the fold finds any
    structure_term_um: prediction of that structure, as a term of a model, for each row, (n,); structure_term_gain: its reduction of
    squared error in each fold
    fold: in which each row was left out, (n,)
    """

    before: Floats
    after: Floats
    bare: Floats
    setup: Floats
    gain: dict[str, Floats]
    structure: Floats
    structure_term_um: Floats
    structure_term_gain: Floats
    fold: NDArray[np.int64]
    how: str

    @property
    def usual_um(self) -> float:
        """RMS of `setup` without the worst fold, µm: an effect of time has no beginning without the first run."""
        squares = [self.setup[self.fold == number] ** 2 for number in np.unique(self.fold)]
        worst = max(range(len(squares)), key=lambda i: float(np.mean(squares[i])))
        return float(np.sqrt(np.mean(np.concatenate([one for i, one in enumerate(squares) if i != worst]))))

    @property
    def is_worse(self) -> bool:
        """Whether the runs left out are worse with what was chosen without each of them than with the table alone, all together: then
        nothing that depends on position and direction alone, and so is there in every run, can be sure. Parts of one run are no runs.
        """
        return self._is_worse(self.setup)

    @property
    def corrects_worse(self) -> bool:
        """Whether they are so with what is corrected: then the table alone corrects better than with what is not sure."""
        return self._is_worse(self.after)

    def _is_worse(self, left_um: Floats) -> bool:
        if not can_be_held_out(self.how):
            return False
        usual = np.abs(self.before) <= policy().far_off * robust_std(self.before)
        with_it, without = (float(np.sum(values[usual] ** 2)) for values in (left_um, self.before))
        return bool(with_it > policy().worse_left_out ** 2 * without)


def folds(run: NDArray[np.int64]) -> tuple[NDArray[np.int64], str]:
    """Fold of each row: its run, or a group of neighbouring runs where there are many; blocks of rows for a single run."""
    runs = int(np.max(run)) + 1
    if runs == 1:
        return (np.arange(len(run)) * min(4, len(run)) // len(run)).astype(np.int64), "leave-one-quarter-out"
    if runs <= MOST_FOLDS:
        return run, "leave-one-run-out"
    return (run * MOST_FOLDS // runs).astype(np.int64), "leave-runs-out in groups"


def held_out(problem: Problem, whole: Chosen, rows: AllRows) -> HeldOut:
    """Leaves out each fold, chooses, fits, predicts.

    whole: the choice with nothing left out, with its critical gains; rows: the rows to predict, those of the problem
    among them
    """
    fold, how = folds(problem.campaign.run)
    fold_of_all = rows.folds(fold)
    y, n = rows.error_um, len(rows)
    before, after, bare, setup, carries = (np.zeros(n) for _ in range(5))
    gain: dict[str, list[float]] = {}
    count = int(np.max(fold)) + 1
    structure, structure_term_gain = np.zeros(count), np.zeros(count)
    for index in range(count):
        out, left = fold == index, fold_of_all == index
        chosen = choose_without(problem, out, whole)
        if problem.declared is not None:
            base = problem.declared
        else:
            plain = Searcher(problem.free, problem.candidates, out, LIGHT)
            noise = plain.fit_noise((), problem.plain)
            plain.limit_outliers((), noise)
            base = plain.fit((), noise, uncertain=False).extended
        last = chosen.last
        courses = courses_as_good(last.searcher, last.noise, chosen.kept)
        fit = within_what_was_seen(chosen.fit, courses, rows.columns, ~left)
        before[left] = y[left] - base.error_um(rows.columns)[left]  # of all rows: a sensor's lag does not begin anew
        # what the cause predicts, not what is corrected: without the bound
        setup[left] = y[left] - chosen.fit.whole.error_um(rows.columns)[left]
        after[left] = y[left] - fit.extended.error_um(rows.columns)[left]
        bare[left] = y[left] - fit.bare.error_um(rows.columns)[left]
        for found in structure_estimates(last.searcher, chosen.hits, last.choices, last.noise):
            carries[left] += found.error_um(rows.columns)[left]
        structure_term_gain[index] = float(np.sum(setup[left] ** 2) - np.sum((setup[left] - carries[left]) ** 2))
        for effect, fall in gains_without(problem, whole.last, out).items():
            gain.setdefault(effect, []).append(fall)
        kept = setup[rows.kept[out]]
        structure[index] = float(np.sum(kept**2) - np.sum((kept - chosen.fit.nuisance_um[out]) ** 2))
    by_effect = {name: np.array(values) for name, values in gain.items()}
    return HeldOut(before, after, bare, setup, by_effect, structure, carries, structure_term_gain, fold_of_all, how)


def gains_without(problem: Problem, selected: Selected, out: Mask) -> dict[str, float]:
    """By effect, its reduction of the squared error of the rows left out, µm², with its parameters refitted on the
    others.

    Beside effects that occur once, which nothing can predict, each run is taken about its own mean. In a campaign of
    few runs an effect is hardly chosen again without one of them; this tests whether it predicts that run.
    """
    campaign = problem.campaign
    whole = selected.searcher
    searcher = Searcher(whole.setting, whole.candidates, out, LIGHT)
    searcher.nuisance = whole.nuisance
    once = any(choice.effect.once for choice in selected.choices)
    run = (campaign.run[out][:, None] == np.unique(campaign.run[out])).astype(np.float64)
    refound = list(selected.choices)
    for i, choice in enumerate(refound):
        conditional = ConditionalSearch(searcher, [*refound[:i], *refound[i + 1 :]])
        refound[i] = refine(conditional.projection(selected.noise), [choice], LIGHT.rounds)[0][0]

    def left(choices: Sequence[Choice]) -> float:
        model = searcher.fit(choices, selected.noise, uncertain=False).whole
        rest = (campaign.error_um - model.error_um(campaign.columns))[out]
        if once:
            rest = rest - run @ np.linalg.lstsq(run, rest, rcond=None)[0]
        return float(np.sum(rest**2))

    everything = left(refound)
    names = dict.fromkeys(choice.effect.id for choice in refound)
    return {name: left([c for c in refound if c.effect.id != name]) - everything for name in names}


def few_of(rows: int) -> int:
    """How many of so many rows noise may have far off together."""
    return max(LEAST_ROWS, math.ceil(policy().few_rows * rows))


def on_few_rows(chosen: Chosen) -> set[str]:
    """Effects that the records require only because of a few rows: without those to which it gives most, nothing is left of it.

    Noise has such rows too, and they agree with one another by chance once in so many campaigns; a finding needs more. An effect that
    is larger there than any outlier of noise is none of them.
    """
    last = chosen.last
    campaign = last.searcher.linear.campaign
    few = few_of(len(campaign))
    beyond_um = policy().far_off * chosen.fit.white_um * math.hypot(1.0, last.noise.ar)
    out = set()
    for name in {choice.effect.id for choice in chosen.kept}:
        mine = [choice for choice in chosen.kept if choice.effect.id == name]
        if mine[0].effect.once or any(choice.form.shrunk for choice in mine):
            continue
        terms = [term for term in chosen.fit.found if term.effect.id == name]
        course = np.sum([term.error_um(campaign.columns) for term in terms], axis=0)
        if float(np.max(np.abs(course - np.median(course)))) > beyond_um:
            continue
        without = np.zeros(len(campaign), dtype=np.bool_)
        without[np.argsort(-np.abs(course - np.median(course)))[:few]] = True
        extra = last.searcher.extra([choice for choice in chosen.kept if choice.effect.id != name])
        projection = last.searcher.linear.projection(last.noise, last.searcher.y, extra, without)
        if projection.gain(np.hstack([choice.columns(campaign) for choice in mine])) <= 0.0:
            out.add(name)
    return out


def improves_held_out(gain: Floats) -> bool:
    """Whether the mean of a gain per fold, shape (folds,), exceeds zero by more than its standard error.

    Of five folds or more it may do so with the best and the worst left out: without the first run, an effect of time has no
    beginning. With all folds counts a load that two runs had.
    """
    trim = int(len(gain) // policy().trimmed)
    inner = np.sort(gain)[trim : len(gain) - trim]
    if len(inner) < 2:
        return bool(np.sum(inner) > 0)
    return any(bool(np.mean(kept) > np.std(kept, ddof=1) / np.sqrt(len(kept))) for kept in (inner, gain))


def is_below_noise(finding: Finding, noise_um: float) -> bool:
    """Whether noise of this standard deviation may have drifted as much; an effect of position and direction alone is
    no drift.
    """
    effect = finding.term.effect
    return not effect.static and finding.confidence < policy().sure_name and finding.rms_um < policy().wander * noise_um


def suspected_note(finding: Finding) -> str:
    """The note in place of a finding."""
    rivals = ", ".join(f"{rival.effect} {rival.confidence:.2f}" for rival in finding.rivals)
    return (
        f"{finding.effect} is suspected ({finding.rms_um:.2g} µm RMS, confidence {finding.confidence:.2f}"
        f"{'; ' + rivals if rivals else ''}): noise that wanders may make as much, so it is no finding and is not corrected; more runs"
        " would tell"
    )


def unproven_choice(problem: Problem, chosen: Chosen) -> Choice | None:
    """The best unproven effect of the machine itself, where nothing else was found and it predicts runs left out."""
    first, last = chosen.selections[0], chosen.last
    if chosen.fit.found or any(selected.hits for selected in chosen.selections) or not first.stages:
        return None
    stage = first.stages[-1]
    for ranked in stage.ranking:
        effect = ranked.choice.effect
        if ranked.evidence - stage.before < policy().positive:
            break
        if effect.static:
            break  # a shape along the travel that is no finding is noise: it is there in every run of the same targets
        if effect.action is not Action.COMPENSATE or effect.once or ranked.choice.form.shrunk:
            continue
        fold, _ = folds(problem.campaign.run)
        trial = replace(last, choices=(ranked.choice,))
        gains = [gains_without(problem, trial, fold == i)[effect.id] for i in range(int(np.max(fold)) + 1)]
        return ranked.choice if improves_held_out(np.array(gains)) else None
    return None
