"""The ranking of effects, each at its best beside some choices: best grid points, refined, over all noise models, in richer forms.

The refinement is a pattern search over the non-linear parameters of many candidates at once; the linear ones follow (variable
projection), and all trials of a round are one product.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Noise, Projection
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import Blocks, Stack, score
from hil.diagnosis.search.fit import Choice, grid_choices
from hil.diagnosis.search.searcher import ConditionalSearch, Searcher, with_point
from hil.effects import Form, NonLinear

Floats = NDArray[np.float64]


ROUNDS = 6
ALONG = ("target_mm", "direction")
"""Columns of the way itself: what follows them follows no other one as well."""
SWEEPS = 2
"""Times that the parameters of each of several choices are refined beside the others."""
FIRST = 0.6
"""First step, as a share of the grid spacing."""
REFINEMENT = 5.0
"""Log odds that refining a grid point may add: what is farther below the limit is not refined."""
MOST_EXPONENT = 700.0
"""Of it the exponential is still a number, beyond the bounds of every parameter."""
OFFSETS = {1: (-1.0, -0.5, 0.0, 0.5, 1.0), 2: (-0.7, 0.0, 0.7)}
"""Trial offsets in steps, by number of parameters."""


class Trials:
    """Some choices with their columns, scored under several projections."""

    def __init__(self, choices: Sequence[Choice], campaign: CampaignRows) -> None:
        self.choices, self.blocks = choices, Blocks.of_choices(choices, campaign)
        self._stack: Stack | None = None

    def score(self, projection: Projection) -> tuple[Floats, list[Choice]]:
        """Gain of the choices under a projection, shape (c,), and the choices with the variance of the shrunk ones set."""
        if self._stack is None or self._stack.whitened is not projection.whitened:
            self._stack = Stack(projection.whitened, self.blocks)
        scores = score(projection, self._stack)
        return scores.gain, [
            replace(choice, variance=float(v)) if choice.form.shrunk else choice
            for choice, v in zip(self.choices, scores.variance, strict=True)
        ]


def score_choices(projection: Projection, choices: Sequence[Choice]) -> tuple[Floats, list[Choice]]:
    """Gain of some choices under one projection, shape (c,), and the choices with the variance of the shrunk ones
    set.
    """
    return Trials(choices, projection.whitened.campaign).score(projection)


def refine(projection: Projection, choices: Sequence[Choice], rounds: int = ROUNDS) -> list[tuple[Choice, float]]:
    """Each choice with its parameters at a local maximum of the evidence, and its gain there."""
    best = list(choices)
    steps = [[FIRST * step for step in choice.steps] for choice in choices]
    gains = np.full(len(best), -np.inf)
    open_ones = [i for i, step in enumerate(steps) if step]
    for turn in range(rounds):
        trials: list[Choice] = []
        owner: list[int] = []
        for i in range(len(best)) if turn == 0 else open_ones:
            for theta in _around(best[i], steps[i], centre=turn == 0):
                trials.append(replace(best[i], theta=theta))
                owner.append(i)
        if not trials:
            break
        found, trials = score_choices(projection, trials)
        owners = np.array(owner)
        for i in dict.fromkeys(owner):
            mine = np.flatnonzero(owners == i)
            top = mine[int(np.argmax(found[mine]))]
            if not steps[i]:
                best[i], gains[i] = trials[top], found[top]
                continue
            moved = trials[top].theta if found[top] > gains[i] else best[i].theta
            edge = [
                abs(a - b) > 0.99 * s
                for a, b, s in zip(_inward(best[i], moved), _inward(best[i], best[i].theta), steps[i], strict=True)
            ]
            if found[top] > gains[i]:
                best[i], gains[i] = trials[top], found[top]
            steps[i] = [s if at_edge else s * 0.4 for s, at_edge in zip(steps[i], edge, strict=True)]
    return [(choice, float(gain)) for choice, gain in zip(best, gains, strict=True)]


def settled(searcher: Searcher, choices: Sequence[Choice], noise: Noise, *, columns: bool = True) -> list[Choice]:
    """The choices with parameters, and the column with `columns`, of each refined beside all others: those of the first were found
    before the others were. Uncertainties are linearised about these values, and so hold only at the maximum.
    """
    current = list(choices)
    for i in list(range(len(current))) * SWEEPS:
        others = [*current[:i], *current[i + 1 :]]
        if current[i].steps:
            current[i] = refine(searcher.projection(noise, searcher.extra(others)), [current[i]])[0][0]
        if columns:
            current[i] = by_column(searcher, others, current[i], noise)[0].choice
    return current


def judged(searcher: Searcher, choices: Sequence[Choice], noise: Noise) -> float:
    """Best evidence of the choices over the grid of noise models, less what lowers the weight of each."""
    worth, _ = searcher.profiled_evidence(choices, noise)
    for i, choice in enumerate(choices):
        others = ConditionalSearch(searcher, [*choices[:i], *choices[i + 1 :]])
        worth -= _penalty(choice, others, noise) + (0.0 if choice.form.scan else policy().strong)
    return worth


def by_column(searcher: Searcher, others: Sequence[Choice], choice: Choice, noise: Noise) -> list[Ranked]:
    """The effect of a choice beside some others by each of the columns that it may follow, at its best form, best first.

    A machine has several temperatures, and they rise together: which of them an effect follows is a choice of its own.
    """
    conditional = ConditionalSearch(searcher, others)
    projection, base = conditional.projection(noise), conditional.base(noise)
    survey = searcher.linear.campaign.survey
    own = choice.form.inputs[0] if choice.form.inputs else ""
    forms: dict[str, list[Form]] = {}
    for form in choice.effect.forms(survey) if own in survey.varying - {*ALONG, survey.time_column} else ():
        if form.inputs[0] != survey.time_column and not form.shrunk:
            forms.setdefault(form.inputs[0], []).append(form)

    def ranked(one: Choice, gain: float) -> Ranked:
        penalty = _penalty(one, conditional, noise) + (0.0 if one.form.scan else policy().strong)
        return Ranked(one, base + gain - penalty, noise)

    found = {own: ranked(*refine(projection, [choice], 1)[0])}
    if len(forms) > 1:
        grid = [one for same in forms.values() for form in same for one in grid_choices(choice.effect, form)]
        for one, gain in refine(projection, _best_of_each_form(projection, grid)):
            trial = ranked(one, gain)
            name = one.form.inputs[0]
            if name not in found or trial.evidence > found[name].evidence:
                found[name] = trial
    return sorted(found.values(), key=lambda r: -r.evidence)


def _around(choice: Choice, steps: Sequence[float], *, centre: bool) -> list[tuple[float, ...]]:
    """Trial parameters on a small grid around a choice, inside the bounds; with its own where `centre` is set."""
    if not steps:
        return [choice.theta]
    middle = _inward(choice, choice.theta)
    offsets = OFFSETS[min(len(steps), 2)]
    out: list[tuple[float, ...]] = []
    for shift in itertools.product(offsets, repeat=len(steps)):
        if not centre and not any(shift):
            continue
        theta = _moved(choice, middle, [s * step for s, step in zip(shift, steps, strict=True)])
        if theta not in out:
            out.append(theta)
    return out


def moved(choice: Choice, by: Sequence[float]) -> tuple[float, ...]:
    """The parameters of a choice moved on the scale on which they are searched, within their bounds."""
    return _moved(choice, _inward(choice, choice.theta), by)


def _moved(choice: Choice, middle: Sequence[float], by: Sequence[float]) -> tuple[float, ...]:
    return tuple(
        min(max(_outward(p, c + step), p.lower), p.upper)
        for p, c, step in zip(choice.form.nonlinear, middle, by, strict=True)
    )


def _inward(choice: Choice, theta: Sequence[float]) -> list[float]:
    return [math.log(v) if p.logarithmic else v for p, v in zip(choice.form.nonlinear, theta, strict=True)]


def _outward(parameter: NonLinear, value: float) -> float:
    return math.exp(min(value, MOST_EXPONENT)) if parameter.logarithmic else value


SMOOTHER = ((0.4, 1.0), (0.15, 1.0), (0.05, 1.0), (1.0, 0.4), (1.0, 0.15))
"""Shares of the table's roughness (even, odd part) that are tried beside a local feature."""


