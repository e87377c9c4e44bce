"""The candidates: every effect of a catalogue on its grids, as columns beside the table, each with its prior.

The evidence of an effect is its mean over the grid, weighted by the prior of its parameters: Occam's factor, and no further rule.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import Floats, Singles
from hil.diagnosis.model.evidence import Candidate, Fit, Part, score
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.remainder import Remainder
from hil.diagnosis.model.rows import ModelRows
from hil.effects import Effect, Form

ROUNDS = 12
"""Steps of a search of an effect's parameters: each to the best neighbour, or to half the distance."""
PLACES = 1001
"""Places on the travel at which an effect is looked at between the rows."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A form of an effect at its grid points: its columns, one a row, (G·k, n), in single precision; absorbed: see `Candidate`."""

    effect: Effect
    form: Form
    thetas: tuple[tuple[float, ...], ...]
    rows: Singles
    absorbed: bool = False

    @property
    def k(self) -> int:
        return len(self.rows) // len(self.thetas)

    @cached_property
    def log_prior(self) -> Floats:
        """Of each point, together 1: even, but for parameters with a usual value, (G,)."""
        own = np.array([self.form.log_prior(theta) for theta in self.thetas])
        return np.asarray(own - np.logaddexp.reduce(own))


@dataclass(frozen=True, eq=False)
class Ranked:
    """A candidate beside a fit: log evidence that it adds over the best fit, its own prior included."""

    gain: float
    candidate: Candidate
    log_prior: float
    fit: Fit

    @property
    def name(self) -> str:
        """Of its effect."""
        return self.candidate.effect.id


