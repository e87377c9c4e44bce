"""The search: which effects, in which form and with which parameters, the records ask for beside the declared table.

What may go in: forward choice by evidence with all identifiable effects competing after local refinement, exchange, and dropping
what no longer earns its place. Whether a best candidate is more than noise is asked of a `Judge`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.candidates import Candidates, score
from hil.diagnosis.evidence import Extra, Frame, Noise
from hil.diagnosis.fit import Choice, JointFit, Setting, grid_choices, joint_fit
from hil.diagnosis.noise_fit import CORRELATIONS, fit_noise
from hil.diagnosis.refine import refine, score_choices
from hil.effects import Form

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_TERMS = 5
GRID = tuple(
    (ar, rho, offset)
    for ar, rho in ((0.0, 0.0), (0.35, 0.9), (0.6, 0.5), (0.7, 0.9), (1.2, 0.75))
    for offset in (0.0, 0.25, 0.6)
)
"""Noise models over which each candidate is profiled."""
SMOOTHER = ((0.4, 1.0), (0.15, 1.0), (0.05, 1.0), (1.0, 0.4), (1.0, 0.15))
"""Shares of the table's roughness (even, odd part) that may be left once a feature of one place stands beside it."""
MOST_FRAMES = 40
EXCHANGES = 2
CONTENDERS = 8
TAME, TAME_TAIL = 3.2, 1.5
"""Limit of a residual in robust standard deviations, and in 95 % quantiles; the larger holds, so that a real bulge stays."""
RICH_CONTENDERS = 3
RICHER = 3.0
"""Log odds against a richer form of the same effect, beside what its width costs."""
IMPLAUSIBLE = 5.0
"""Log odds against an effect whose parameters no machine has."""


@dataclass(frozen=True)
class Effort:
    """How thoroughly to search: effects refined, rounds of refinement, noise models each is profiled over, richer forms tried.

    correlations: (ar, rho) tried in a fit of the noise; empty where the start is close, for none and that of the start
    """

    contenders: int
    rounds: int
    grid: tuple[tuple[float, float, float], ...]
    rich: int
    correlations: tuple[tuple[float, float], ...] = CORRELATIONS


FULL = Effort(CONTENDERS, 6, GRID, RICH_CONTENDERS)
LIGHT = Effort(3, 3, GRID[:2], 1, ())


@dataclass(frozen=True)
class Ranked:
    """A candidate at its best: log evidence of the whole model with it, its noise model, its gain there."""

    choice: Choice
    evidence: float
    noise: Noise

    @property
    def effect(self) -> str:
        return self.choice.effect.id


@dataclass(frozen=True)
class Stage:
    """One step of the choice: evidence without, the ranking with each effect at its best, whether the best was taken.

    about: the effect whose place is contested, where it came there otherwise than as the best of a stage
    """

    before: float
    ranking: tuple[Ranked, ...]
    taken: bool
    about: str = ""


@dataclass(frozen=True)
class Selection:
    """choices: the terms; noise: refitted with them; stages: how it came about."""

    choices: tuple[Choice, ...]
    noise: Noise
    stages: tuple[Stage, ...]