@dataclass(frozen=True)
class Ranked:
    """A candidate at its best: log evidence of the whole model with it, and its noise model."""

    choice: Choice
    evidence: float
    noise: Noise

    @property
    def effect(self) -> str:
        """Id of the effect."""
        return self.choice.effect.id


def rank(
    searcher: Searcher,
    chosen: Sequence[Choice],
    noise: Noise,
    may_become_significant: Callable[[Ranked], bool] | None = None,
) -> tuple[Ranked, ...]:
    """Every effect at its best beside the chosen ones, best first; empty where no grid point is promising."""
    conditional = ConditionalSearch(searcher, chosen)
    rough = _rough(conditional, noise)
    if not rough or (may_become_significant is not None and not any(may_become_significant(r) for r in rough)):
        return ()
    return _enriched(conditional, _profiled(conditional, _refined(conditional, rough), noise))


def _rough(conditional: ConditionalSearch, noise: Noise) -> list[Ranked]:
    """The best grid point of each form, under the noise as fitted and, where the search is thorough, under white noise."""
    searcher, candidates, effort = conditional.searcher, conditional.searcher.candidates, conditional.searcher.effort
    found: dict[int, Ranked] = {}
    for trial in dict.fromkeys((noise, noise.calm()) if effort.correlations else (noise,)):
        projection = conditional.projection(trial)
        gains = score(projection, candidates.stack(projection.whitened)).gain
        for key, index in enumerate(candidates.forms):
            top = index[int(np.argmax(gains[index]))]
            if candidates.choices[top].effect.id in searcher.excluded:
                continue
            value = conditional.base(trial) + float(gains[top])
            if np.isfinite(value) and (key not in found or value > found[key].evidence):
                found[key] = Ranked(candidates.choices[top], value, trial)
    ordered = sorted(found.values(), key=lambda r: -r.evidence)
    names = list(dict.fromkeys(r.effect for r in ordered))[: effort.contenders]
    best = {name: next(r.evidence for r in ordered if r.effect == name) for name in names}
    return [r for r in ordered if r.effect in best and r.evidence > best[r.effect] - 8.0]


