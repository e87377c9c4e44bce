"""The search: parts are added while the evidence grows, each must stay worth it beside the others, and any may be exchanged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.model.candidates import Catalogue, Ranked
from hil.diagnosis.model.evidence import Fit, Noise, Part, Scored, score
from hil.diagnosis.model.intervals import as_term
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.rows import ModelRows

MOST_PARTS = 6
LEAST_RISE = 0.1
"""Log odds by which a change of the parts must raise what they are worth: so the changes end."""
FEWEST_RUNS = 3
"""Runs from which a function of the place must show in more than one of them."""
NEAR = 8.0
"""Log odds on the grids, below the best there, down to which an effect is followed before others."""
REFINED, FOLLOWED = (8, 3), (6, 2)
"""Most candidates whose parameters are refined, and most whose evidence is computed, and how many of them of one effect."""


@dataclass(frozen=True)
class Alternative:
    """The evidence of some parts with a further one, and the noise model there."""

    log_p: float
    part: Part
    noise: Noise


class Search:
    """One campaign's candidates, with what was tried; kept: parts that stay."""

    def __init__(self, rows: ModelRows, catalogue: Catalogue, kept: Sequence[Part] = ()) -> None:
        self.rows, self.catalogue = rows, catalogue
        self.kept = frozenset(kept)
        self._tried: dict[tuple[str, frozenset[Part]], list[Alternative]] = {}
        self._scored: dict[frozenset[Part], list[Scored]] = {}

    def scored(self, parts: Sequence[Part]) -> list[Scored]:
        """As `score`, made once."""
        key = frozenset(parts)
        if key not in self._scored:
            self._scored[key] = score(self.rows, parts)
        return self._scored[key]

    def log_p(self, parts: Sequence[Part]) -> float:
        """Log evidence of the parts, under their likeliest noise model."""
        return self.scored(parts)[0].log_p

    def fit(self, parts: Sequence[Part]) -> Fit:
        """Under their likeliest noise model."""
        return Fit(self.rows, parts, self.scored(parts)[0].noise)

    def _fits(self, parts: Sequence[Part]) -> list[Fit]:
        """Under their likeliest noise model, and usual offsets."""
        fits = [self.fit(parts)]
        if fits[0].noise.has_large_offsets:
            fits.append(Fit(self.rows, parts, fits[0].noise.with_usual_offsets()))
        return fits

    def alternatives(self, parts: Sequence[Part], *, remainder: bool = True) -> list[Alternative]:
        """What may be added to the parts, the likeliest first."""
        found: list[Alternative] = []
        for of in (self._effects, self._remainders) if remainder else (self._effects,):
            key = of.__name__, frozenset(parts)
            if key not in self._tried:
                self._tried[key] = [self.with_part(parts, part, near) for part, near in of(parts)]
            found += self._tried[key]
        return sorted(found, key=lambda one: -one.log_p)

    def _remainders(self, parts: Sequence[Part]) -> list[tuple[Part, Noise]]:
        """The two likeliest."""
        fit = self.fit(parts)
        return [(part, fit.noise) for part in self.catalogue.remainder.best(fit)]

    def _effects(self, parts: Sequence[Part]) -> list[tuple[Part, Noise]]:
        """The likeliest effects, each in its likeliest forms."""
        catalogue = self.catalogue
        ranked = _first(catalogue.ranked(self._fits(parts)), *REFINED)
        near = {one.name for one in ranked if one.gain > ranked[0].gain - NEAR}
        found = [catalogue.refined(one) for one in ranked]
        rich = [other for one in found for other in catalogue.richer(one)]
        best = _first(sorted([*found, *rich], key=lambda one: (one.name not in near, -one.gain)), *FOLLOWED)
        best = [catalogue.refined(one) if one in rich else one for one in best]
        return [(catalogue.part(one.candidate, one.log_prior), one.fit.noise) for one in best]

    def with_part(self, parts: Sequence[Part], part: Part, near: Noise) -> Alternative:
        """The evidence with a further part: less likely as a second term of an effect, and with physics out of its range."""
        if not part.is_remainder and any(one.name == part.name for one in parts):
            part = replace(part, log_prior=part.log_prior - USUAL.richer)
        found = score(self.rows, [*parts, part], near)[0]
        against = self._against(parts, part, found.noise)
        part = replace(part, log_prior=part.log_prior - against)
        found = replace(found, log_p=found.log_p - against)
        return Alternative(found.log_p, part, found.noise)

    def _against(self, parts: Sequence[Part], part: Part, noise: Noise) -> float:
        """Log odds against an effect with physics out of its range, or with which one is far larger than all errors, or larger between
        the rows than on them.
        """
        one = part.of
        if one is None or one.form.shrunk:
            return 0.0
        if one.effect.is_exceeded(one.form, one.theta):
            return 2.0 * USUAL.richer
        fit = Fit(self.rows, [*parts, part], noise)
        effects = [fit.course_um(one) for one in fit.parts if not one.is_remainder]
        if max(float(np.std(course)) for course in effects) > USUAL.largest * float(
            np.std(self.rows.campaign.error_um)
        ):
            return math.inf
        coefficients, at = fit.coefficients(part), fit.where(part, "free")
        if self.catalogue.between_rows(one, coefficients) > USUAL.largest:
            return math.inf
        term = as_term(one, coefficients, np.pad(fit.covariance[at, at], (0, len(one.theta))))
        return 2.0 * USUAL.richer if one.effect.implausible(term) else 0.0

    def rests_on_few(self, parts: Sequence[Part], one: Alternative) -> bool:
        """Whether nothing is left of a part without the few rows to which it gives most, where it is no larger than the noise's
        outliers are; or, of what is a function of the place, without the run to which it gives most.
        """
        part = one.part
        if part.of is not None and (part.of.effect.once or not part.free.shape[1]):
            return False
        fit = Fit(self.rows, [*parts, part], one.noise)
        course = fit.course_um(part)
        away = np.abs(course - np.median(course))
        if part.of is not None and part.of.effect.static and self.rows.campaign.runs >= FEWEST_RUNS:
            run = self.rows.campaign.run
            if self._is_nothing_without(run == np.argmax(np.bincount(run, away**2)), parts, one):
                return True
        if float(np.max(away)) > USUAL.outlier * fit.sigma:
            return False
        most = np.zeros(len(course), dtype=np.bool_)
        most[np.argsort(-away)[: max(3, math.ceil(USUAL.few * len(course)))]] = True
        return self._is_nothing_without(most, parts, one)

    def _is_nothing_without(self, out: NDArray[np.bool_], parts: Sequence[Part], one: Alternative) -> bool:
        beside = Fit(self.rows.without(out), parts, one.noise)
        part = one.part
        gain = beside.random_gain(part.random)[0] if part.is_remainder else beside.gain(part.free)
        return gain + part.log_prior <= 0.0

    def run(self, parts: Sequence[Part] = ()) -> Fit:
        """The parts that are found from some on, until nothing is worth adding."""
        current = self.exchanged(parts)
        for _ in range(MOST_PARTS):
            worth = self.log_p(current) + USUAL.named
            trials = self.alternatives(current, remainder=False)
            if not any(one.log_p >= worth for one in trials):
                trials = self.alternatives(current)
            good = (one for one in trials if one.log_p >= worth and not self.rests_on_few(current, one))
            best = next(good, None)
            if best is None:
                break
            current = self.exchanged([*current, best.part])
        return self.fit(current)

    def exchanged(self, parts: Sequence[Part]) -> tuple[Part, ...]:
        """The parts without those that are not worth it beside the others, and with others in the place of some, until no such change
        is worth it.
        """
        current = self._needed(tuple(parts))
        while True:
            changes = (self._other(current, part) for part in current if part not in self.kept)
            changed = next((one for one in changes if one is not None), None)
            if changed is None:
                return current
            current = self._needed(changed)

    def _rises(self, parts: Sequence[Part], before: Sequence[Part]) -> bool:
        """Whether other parts are worth more: log evidence, of which each part costs what it must be worth."""
        cost = USUAL.named * (len(parts) - len(before))
        return self.log_p(parts) - cost > self.log_p(before) + LEAST_RISE

    def _needed(self, parts: tuple[Part, ...]) -> tuple[Part, ...]:
        """The parts without those that are not worth it beside the others."""
        for part in parts:
            others = _without(parts, part)
            if part not in self.kept and self._rises(others, parts):
                return self._needed(others)
        return parts

    def _other(self, parts: tuple[Part, ...], part: Part) -> tuple[Part, ...] | None:
        """The parts with others in the place of one, where that is worth more."""
        others = _without(parts, part)
        together = self._effects_instead(others, part) if _is_flexible(part) else None
        if together is not None:
            return together
        for best in self.alternatives(others)[:2]:
            trial = (*others, best.part)
            if best.log_p <= self.log_p(parts) or self.rests_on_few(others, best):
                continue
            if self._rises(trial, parts):
                return trial
        return None

    def _effects_instead(self, others: tuple[Part, ...], part: Part) -> tuple[Part, ...] | None:
        """Effects in the place of a flexible part that holds several, where they are worth more than this.

        Each may show beside it, or beside a course of time, and not alone. The next effect gains less than the last one: where that
        gained less than is missing, no two do.
        """
        parts = (*others, part)
        current = others if part.is_remainder else parts
        for _ in range(3):
            best = next(iter(self.alternatives(current, remainder=False)), None)
            if best is None or self.log_p(parts) - best.log_p > best.log_p - self.log_p(current):
                return None
            current = (*current, best.part)
            for trial in (current, tuple(one for one in current if one in others or not _is_flexible(one))):
                if part not in trial and self.log_p(trial) > self.log_p(parts):
                    needed = self._needed(trial)
                    if self._rises(needed, parts):
                        return needed
        return None


def _without(parts: tuple[Part, ...], part: Part) -> tuple[Part, ...]:
    return tuple(one for one in parts if one is not part)


def _first(ranked: Sequence[Ranked], most: int, of_one: int) -> list[Ranked]:
    """Of candidates, the best first, so many, and so many of one effect."""
    found: list[Ranked] = []
    for one in ranked:
        mine = sum(other.name == one.name for other in found)
        if mine < of_one and len(found) < most:
            found.append(one)
    return found


def _is_flexible(part: Part) -> bool:
    """Whether a part follows any course: a remainder, or a reading that wanders."""
    return part.is_remainder or (part.of is not None and part.of.form.shrunk)