class Catalogue:
    """All effects on their grids for one campaign, and the remainder. An effect that is a table is found only beside a declared one.
    There each that is no function of the place is two explanations: it came after the table, or this was measured with some of it.
    """

    def __init__(self, rows: ModelRows, effects: Sequence[Effect]) -> None:
        self.rows, self.campaign = rows, rows.campaign
        self.grids: list[Grid] = []
        self.refining: dict[str, list[Form]] = {}
        self.wandering: list[Candidate] = []
        self.beside: dict[str, float] = {}
        self._varying = {
            effect.mean_of for effect in effects if rows.is_declared and rows.campaign.basis.both_directions
        }
        self.remainder = Remainder(rows.campaign)
        for effect in effects if rows.is_declared else (one for one in effects if not one.is_table):
            for form in effect.forms(self.campaign.survey):
                if form.shrunk:
                    self.wandering.append(Candidate(effect, form, ()))
                elif not form.scan:
                    self.refining.setdefault(effect.id, []).append(form)
                else:
                    self._add(effect, form)

    def _add(self, effect: Effect, form: Form) -> None:
        columns = effect.bases(form, form.starts, self.campaign.columns)
        groups = columns.reshape(len(columns), len(form.starts), -1)
        best = np.max(self.rows.table.beside(columns).reshape(groups.shape[1:]), axis=1)
        if not effect.static or set(form.inputs) <= {"target_mm", "direction"}:
            self.beside[effect.id] = max(self.beside.get(effect.id, 0.0), float(np.max(best)))
        kept = np.ones(len(best), dtype=bool) if not effect.static or self.rows.is_declared else best > USUAL.share
        if not np.any(kept):
            return
        thetas = tuple(tuple(theta) for theta, one in zip(form.starts, kept, strict=True) if one)
        for absorbed in self._ways(effect):
            scanned = (columns - self.rows.table.held(columns)).reshape(groups.shape) if absorbed else groups
            if effect.id in self._varying:
                mean = np.broadcast_to(self.campaign.d[:, None, None], (*scanned.shape[:2], 1))
                scanned = np.concatenate([scanned, mean], axis=2)
            chosen = np.ascontiguousarray(scanned[:, kept].reshape(len(columns), -1).T, dtype=np.float32)
            self.grids.append(Grid(effect, form, thetas, chosen, absorbed))

    def _ways(self, effect: Effect) -> tuple[bool, ...]:
        """Whether a table has absorbed some of an effect: beside a declared one both."""
        return (False, True) if self.rows.is_declared and not effect.static else (False,)

    def prior(self, effect: Effect, form: Form) -> float:
        """Log prior odds of a form; a shape with a mean is two."""
        alike = math.log(len(self._ways(effect)))
        return effect.log_odds + form.log_odds - alike - USUAL.richer * ((not form.scan) + (effect.id in self._varying))

    def part(self, candidate: Candidate, log_prior: float) -> Part:
        effect, form = candidate.effect, candidate.form
        columns = effect.basis(form, candidate.theta, self.campaign.columns)
        none = columns[:, :0]
        if form.shrunk:
            return Part(effect.id, form.inputs, none, columns * math.sqrt(candidate.ratio), none, log_prior, candidate)
        held = self.rows.table.absorbed(columns) if candidate.absorbed else none
        if effect.id in self._varying:  # a declared table lacks the mean too
            held = self.campaign.d[:, None]
        return Part(effect.id, form.inputs, columns, none, held, log_prior, candidate)

    def between_rows(self, one: Candidate, coefficients: Floats) -> float:
        """How large a function of the place is anywhere on the travel, over its largest value on the rows; of others 1."""
        if not set(one.form.inputs) <= {"target_mm", "direction"}:
            return 1.0
        on_rows, x = self.campaign.columns, self.campaign.x
        place = np.tile(np.linspace(np.min(x), np.max(x), PLACES), 2)
        anywhere = {"target_mm": place, "direction": np.repeat([1.0, -1.0], PLACES)}
        most, seen = (
            float(np.max(np.abs(one.effect.basis(one.form, one.theta, columns) @ coefficients)))
            for columns in (anywhere, on_rows)
        )
        return most / max(seen, 1e-12)

    def again(self, parts: Sequence[Part]) -> list[Part]:
        """Parts of other rows beside these: each effect in the likelier of its explanations, one after the other."""
        found = list(parts)
        for i, part in enumerate(parts):
            if part.of is None:
                continue
            ways = [replace(part.of, absorbed=absorbed) for absorbed in self._ways(part.of.effect)]
            trials = [[*found[:i], self.part(way, part.log_prior), *found[i + 1 :]] for way in ways]
            found = max(trials, key=lambda trial: score(self.rows, trial)[0].log_p) if len(trials) > 1 else trials[0]
        return found

    def ranked(self, fits: Sequence[Fit]) -> list[Ranked]:
        """Each form by each column at its best beside fits of the same parts, the best first."""
        top = max(fit.log_p for fit in fits)
        found = [self._best(grid, fits, top) for grid in self.grids]
        found += [self._wandering(one, fits, top) for one in self.wandering]
        return sorted(found, key=lambda one: -one.gain)

    def _wandering(self, one: Candidate, fits: Sequence[Fit], top: float) -> Ranked:
        columns = one.effect.basis(one.form, (), self.campaign.columns)
        prior = one.effect.log_odds + one.form.log_odds
        gain, ratio, fit = max(((*fit.random_gain(columns), fit) for fit in fits), key=lambda g: g[2].log_p + g[0])
        return Ranked(fit.log_p - top + gain + prior, replace(one, ratio=ratio), prior, fit)

    def _best(self, grid: Grid, fits: Sequence[Fit], top: float) -> Ranked:
        gains = {fit: fit.gains(grid.rows, grid.k, grid) for fit in fits}
        mean = {fit: float(np.logaddexp.reduce(gains[fit] + grid.log_prior)) for fit in fits}
        fit = max(fits, key=lambda one: one.log_p + mean[one])
        at = int(np.argmax(gains[fit] + grid.log_prior))
        prior = mean[fit] - float(gains[fit][at]) + self.prior(grid.effect, grid.form)
        one = Candidate(grid.effect, grid.form, grid.thetas[at], absorbed=grid.absorbed)
        return Ranked(fit.log_p - top + float(gains[fit][at]) + prior, one, prior, fit)

    def _instead(self, ranked: Ranked, one: Candidate, log_prior: float) -> Ranked:
        """Another form or other parameters in the place of a ranked candidate."""
        more = ranked.fit.gain(self._columns(one)) - ranked.fit.gain(self._columns(ranked.candidate))
        return Ranked(ranked.gain + more + log_prior - ranked.log_prior, one, log_prior, ranked.fit)

    def refined(self, ranked: Ranked) -> Ranked:
        """With its non-linear parameters where the evidence is highest."""
        one, fit = ranked.candidate, ranked.fit
        if not one.theta or one.form.exhaustive:
            return ranked
        logs = np.array([p.logarithmic for p in one.form.nonlinear])
        lower, upper = (np.array([getattr(p, end) for p in one.form.nonlinear]) for end in ("lower", "upper"))
        start = np.where(logs, np.log(np.maximum(one.theta, 1e-12)), one.theta)

        def at(z: Floats) -> Candidate:
            theta = np.clip(np.where(logs, np.exp(np.minimum(z, 50.0)), z), lower, upper)
            return replace(one, theta=tuple(float(value) for value in theta))

        def value(z: Floats) -> float:
            trial = at(z)
            return fit.gain(self._columns(trial)) + one.form.log_prior(trial.theta)

        best, most, step = start, value(start), _spacing(one.form, start, logs) / 2.0
        for _ in range(ROUNDS):
            trials = [best + way for way in (*np.diag(step), *np.diag(-step))]
            values = [value(z) for z in trials]
            if max(values) > most:
                best, most = trials[int(np.argmax(values))], max(values)
            else:
                step = step / 2.0
        return self._instead(ranked, at(best), ranked.log_prior)

    def _columns(self, one: Candidate) -> Floats:
        columns = one.effect.basis(one.form, one.theta, self.campaign.columns)
        return columns - self.rows.table.held(columns) if one.absorbed else columns

    def richer(self, ranked: Ranked) -> Iterator[Ranked]:
        """The same effect by the same column in its richer forms, at the same parameters or the best of their grid."""
        one, fit = ranked.candidate, ranked.fit
        for form in () if one.form.shrunk else self.refining.get(ranked.name, ()):
            if one.form.inputs[:1] != form.inputs[:1]:
                continue
            thetas = [one.theta] if len(form.nonlinear) == len(one.theta) else list(form.starts)
            trials = [Candidate(one.effect, form, tuple(theta), absorbed=one.absorbed) for theta in thetas]
            best = max(trials, key=lambda trial: fit.gain(self._columns(trial))) if len(trials) > 1 else trials[0]
            prior = ranked.log_prior - self.prior(one.effect, one.form) + self.prior(one.effect, form)
            yield self._instead(ranked, best, prior)


def _spacing(form: Form, z: Floats, logs: NDArray[np.bool_]) -> Floats:
    """Distance of the grid points about these parameters in each, on the scale of their search; of one point a share of its bounds."""
    grid = np.where(logs, np.log(np.maximum(form.starts, 1e-12)), form.starts)
    size = np.maximum(np.ptp(grid, axis=0), 1e-12)
    nearest = grid[np.argmin(np.sum(((grid - z) / size) ** 2, axis=1))]
    found = np.array([0.3 if p.logarithmic else 0.1 * (p.upper - p.lower) for p in form.nonlinear])
    for i in range(len(z)):
        same = np.all(np.isclose(np.delete(grid, i, 1), np.delete(nearest, i)), axis=1)
        gaps = np.abs(grid[same, i] - nearest[i])
        found[i] = np.min(gaps, where=gaps > 1e-9, initial=found[i])
    return found