def _refined(conditional: ConditionalSearch, rough: Sequence[Ranked]) -> list[Ranked]:
    out: list[Ranked] = []
    for trial in dict.fromkeys(r.noise for r in rough):
        mine = [r.choice for r in rough if r.noise == trial]
        refined = refine(conditional.projection(trial), mine, conditional.searcher.effort.rounds)
        out.extend(Ranked(choice, conditional.base(trial) + gain, trial) for choice, gain in refined)
    return out


def _profiled(conditional: ConditionalSearch, refined: Sequence[Ranked], noise: Noise) -> list[Ranked]:
    """The evidence of each at its best noise model of the grid; the best form of each effect."""
    best = _best_of(conditional, refined, [with_point(noise, *point) for point in conditional.searcher.effort.grid])
    best = _smoothed(conditional, best)
    first: dict[str, Ranked] = {}
    for r in sorted(best, key=lambda r: -r.evidence):
        first.setdefault(r.effect, r)
    judged = [replace(r, evidence=r.evidence - _penalty(r.choice, conditional, r.noise)) for r in first.values()]
    return sorted(judged, key=lambda r: -r.evidence)


def _smoothed(conditional: ConditionalSearch, ranked: Sequence[Ranked]) -> list[Ranked]:
    """Local features beside smoother tables: the table has bulged at the place of the feature."""
    best = list(ranked)
    linear = conditional.searcher.linear
    survey = linear.campaign.survey
    which = [i for i, r in enumerate(ranked) if r.choice.effect.is_local(r.choice.form, r.choice.theta, survey)]
    if not conditional.searcher.effort.correlations or not linear.rough:
        return best
    for start in dict.fromkeys(ranked[i].noise for i in which):
        mine = [i for i in which if ranked[i].noise == start]
        for i, found in zip(mine, _best_of(conditional, [ranked[i] for i in mine], smoother(start)), strict=True):
            best[i] = found
    return best