class Judge(Protocol):
    """Says whether the gains of a stage are more than noise makes."""

    def __call__(self, stage: Stage, searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> bool: ...

    def hopeful(self, effect: str, gain: float) -> bool:
        """Whether an effect of this gain at a grid point may become significant by refinement."""


class Searcher:
    """Candidates against one set of errors, on all rows or with some left out."""

    def __init__(
        self, setting: Setting, candidates: Candidates, out: Mask | None = None, effort: Effort = FULL
    ) -> None:
        self.setting, self.candidates, self.out, self.effort = setting, candidates, out, effort
        self.bench = setting.bench
        self.raw = self.y = setting.error_um
        self.nuisance = Extra.none(len(self.y))
        self._frames: dict[Noise, Frame] = {}
        self.barred: frozenset[str] = frozenset()  # effects that are not searched for the moment

    @property
    def always(self) -> Extra:
        """The columns in every fit: what is declared, and what is of no interest."""
        return self.setting.always.plus(self.nuisance)

    def add_nuisance(self, extra: Extra) -> None:
        self.nuisance = self.nuisance.plus(extra)
        self._frames.clear()

    def restore(self, y: Floats, nuisance: Extra) -> None:
        """Back to errors and columns of no interest that were there before."""
        self.y, self.nuisance = y, nuisance
        self._frames.clear()

    def fit(self, choices: Sequence[Choice], noise: Noise, *, uncertain: bool = True) -> JointFit:
        """Table and terms estimated together, with their covariances where they are wanted."""
        return joint_fit(
            self.setting, noise, self.y, choices, out=self.out, nuisance=self.nuisance, uncertain=uncertain
        )

    def extra(self, choices: Sequence[Choice]) -> Extra:
        """The columns of some choices, and those that are always there."""
        total = self.always
        for choice in choices:
            total = total.plus(choice.extra(self.bench.campaign))
        return total

    def frame(self, noise: Noise, beside: Extra | None = None) -> Frame:
        """With the columns `beside` in the fit, or with those that are always there (made once)."""
        if beside is not None:
            return self.bench.frame(noise, self.y, beside, self.out)
        if noise not in self._frames:
            if len(self._frames) >= MOST_FRAMES:
                self._frames.clear()
            self._frames[noise] = self.bench.frame(noise, self.y, self.always, self.out)
        return self._frames[noise]

    def tame(self, choices: Sequence[Choice], noise: Noise) -> None:
        """Pull in rows far beyond what the fit and the bulk of the rows allow (Huber), for all that follows."""
        frame = self.bench.frame(noise, self.raw, self.extra(choices), self.out)
        residual = frame.solve(np.zeros((len(self.raw), 0))).residual
        kept = residual if self.out is None else residual[~self.out]
        size = np.abs(kept - np.median(kept))
        limit = max(TAME * 1.4826 * float(np.median(size)), TAME_TAIL * float(np.quantile(size, 0.95)))
        excess = residual - np.clip(residual, -limit, limit)
        self.y = self.raw - frame.whitened.colour(excess) if np.any(excess) else self.raw
        self._frames.clear()

    def fit_noise(self, choices: Sequence[Choice], start: Noise) -> Noise:
        grid = self.effort.correlations or tuple(dict.fromkeys(((0.0, 0.0), (start.ar, start.rho))))
        near = not self.effort.correlations
        return fit_noise(self.bench, self.y, self.extra(choices), start, correlations=grid, near=near, out=self.out)

    def evidence(self, choices: Sequence[Choice], noise: Noise) -> float:
        """Log marginal likelihood of table, noise and some choices, up to a constant of the rows."""
        return self._evidence(choices, self.extra(choices), noise)

    def _evidence(self, choices: Sequence[Choice], extra: Extra, noise: Noise) -> float:
        always = self.always
        shrunk = extra.random.shape[1] > always.random.shape[1]
        frame = self.frame(noise, Extra(always.free, extra.random) if shrunk else None)
        known = sum(choice.log_prior for choice in choices)
        return float(frame.log_null) + frame.gain(extra.free[:, always.free.shape[1] :]) + known

    def profiled_evidence(self, choices: Sequence[Choice], noise: Noise) -> tuple[float, Noise]:
        """Best evidence of the choices over the grid of noise models."""
        trials = [noise, *(_with(noise, *point) for point in self.effort.grid)]
        extra = self.extra(choices)
        values = [self._evidence(choices, extra, trial) for trial in trials]
        best = int(np.argmax(values))
        return values[best], trials[best]

    def rank(
        self, chosen: Sequence[Choice], noise: Noise, hopeful: Callable[[Ranked], bool] | None = None
    ) -> tuple[Ranked, ...]:
        """Every effect at its best beside the chosen ones, best first; none where no grid point is hopeful."""
        view = View(self, chosen)
        rough = self._rough(view, noise)
        if not rough or (hopeful is not None and not any(hopeful(r) for r in rough)):
            return ()
        refined = self._refined(view, rough)
        ranked = self._profiled(view, refined, noise)
        return self._enriched(view, ranked)

    def _rough(self, view: View, noise: Noise) -> list[Ranked]:
        """The best grid point of each form, under the noise as fitted and, where the search is thorough, under white noise."""
        found: dict[int, Ranked] = {}
        for trial in dict.fromkeys((noise, noise.calm()) if self.effort.correlations else (noise,)):
            frame = view.frame(trial)
            gains = score(frame, self.candidates.stack(frame.whitened)).gain
            for key, index in enumerate(self.candidates.forms):
                top = index[int(np.argmax(gains[index]))]
                if self.candidates.choices[top].effect.id in self.barred:
                    continue
                value = view.base(trial) + float(gains[top])
                if np.isfinite(value) and (key not in found or value > found[key].evidence):
                    found[key] = Ranked(self.candidates.choices[top], value, trial)
        ordered = sorted(found.values(), key=lambda r: -r.evidence)
        names = list(dict.fromkeys(r.effect for r in ordered))[: self.effort.contenders]
        best = {name: next(r.evidence for r in ordered if r.effect == name) for name in names}
        return [r for r in ordered if r.effect in best and r.evidence > best[r.effect] - 8.0]

    def _refined(self, view: View, rough: Sequence[Ranked]) -> list[Ranked]:
        out: list[Ranked] = []
        for trial in dict.fromkeys(r.noise for r in rough):
            mine = [r.choice for r in rough if r.noise == trial]
            refined = refine(view.frame(trial), mine, self.effort.rounds)
            out.extend(Ranked(choice, view.base(trial) + gain, trial) for choice, gain in refined)
        return out

    def _profiled(self, view: View, refined: Sequence[Ranked], noise: Noise) -> list[Ranked]:
        """The evidence of each at its best noise model of the grid; the best form of each effect."""
        best = list(refined)
        for point in self.effort.grid:
            trial = _with(noise, *point)
            gains, choices = score_choices(view.frame(trial), [r.choice for r in refined])
            for i, value in enumerate(view.base(trial) + gains):
                if value > best[i].evidence:
                    best[i] = Ranked(choices[i], float(value), trial)
        best = self._smoothed(view, best)
        first: dict[str, Ranked] = {}
        for r in sorted(best, key=lambda r: -r.evidence):
            first.setdefault(r.effect, r)
        judged = [replace(r, evidence=r.evidence - self._penalty(r.choice, view, r.noise)) for r in first.values()]
        return sorted(judged, key=lambda r: -r.evidence)

    def _smoothed(self, view: View, ranked: Sequence[Ranked]) -> list[Ranked]:
        """Features of one place beside a table that needs to be less rough everywhere: it bulged where they stand."""
        best = list(ranked)
        survey = self.bench.campaign.survey
        which = [i for i, r in enumerate(ranked) if r.choice.effect.is_local(r.choice.form, r.choice.theta, survey)]
        if not self.effort.correlations or not self.bench.rough:
            return best
        for start in dict.fromkeys(ranked[i].noise for i in which):
            mine = [i for i in which if ranked[i].noise == start]
            for trial in smoother(start):
                gains, choices = score_choices(view.frame(trial), [ranked[i].choice for i in mine])
                for i, choice, value in zip(mine, choices, view.base(trial) + gains, strict=True):
                    if value > best[i].evidence:
                        best[i] = Ranked(choice, float(value), trial)
        return best

    def _penalty(self, choice: Choice, view: View, noise: Noise) -> float:
        penalty = -choice.effect.log_odds
        if not choice.form.shrunk:
            coefficients = view.frame(noise).estimate(choice.columns(self.bench.campaign))
            penalty += IMPLAUSIBLE if choice.effect.implausible(choice.as_term(coefficients)) else 0.0
        return penalty

    def _enriched(self, view: View, ranked: Sequence[Ranked]) -> tuple[Ranked, ...]:
        """The first few again with their refining forms."""
        out = list(ranked)
        for i, r in enumerate(ranked[: self.effort.rich]):
            richer = self.richer(r.choice) if r.evidence > ranked[0].evidence - 60.0 else []
            if not richer:
                continue
            frame = view.frame(r.noise)
            gains, _ = score_choices(frame, richer)
            tops: dict[tuple[str, tuple[str, ...]], int] = {}
            for j, choice in enumerate(richer):
                key = (choice.form.name, choice.form.inputs)
                if key not in tops or gains[j] > gains[tops[key]]:
                    tops[key] = j
            for choice, gain in refine(frame, [richer[j] for j in tops.values()], self.effort.rounds):
                value = view.base(r.noise) + gain - self._penalty(choice, view, r.noise) - RICHER
                if value > out[i].evidence:
                    out[i] = Ranked(choice, value, r.noise)
        return tuple(sorted(out, key=lambda r: -r.evidence))

    def richer(self, choice: Choice) -> list[Choice]:
        """The refining forms of an effect that read the main column of the choice, at their grid points or at its parameters."""
        forms: Sequence[Form] = choice.effect.forms(self.bench.campaign.survey)
        out: list[Choice] = []
        for form in forms:
            if form.scan or not set(choice.form.inputs) & set(form.inputs):
                continue
            if choice.form.inputs and form.inputs[0] != choice.form.inputs[0]:
                continue
            same = tuple(p.name for p in form.nonlinear) == tuple(p.name for p in choice.form.nonlinear)
            if same and form.nonlinear:
                out.append(replace(choice, form=form))
            else:
                out.extend(grid_choices(choice.effect, form))
        return out


class View:
    """A searcher beside some choices: frames and base evidences, each made once."""

    def __init__(self, searcher: Searcher, chosen: Sequence[Choice]) -> None:
        self.searcher, self.chosen = searcher, chosen
        self._extra = searcher.extra(chosen)
        self._frames: dict[Noise, Frame] = {}
        self._base: dict[Noise, float] = {}

    def frame(self, noise: Noise) -> Frame:
        if noise not in self._frames:
            self._frames[noise] = self.searcher.frame(noise, self._extra)
        return self._frames[noise]

    def base(self, noise: Noise) -> float:
        """Log evidence of the choices, under a noise model."""
        if noise not in self._base:
            if self.chosen:
                self._base[noise] = self.searcher.evidence(self.chosen, noise)
            else:
                self._base[noise] = float(self.frame(noise).log_null)
        return self._base[noise]


def _with(noise: Noise, ar: float, rho: float, offset: float) -> Noise:
    return replace(noise, ar=ar, rho=rho, offset=offset)


def smoother(noise: Noise) -> tuple[Noise, ...]:
    """The same noise beside tables that are less rough."""
    return tuple(replace(noise, even=noise.even * even, odd=noise.odd * odd) for even, odd in SMOOTHER)


def is_noise(searcher: Searcher, choice: Choice, noise: Noise) -> bool:
    """Whether an effect that noise resembles is too small to be told from it."""
    least = choice.effect.least_over_noise
    if least == 0.0:
        return False
    fit = searcher.fit([choice], noise, uncertain=False)
    rms = float(np.std(fit.found[0].error_um(searcher.bench.campaign.columns)))
    return rms < least * fit.white_um * math.hypot(1.0, noise.ar)


def search(searcher: Searcher, noise: Noise, judge: Judge, start: Sequence[Choice] = ()) -> Selection:
    """Forward choice with exchange, from some choices and the noise model with them.

    What is flexible enough to stand for several causes at once (a wander in time) is taken only where no several causes do better.
    """
    found = _forward(searcher, noise, judge, start)
    flexible = {choice.effect.id for choice in found.choices[len(start) :] if choice.form.shrunk}
    if not flexible or not searcher.effort.correlations:
        return found
    kept = searcher.y, searcher.nuisance
    searcher.barred = frozenset(flexible)
    other = _forward(searcher, noise, judge, start)
    searcher.barred = frozenset()
    several = len(other.choices) > len(found.choices)
    worth, _ = searcher.profiled_evidence(found.choices, found.noise)
    if several and searcher.profiled_evidence(other.choices, other.noise)[0] > worth:
        more = _forward(searcher, other.noise, judge, other.choices)
        return replace(more, stages=(*other.stages, *more.stages))
    searcher.restore(*kept)
    return found


def _forward(searcher: Searcher, noise: Noise, judge: Judge, start: Sequence[Choice]) -> Selection:
    chosen: list[Choice] = list(start)
    stages: list[Stage] = []
    while len(chosen) < MOST_TERMS + len(start):
        searcher.tame(chosen, noise)
        before, _ = searcher.profiled_evidence(chosen, noise)
        ranking = searcher.rank(chosen, noise, partial(_hopeful, judge, before))
        stage = Stage(before, ranking, False)
        if not ranking or not judge(stage, searcher, chosen, noise):
            stages.append(stage)
            break
        top = ranking[0]
        if is_noise(searcher, top.choice, top.noise):
            searcher.add_nuisance(top.choice.extra(searcher.bench.campaign))
            continue
        stages.append(replace(stage, taken=True))
        chosen.append(top.choice)
        noise = searcher.fit_noise(chosen, top.noise)
        chosen = exchange(searcher, chosen, noise, len(start))
    return Selection(tuple(chosen), noise, tuple(stages))


def _hopeful(judge: Judge, before: float, ranked: Ranked) -> bool:
    return judge.hopeful(ranked.effect, ranked.evidence - before)


def exchange(searcher: Searcher, chosen: Sequence[Choice], noise: Noise, fixed: int = 0) -> list[Choice]:
    """Each choice after the first `fixed` may give way to one that is better now that the others are there, until none does."""
    current = list(chosen)
    settled = len(current) - 1  # the last one was just found the best beside the others
    for i in itertools.islice(itertools.cycle(range(fixed, len(current))), EXCHANGES * (len(current) - fixed)):
        if i == settled:
            break
        rest = current[:i] + current[i + 1 :]
        now = searcher.evidence(current, noise)
        ranking = searcher.rank(rest, noise)
        if ranking and ranking[0].evidence > now + 2.0:
            current[i] = ranking[0].choice
            settled = i
    return current
