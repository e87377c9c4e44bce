"""The search: which effects, in which form and with which parameters, the records require beside the declared table.

Forward selection by evidence with all identifiable effects competing, and exchange. A `Judge` decides whether a best
candidate is significant.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.pairs import best_pairs
from hil.diagnosis.search.rank import REFINEMENT, Ranked, judged, rank, settled
from hil.diagnosis.search.searcher import Searcher

MOST_TERMS = 5
"""Most terms that one search adds."""
EXCHANGES = 2


@dataclass(frozen=True)
class Stage:
    """One step of the selection: evidence without, the ranking with each effect at its best, whether the best was
    taken.

    about: the effect that the ranking is for, where it was not taken as the best of a stage
    """

    before: float
    ranking: tuple[Ranked, ...]
    taken: bool
    about: str = ""


@dataclass(frozen=True)
class Selection:
    """choices: the terms; noise: refitted with them; stages: the steps that led to them."""

    choices: tuple[Choice, ...]
    noise: Noise
    stages: tuple[Stage, ...]


class Judge(Protocol):
    """Decides whether the gain of a stage is significant."""

    def __call__(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> bool: ...

    def may_become_significant(self, effect: str, gain: float) -> bool:
        """Whether an effect of this gain at a grid point may become significant by refinement."""


def is_noise(searcher: Searcher, chosen: Sequence[Choice], choice: Choice, noise: Noise) -> bool:
    """Whether an effect that resembles noise is, beside those chosen, too small to be distinguished from it."""
    least = choice.effect.least_over_noise
    if least == 0.0:
        return False
    fit = searcher.fit([*chosen, choice], noise, uncertain=False)
    rms = float(np.std(fit.found[-1].error_um(searcher.linear.campaign.columns)))
    return rms < least * fit.white_um * math.hypot(1.0, noise.ar)


def search(searcher: Searcher, noise: Noise, judge: Judge, start: Sequence[Choice] = ()) -> Selection:
    """Forward selection with exchange, from some choices and the noise model with them; then pairs of effects compete."""
    found = _stepwise(searcher, noise, judge, start)
    return with_pair(searcher, found, len(start)) if searcher.effort.correlations else found


def _stepwise(searcher: Searcher, noise: Noise, judge: Judge, start: Sequence[Choice]) -> Selection:
    """Forward selection with exchange.

    An effect flexible enough to represent several causes at once (a drift in time) is taken only where several effects
    do not fit better.
    """
    found = _forward(searcher, noise, judge, start)
    flexible = {choice.effect.id for choice in found.choices[len(start) :] if choice.form.shrunk}
    if not flexible or not searcher.effort.correlations:
        return found
    kept = searcher.y, searcher.nuisance
    searcher.excluded = frozenset(flexible)
    other = _forward(searcher, noise, judge, start)
    searcher.excluded = frozenset()
    # several terms of one effect are not several effects, unless a machine has that effect more than once
    several = len(set(map(_cause, other.choices))) > len(set(map(_cause, found.choices)))
    worth, _ = searcher.profiled_evidence(found.choices, found.noise)
    least = worth + policy().strong * (len(other.choices) - len(found.choices))
    if several and searcher.profiled_evidence(other.choices, other.noise)[0] > least:
        more = _forward(searcher, other.noise, judge, other.choices)
        return replace(more, stages=(*other.stages, *more.stages))
    searcher.restore(*kept)
    return found


def with_pair(searcher: Searcher, found: Selection, fixed: int = 0) -> Selection:
    """The selection with the best pair of effects in place of those found that vary, where that fits better.

    Step by step two causes are missed that show only together: noise with memory takes up either while the other is not in the fit,
    or one effect about a wrong place, by a wrong sensor, stands for both. Beside more than two effects only the slow ones are
    replaced. fixed: choices at the beginning that are not replaced
    """
    varying = [choice for choice in found.choices[fixed:] if not choice.effect.static]
    mine = varying if len(varying) <= 2 else [choice for choice in varying if choice.effect.slow]
    rest = [choice for choice in found.choices if choice not in mine]
    if (varying and not mine) or len(rest) + 2 > fixed + MOST_TERMS:
        return found
    worth = judged(searcher, found.choices, found.noise)
    effects = {choice.effect.id for choice in mine}
    least = worth + (policy().unsimulated, policy().decisive, policy().positive)[min(len(effects), 2)]
    best: tuple[float, list[Choice]] | None = None
    for pair in best_pairs(searcher, rest, found.noise, least - REFINEMENT):
        trial = settled(searcher, [*rest, *pair], found.noise, columns=False)
        if _is_implausible(
            searcher, trial, found.noise
        ):  # an expansion about a point far away is an offset that cancels the other
            continue
        value = judged(searcher, trial, found.noise)
        if value > least and (best is None or value > best[0]):
            best = value, trial
    if best is None:
        return found
    choices = best[1]
    noise = searcher.fit_noise(choices, found.noise)
    contests = []
    for i in range(len(rest), len(choices)):
        others = [*choices[:i], *choices[i + 1 :]]
        before, _ = searcher.profiled_evidence(others, noise)
        contests.append(Stage(before, rank(searcher, others, noise), True, choices[i].effect.id))
    return Selection(tuple(choices), noise, (*contests, *found.stages))


def _is_implausible(searcher: Searcher, choices: Sequence[Choice], noise: Noise) -> bool:
    fit = searcher.fit(choices, noise, uncertain=False)
    return any(term.effect.slow and term.effect.implausible(term) for term in fit.found)


def _cause(choice: Choice) -> tuple[object, ...]:
    return (choice.effect.id, choice.theta if choice.effect.several else ())


def _forward(searcher: Searcher, noise: Noise, judge: Judge, start: Sequence[Choice]) -> Selection:
    chosen: list[Choice] = list(start)
    stages: list[Stage] = []
    while len(chosen) < MOST_TERMS + len(start):
        searcher.limit_outliers(chosen, noise)
        before, _ = searcher.profiled_evidence(chosen, noise)
        ranking = rank(searcher, chosen, noise, partial(_may_become_significant, judge, before))
        stage = Stage(before, ranking, False)
        if not ranking or not judge(stage, searcher, chosen, noise):
            stages.append(stage)
            break
        top = ranking[0]
        if is_noise(searcher, chosen, top.choice, top.noise):
            searcher.add_nuisance(top.choice.extra(searcher.linear.campaign))
            continue
        stages.append(replace(stage, taken=True))
        chosen.append(top.choice)
        noise = searcher.fit_noise(chosen, top.noise)
        chosen = exchange(searcher, chosen, noise, len(start))
    return Selection(tuple(chosen), noise, tuple(stages))


def _may_become_significant(judge: Judge, before: float, ranked: Ranked) -> bool:
    return judge.may_become_significant(ranked.effect, ranked.evidence - before)


def exchange(searcher: Searcher, chosen: Sequence[Choice], noise: Noise, fixed: int = 0) -> list[Choice]:
    """Replaces choices after the first `fixed` by better ones, given the others, until none improves."""
    current = list(chosen)
    settled = len(current) - 1  # the last one was just found the best beside the others
    for i in itertools.islice(itertools.cycle(range(fixed, len(current))), EXCHANGES * (len(current) - fixed)):
        if i == settled:
            break
        rest = current[:i] + current[i + 1 :]
        now = searcher.evidence(current, noise)
        ranking = rank(searcher, rest, noise)
        if ranking and ranking[0].evidence > now + policy().positive:
            current[i] = ranking[0].choice
            settled = i
    return current
