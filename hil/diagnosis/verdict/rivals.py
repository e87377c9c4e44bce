"""The rivals of each finding: causes that fit as well, causes whose columns nobody recorded, and what is left unexplained."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Noise, random_gain, run_columns
from hil.diagnosis.policy import policy
from hil.diagnosis.result import OUTSIDE, Carrier, Finding, RivalFound
from hil.diagnosis.search.choose import Chosen
from hil.diagnosis.search.rank import by_column
from hil.diagnosis.verdict.held_out import few_of
from hil.effects import Effect, Term
from hil.effects.thermometers import TEMPERATURE, is_temperature

Floats = NDArray[np.float64]

VARY_APART = "a campaign in which the columns the two read vary apart"
ONCE_MORE = "a second campaign under other conditions: the effect predicts it, something else does not"
"""What tells an effect from something that no effect of the catalogue explains."""
RETURN = "return to one reference point several times within a run"
"""The same of an effect that occurs once, or wanders: no campaign predicts another."""
NOTHING: Mapping[str, Sequence[str]] = MappingProxyType({})
WAY = ("since_reversal_mm", "stroke_mm")
"""Columns of the way to the target."""


def columns_as_good(chosen: Chosen, term: Term, noise: Noise) -> tuple[tuple[Term, float], ...]:
    """The effect of a term by each column that it may follow, with its share among them; none where no other has any."""
    last, kept = chosen.last, list(chosen.kept)
    place = next(i for i, choice in enumerate(kept) if (choice.form, choice.theta) == (term.form, term.theta))
    ranked = by_column(last.searcher, [*kept[:place], *kept[place + 1 :]], kept[place], last.noise)
    raw = [math.exp(max((one.evidence - ranked[0].evidence) / policy().temperature, -40.0)) for one in ranked]
    shares = [value / sum(raw) for value in raw]
    found = []
    for one, share in zip(ranked, shares, strict=True):
        if share > policy().least_confidence:
            fit = last.searcher.fit_of_unknown_noise([*kept[:place], one.choice, *kept[place + 1 :]], noise)
            found.append((fit.found[place], share))
    return tuple(found) if len(found) > 1 else ()


def weights_of(chosen: Chosen, effect: str) -> dict[str, float]:
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
                raw = {name: math.exp(max(value / policy().temperature, -40.0)) for name, value in odds.items()}
                total = sum(raw.values())
                return {name: value / total for name, value in raw.items()}
    return {}


def separating(effect: Effect, rival: str, absent: Sequence[str] = ()) -> str:
    """The measurement that separates an effect from a rival, which may follow one of these columns that nobody recorded."""
    general = VARY_APART if rival != OUTSIDE else RETURN if effect.once else ONCE_MORE
    return catalogue_says(effect, rival) or (to_record(absent) if absent else general)


def catalogue_says(effect: Effect, rival: str) -> str:
    """The measurement that the effect itself names against a rival; empty where it names none."""
    return next((known.separate_by for known in effect.rivals if known.effect == rival), "")


def to_record(columns: Sequence[str]) -> str:
    """What to do about columns that nobody recorded, one of which would tell."""
    return f"record {'one of these ' if len(columns) > 1 else ''}in every row: {'; '.join(columns)}"


def to_show(column: str, recorded: Collection[str]) -> str:
    """What to do for one column that nobody changed, or recorded."""
    return f"measure at another value of: {column}" if column in recorded else to_record((column,))


def is_between_runs(course_um: Floats, campaign: CampaignRows) -> bool:
    """Whether a course of the rows (n,) is a jump from one run to the next: everything that was set there may have caused it."""
    jumps = np.flatnonzero(np.diff(course_um))
    return len(jumps) == 1 and bool(campaign.run[jumps[0]] != campaign.run[jumps[0] + 1])


def is_at_an_end(course_um: Floats) -> bool:
    """Whether a course of the rows (n,) jumps where only a few of them are before or after."""
    jumps = np.flatnonzero(np.diff(course_um)) + 1
    return len(jumps) == 1 and bool(min(jumps[0], len(course_um) - jumps[0]) <= few_of(len(course_um)))


def is_unsure(finding: Finding, findings: Sequence[Finding], campaign: CampaignRows, noise_um: float) -> bool:
    """Whether whatever nobody recorded looks like this: a jump from one run to the next, or with few rows before or after it, or
    beside a course that wanders, which is one course with it; several jumps, as a state makes them that comes and goes (of 56 such
    findings on machines of the grammar 4 were right); one that is small against the noise (the policy's `small_jump`); a course in
    time that follows nothing; one that differs along the travel while none of the temperatures that were logged shows it.

    noise_um: standard deviation of the noise of the rows
    """
    survey, needs = campaign.survey, set(finding.term.needs)
    thermometers = {name for name in campaign.columns if TEMPERATURE.fullmatch(name)}
    if {survey.time_column, "target_mm"} <= needs and thermometers and not needs & thermometers:
        return True
    if not finding.term.effect.once:
        return False
    wanders = any(one.term.form.shrunk for one in findings)
    if wanders or len(finding.terms) > 1 or finding.rms_um < policy().small_jump * noise_um:
        return True
    course_um = finding.term.error_um(campaign.columns)
    return is_between_runs(course_um, campaign) or is_at_an_end(course_um)


def beaten_by_runs(chosen: Chosen) -> set[str]:
    """Effects that a slope along the travel, another one in each run, beats or all but equals.

    A load or the place of another axis that was set anew for each run, and not recorded, makes such slopes, and the columns of an
    effect may happen to go with them.
    """
    last, kept = chosen.last, chosen.kept
    campaign = last.searcher.linear.campaign
    if np.ptp(campaign.x) == 0.0:
        return set()
    slopes = run_columns(campaign) * (campaign.x - np.mean(campaign.x))[:, None] / np.std(campaign.x)
    out: set[str] = set()
    for name in {choice.effect.id for choice in kept if not choice.effect.static}:
        mine = [choice for choice in kept if choice.effect.id == name]
        if slopes.shape[1] <= len(mine) or any(choice.form.shrunk for choice in mine):
            continue
        others = [choice for choice in kept if choice.effect.id != name]
        projection = last.searcher.projection(last.noise, last.searcher.extra(others))
        gain = projection.gain(np.hstack([choice.columns(campaign) for choice in mine]))
        if float(random_gain(projection, slopes)[0]) > gain - policy().simpler:
            out.add(name)
    return out


def with_rivals(
    findings: Sequence[Finding],
    doubted: Collection[str],
    unseen: Mapping[str, Sequence[str]],
    alike: Mapping[str, Sequence[str]],
    carriers: Sequence[Carrier],
) -> tuple[Finding, ...]:
    """The findings beside what is left, those of the effects in doubt beside the causes that nobody recorded.

    unseen: of each effect the columns that nobody recorded; alike: by effect, rivals through such a column (`not_told_apart`)
    """
    out = []
    for finding in findings:
        names = (OUTSIDE, *(name for name in unseen if name != finding.effect)) if finding.effect in doubted else ()
        names = tuple(dict.fromkeys((*alike.get(finding.effect, ()), *names)))
        refuted = any(is_refuted_by(finding, carrier) for carrier in carriers)
        if refuted:
            names = tuple(dict.fromkeys((*names, OUTSIDE)))
        beside = beside_unseen_causes(finding, names, unseen) if names else finding
        left_um = max((carrier.rms.value for carrier in carriers), default=0.0)
        out.append(beside if refuted else beside_what_is_left(beside, left_um))
    return tuple(out)


def is_refuted_by(finding: Finding, carrier: Carrier) -> bool:
    """Whether what is left follows a column of the effect together with another one: then the machine has a function of that column
    which is not the effect's, and all of it may be that. In the effect's own columns alone it is another form of the same cause. A
    function of the position alone may be the mean of what changes along it with another column, or with the way since the reversal.
    """
    names = {name for term in finding.terms for name in term.needs}
    needs = set(map(_kind, names))
    own = needs - {"target_mm", "direction"}
    if any(map(is_temperature, names)):  # a lag reads the time, and nothing else follows it
        own -= {"time_s", "row_order"}
    columns = {_kind(name) for name in carrier.columns if name != "direction"}
    if "target_mm" in needs and not own:
        return "way" in columns or ("target_mm" in columns and len(columns - {"run", "row_order"}) > 1)
    return bool(columns & own) and not columns <= own


def _kind(column: str) -> str:
    """What a column is of: a hysteresis follows all of the way to the target, and the temperatures of a machine rise together."""
    return "way" if column in WAY else "temperature" if TEMPERATURE.fullmatch(column) else column


def beside_unseen_causes(
    finding: Finding, names: Sequence[str], unseen: Mapping[str, Sequence[str]] = NOTHING
) -> Finding:
    """The finding with rivals that nobody recorded, together nearly as likely as itself."""
    other = finding.confidence * math.exp(-policy().simpler / policy().temperature)
    share = 1.0 / (1.0 + other)
    known = {rival.effect: rival.confidence for rival in finding.rivals}
    known |= {name: known.get(name, 0.0) + other / len(names) for name in names}
    return _weighed(finding, share, {name: weight * share for name, weight in known.items()}, unseen)


def beside_what_is_left(finding: Finding, left_um: float) -> Finding:
    """The finding with what is left unexplained as a rival, by its share of the power of both: the cause of it may have caused all."""
    if finding.doubtful or left_um <= 0.0:
        return finding
    share = finding.rms_um**2 / (finding.rms_um**2 + left_um**2)
    known = {rival.effect: rival.confidence * share for rival in finding.rivals}
    known[OUTSIDE] = known.get(OUTSIDE, 0.0) + 1.0 - share
    return _weighed(finding, share, {name: one for name, one in known.items() if one > policy().least_confidence})


def _weighed(
    finding: Finding, share: float, rivals: Mapping[str, float], unseen: Mapping[str, Sequence[str]] = NOTHING
) -> Finding:
    """The finding with this share of its confidence, beside rivals of these weights."""
    said = {rival.effect: rival.separate_by for rival in finding.rivals if rival.separate_by != VARY_APART}
    said |= {name: separating(finding.term.effect, name, unseen.get(name, ())) for name in rivals if name not in said}
    apart = (RivalFound(name, weight, said[name]) for name, weight in rivals.items())
    ordered = tuple(sorted(apart, key=lambda rival: -rival.confidence))
    return replace(finding, confidence=finding.confidence * share, rivals=ordered)
