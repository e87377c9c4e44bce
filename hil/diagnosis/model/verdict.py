"""The verdict: what was found with its confidence and rivals, and what is left without a cause."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from hil.diagnosis.campaign import CampaignRows, Floats
from hil.diagnosis.model.evidence import Fit, Part
from hil.diagnosis.model.intervals import terms_of
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.remainder import NO_CAUSE
from hil.diagnosis.model.rivals import not_told_apart, separating, to_switch
from hil.diagnosis.model.search import Search
from hil.diagnosis.model.unlogged import UNKNOWN, columns_of, share_of, unlogged
from hil.diagnosis.result import OUTSIDE, Carrier, Finding, RivalFound
from hil.effects import Columns, Estimate, Term

LEAST = 0.02
"""Confidence below which a rival is not named."""
ALIKE = 0.95
"""Rank correlation from which two columns are equivalent as carriers."""
CLOCKS = frozenset({"run", "time_s", "row_order"})
"""Columns that only count: what happens once happens at one of their values."""


class Verdict:
    """What the parts of a model say of the machine.

    recorded: columns that are filled in every row
    """

    def __init__(self, search: Search, fit: Fit, recorded: Collection[str]) -> None:
        self.search, self.fit, self.parts, self.recorded = search, fit, fit.parts, recorded
        self.campaign = search.rows.campaign
        self.terms = terms_of(fit)
        self.groups: dict[str, list[Part]] = {}
        for part in sorted(fit.parts, key=lambda one: -float(np.std(fit.course_um(one)))):
            if not part.is_remainder:
                self.groups.setdefault(part.name, []).append(part)

    def course_um(self, name: str) -> Floats:
        """What an effect contributes to each row, µm, (n,)."""
        return np.asarray(sum(self.terms[part].error_um(self.campaign.columns) for part in self.groups[name]))

    def _beside_table(self, course: Floats) -> Floats:
        """What a table does not hold of it, (n,)."""
        return np.asarray(course - self.search.rows.table.held(course[:, None])[:, 0])

    def findings(self) -> tuple[Finding, ...]:
        """The findings, largest first. Beside a remainder a name is as sure as its share of the power."""
        bare = [self._finding(name) for name in self.groups]
        alike = not_told_apart(bare, self.recorded, self.campaign.columns)
        left_um = max((carrier.rms.value for carrier in self.carriers), default=0.0)
        found = []
        for finding in bare:
            weights = self._weights(finding, alike.get(finding.effect, ()))
            share = finding.rms_um**2 / max(finding.rms_um**2 + left_um**2, 1e-300)
            weights = {name: weight * share for name, weight in weights.items()}
            weights[OUTSIDE] = weights.get(OUTSIDE, 0.0) + 1.0 - share
            found.append(self._beside(finding, weights))
        return tuple(sorted(found, key=lambda one: -one.rms_um))

    def _finding(self, name: str) -> Finding:
        parts = self.groups[name]
        term, *more = (self.terms[part] for part in parts)
        whole = self.course_um(name)
        size = float(np.std(whole))
        if term.effect.static and not self.search.rows.is_declared and more and not term.effect.several:
            size = float(np.std(self._beside_table(whole)))
        std = self._rms_std(parts, whole) if more else _rms_std(term, self.campaign)
        relative = std / max(float(np.std(whole)), 1e-12)
        peak = float(np.max(np.abs(whole - np.mean(whole))))
        return Finding(
            term,
            confidence=1.0,
            rms_um=size,
            rms_std_um=size * relative,
            peak_um=peak,
            more=tuple(more),
            beside_any_table=self.search.catalogue.beside.get(name, 1.0) > USUAL.share,
            follows=() if more else self._follows(parts[0], term),
            vague=not more and _is_vague(term, size, self.campaign),
        )

    def _odds(self, part: Part) -> dict[str, float]:
        """Log evidence of each explanation in the place of a part, by effect."""
        others = [one for one in self.parts if one is not part]
        found = [(part.name, self.search.log_p(self.parts))]
        found += [(one.part.name, one.log_p) for one in self.search.alternatives(others)]
        found += unlogged(self.search.fit(others), self.recorded)
        return dict(sorted(found, key=lambda one: one[1]))

    def _weights(self, finding: Finding, alike: Sequence[str]) -> dict[str, float]:
        """Posterior of each explanation; alike: rivals that make the same rows through a column that was not recorded."""
        odds = self._odds(self.groups[finding.effect][0])
        doubts = [*alike, *finding.term.effect.stands_for(finding.term.form)]
        if finding.is_implausible or self._switched(finding):
            doubts.append(OUTSIDE)
        least = odds[finding.effect] - UNKNOWN
        return share_of(odds | {name: max(odds.get(name, least), least) for name in doubts})

    def _switched(self, finding: Finding) -> str:
        """The recorded column that passes a level where the reading jumps, and nowhere else: a relay of it makes the same rows."""
        course = finding.term.error_um(self.campaign.columns)
        above = course > np.mean([np.min(course), np.max(course)])
        if not finding.term.effect.once or finding.term.form.shrunk or np.ptp(course) == 0.0:
            return ""
        for name in sorted(self.campaign.survey.varying - CLOCKS):
            values = self.campaign.columns[name]
            for one, other in ((values[above], values[~above]), (values[~above], values[above])):
                if np.max(one) < np.min(other):
                    return name
        return ""

    def _beside(self, finding: Finding, weights: Mapping[str, float]) -> Finding:
        effect, relay = finding.term.effect, self._switched(finding)
        of_relay = {OUTSIDE: to_switch(relay)} if relay else {}
        rivals = tuple(
            RivalFound(name, weight, of_relay.get(name) or separating(effect, name, columns_of(name, self.recorded)))
            for name, weight in sorted(weights.items(), key=lambda one: -one[1])
            if name != finding.effect and weight > LEAST
        )
        return replace(finding, confidence=weights[finding.effect], rivals=rivals)

    def _follows(self, part: Part, term: Term) -> tuple[tuple[Term, float], ...]:
        """The effect by each column that it may follow, with its share among them; none where no other has any."""
        others = [one for one in self.parts if one is not part]
        odds, terms = {_first_column(part): self.search.log_p(self.parts)}, {_first_column(part): term}
        for one in self.search.alternatives(others):
            name = _first_column(one.part)
            if one.part.name == part.name and name not in odds:
                odds[name] = one.log_p
                terms[name] = terms_of(Fit(self.search.rows, [*others, one.part], one.noise))[one.part]
        found = [(terms[name], share) for name, share in share_of(odds).items() if share > LEAST]
        return tuple(found) if len(found) > 1 else ()

    @cached_property
    def carriers(self) -> tuple[Carrier, ...]:
        """What carries the remainders, the largest first; those of the same columns are one."""
        left: dict[frozenset[str], list[Part]] = {}
        for part in self.parts:
            if part.is_remainder:
                left.setdefault(frozenset(part.names), []).append(part)
        found = []
        for parts in left.values():
            course = self._beside_table(np.sum([self.fit.course_um(part) for part in parts], axis=0))
            size = float(np.std(course))
            std = self._rms_std(parts, course)
            others = [one for one in self.parts if one not in parts]
            gain = self.search.log_p(self.parts) - self.search.log_p(others)
            names, probability = parts[0].names, float(np.exp(-max(gain, 0.0)))
            found.append(Carrier(names, Estimate(size, std), probability, self._equivalent(names)))
        return tuple(sorted(found, key=lambda one: -one.rms.value))

    def _rms_std(self, parts: Sequence[Part], course: Floats) -> float:
        """Standard uncertainty of the RMS of parts together, µm, their non-linear parameters as they are."""
        every = np.arange(len(self.fit.beta))
        at = np.concatenate([every[self.fit.where(part, kind)] for part in parts for kind in ("random", "free")])
        columns = np.hstack([getattr(part, kind) for part in parts for kind in ("random", "free")])
        return _std_of_rms(columns, course, self.fit.covariance[np.ix_(at, at)])

    def _equivalent(self, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """By column, the others that move with it."""
        may_carry = self.campaign.survey.varying - NO_CAUSE - {"target_mm"}
        others = sorted(may_carry - set(names))
        found = {
            name: tuple(other for other in others if _rank_correlation(self.campaign.columns, name, other) > ALIKE)
            for name in names
            if name in may_carry
        }
        return {name: alike for name, alike in found.items() if alike}


def _first_column(part: Part) -> str:
    """The column that a part follows first; empty where none."""
    return "".join(part.names[:1])


def _rank_correlation(columns: Columns, one: str, other: str) -> float:
    """Spearman's, its absolute value; equal values have their mean rank."""
    ordered = ((columns[name], np.sort(columns[name])) for name in (one, other))
    ranks = np.stack([np.searchsorted(s, v) + np.searchsorted(s, v, "right") for v, s in ordered])
    return abs(float(np.corrcoef(ranks)[0, 1]))


def _rms_std(term: Term, campaign: CampaignRows) -> float:
    """Standard uncertainty of the RMS of a term over the rows, µm."""
    basis = term.effect.basis(term.form, term.theta, campaign.columns)
    covariance = np.array(term.covariance)[: basis.shape[1], : basis.shape[1]]
    return _std_of_rms(basis, basis @ np.array(term.coefficients), covariance)


def _std_of_rms(columns: Floats, course: Floats, covariance: Floats) -> float:
    """Of a course about its mean, made of columns whose coefficients have a covariance, to first order."""
    size = max(float(np.std(course)), 1e-12)
    slope = (columns - np.mean(columns, axis=0)).T @ (course - np.mean(course)) / (len(course) * size)
    return float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))


def _is_vague(term: Term, rms_um: float, campaign: CampaignRows) -> bool:
    """Whether the rows determine the course of an effect and none of its coefficients."""
    basis = term.effect.basis(term.form, term.theta, campaign.columns)
    std = np.sqrt(np.maximum(np.diag(np.array(term.covariance))[: basis.shape[1]], 0.0))
    return bool(np.all(std * np.std(basis, axis=0) > rms_um))