def _best_of(conditional: ConditionalSearch, ranked: Sequence[Ranked], noises: Sequence[Noise]) -> list[Ranked]:
    """Each with the noise model of highest evidence, its own or one of some others."""
    best = list(ranked)
    trials = Trials([r.choice for r in ranked], conditional.searcher.linear.campaign)
    for noise in noises:
        gains, choices = trials.score(conditional.projection(noise))
        for i, value in enumerate(conditional.base(noise) + gains):
            if value > best[i].evidence:
                best[i] = Ranked(choices[i], float(value), noise)
    return best


def _penalty(choice: Choice, conditional: ConditionalSearch, noise: Noise) -> float:
    penalty = -choice.effect.log_odds
    if not choice.form.shrunk:
        coefficients = conditional.projection(noise).estimate(choice.columns(conditional.searcher.linear.campaign))
        penalty += policy().very_strong if choice.effect.implausible(choice.as_term(coefficients)) else 0.0
    return penalty


def _enriched(conditional: ConditionalSearch, ranked: Sequence[Ranked]) -> tuple[Ranked, ...]:
    """The first few again with their refining forms; without what is at its bound, where the records want more than the effect is."""
    out: list[Ranked] = []
    effort, refining = conditional.searcher.effort, conditional.searcher.candidates.refining
    tried = 0
    for r in ranked:
        best = None if r.choice.effect.is_exceeded(r.choice.form, r.choice.theta) else r
        if tried < effort.rich and r.evidence > ranked[0].evidence - 60.0:
            tried += best is not None
            more = richer(r.choice, refining[r.effect])
            projection = conditional.projection(r.noise)
            for choice, gain in refine(projection, _best_of_each_form(projection, more), effort.rounds) if more else ():
                value = conditional.base(r.noise) + gain - _penalty(choice, conditional, r.noise) - policy().strong
                exceeded = choice.effect.is_exceeded(choice.form, choice.theta)
                if not exceeded and value > (-math.inf if best is None else best.evidence):
                    best = Ranked(choice, value, r.noise)
        if best is not None:
            out.append(best)
    return tuple(sorted(out, key=lambda r: -r.evidence))


def _best_of_each_form(projection: Projection, choices: Sequence[Choice]) -> list[Choice]:
    forms = [(choice.form.name, choice.form.inputs) for choice in choices]
    if len(set(forms)) == len(forms):
        return list(choices)
    gains, _ = score_choices(projection, choices)
    tops: dict[tuple[str, tuple[str, ...]], int] = {}
    for j, form in enumerate(forms):
        if form not in tops or gains[j] > gains[tops[form]]:
            tops[form] = j
    return [choices[j] for j in tops.values()]


def richer(choice: Choice, forms: Sequence[Form]) -> list[Choice]:
    """The refining forms that read the main column of the choice, at their grid points or at its parameters."""
    out: list[Choice] = []
    for form in forms:
        if not set(choice.form.inputs) & set(form.inputs):
            continue
        if choice.form.inputs and form.inputs[0] != choice.form.inputs[0]:
            continue
        same = tuple(p.name for p in form.nonlinear) == tuple(p.name for p in choice.form.nonlinear)
        if same and form.nonlinear:
            out.append(replace(choice, form=form))
        else:
            out.extend(grid_choices(choice.effect, form))
    return out


def smoother(noise: Noise) -> tuple[Noise, ...]:
    """The same noise beside smoother tables."""
    return tuple(replace(noise, even=noise.even * even, odd=noise.odd * odd) for even, odd in SMOOTHER)
