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
from hil.diagnosis.verdict.held_out import ONCE, few_of
from hil.effects import Columns, Effect, Survey, Term
from hil.effects.base import UM_PER_MM_PPM
from hil.effects.load_deflection import is_tilt
from hil.effects.survey import OTHER_AXIS
from hil.effects.thermometers import AIR_TEMPERATURE, TEMPERATURE, is_temperature

Floats = NDArray[np.float64]

SENSORS = (
    *("load_kg", "torque_percent", "pitch_urad", "yaw_urad", "pos_y_mm"),
    *("air_temp_c", "air_pressure_hpa", "air_humidity_percent", "temp_screw_c"),
)
"""Columns that a cause may follow; through one that was not recorded it can only be a rival."""

FORCES = frozenset({"load_kg", "torque_percent"})
ANGLES = ("pitch_urad", "yaw_urad")
SLOW = frozenset({"thermal_drift", "beam_drift", "datum_step"})
"""Effects that are an offset in the course of time."""
MOST_OF_AIR_PPM = 6.0
"""Change of the air's refractive index, ppm of the length, by 3 K and 10 hPa: 0.93 per K and 0.27 per hPa (Edlén, at 20 °C)."""
VARY_APART = "a campaign in which the columns the two read vary apart"
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
    return catalogue_says(effect, rival) or (to_record(absent) if absent else VARY_APART)


def catalogue_says(effect: Effect, rival: str) -> str:
    """The measurement that the effect itself names against a rival; empty where it names none."""
    return next((known.separate_by for known in effect.rivals if known.effect == rival), "")


def to_record(columns: Sequence[str]) -> str:
    """What to do about columns that nobody recorded, one of which would tell."""
    return f"record {'one of these ' if len(columns) > 1 else ''}in every row: {'; '.join(columns)}"


def is_between_runs(course_um: Floats, campaign: CampaignRows) -> bool:
    """Whether a course of the rows (n,) is a jump from one run to the next: everything that was set there may have caused it."""
    jumps = np.flatnonzero(np.diff(course_um))
    return len(jumps) == 1 and bool(campaign.run[jumps[0]] != campaign.run[jumps[0] + 1])


def is_at_an_end(course_um: Floats) -> bool:
    """Whether a course of the rows (n,) jumps where only a few of them are before or after."""
    jumps = np.flatnonzero(np.diff(course_um)) + 1
    return len(jumps) == 1 and bool(min(jumps[0], len(course_um) - jumps[0]) <= few_of(len(course_um)))


def is_unsure(finding: Finding, findings: Sequence[Finding], campaign: CampaignRows) -> bool:
    """Whether whatever nobody recorded looks like this: a jump from one run to the next, or with few rows before or after it, or
    beside a course that wanders, which is one course with it; several jumps, as a state makes them that comes and goes (of 56 such
    findings on machines of the grammar 4 were right); a course in time that follows nothing; one that differs along the travel while
    none of the temperatures that were logged shows it.
    """
    survey, needs = campaign.survey, set(finding.term.needs)
    if {survey.time_column, "target_mm"} <= needs and survey.temperatures and not needs & set(survey.temperatures):
        return True
    if finding.effect not in ONCE:
        return False
    wanders = any(one.term.form.shrunk for one in findings)
    if wanders or len(finding.terms) > 1:
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


def not_told_apart(
    findings: Sequence[Finding], recorded: Collection[str], columns: Columns | None = None
) -> dict[str, tuple[str, ...]]:
    """By effect, the rival that follows one column nobody recorded, where that column goes with those that were recorded.

    The motor's torque goes with speed, load and direction: a deflection by torque where the speed is not known may be a lag; a lag
    where neither load nor torque is known may be a deflection, and beside a deflection, where one of them is not, the rest of it. A
    load and a temperature tilt the carriage: a deflection alike in both directions, or one beside a slow course, may be an arm times
    an angle that was not measured; an arm where the load is not known may be a deflection. The air of the shop warms with the
    machine: a drift with a temperature may be that of a dead path, and a growth that no material has that of the air's index; where
    no temperature of the machine is known, what the air does may be the machine's, and the other way round; where none is known at
    all, so may a course of time. An expansion of no more than air does in a day may be the air's. A jump may be a load that was put
    on, or another axis that went elsewhere. Wear at an end of the travel, unlike in the two directions, may be lost motion where the
    way since the reversal is known from the targets alone.

    columns: completed, of the rows, (n,) each; sizes and places do not count without
    """
    found = {finding.effect: finding for finding in findings}
    out: dict[str, tuple[str, ...]] = {}
    deflection = found.get("load_deflection")
    tilts = any(is_tilt(term) for finding in findings if finding.effect == "load_deflection" for term in finding.terms)
    if deflection is not None and "torque_percent" in deflection.term.needs and "velocity_mm_s" not in recorded:
        out["load_deflection"] = ("velocity_lag",)
    elif "velocity_lag" in found and len(FORCES - set(recorded)) > (deflection is None):
        out["velocity_lag"] = ("load_deflection",)
    slow = SLOW & set(found)
    if deflection is not None and (slow or tilts) and not set(ANGLES) <= set(recorded):
        out |= {name: (*out.get(name, ()), "abbe") for name in (*slow, "load_deflection")}
    if "abbe" in found and deflection is None and "load_kg" not in recorded:
        out["abbe"] = ("load_deflection",)
    if "datum_step" in found and "load_kg" not in recorded:
        out["datum_step"] = (*out.get("datum_step", ()), "load_deflection")
    if "datum_step" in found and not any(map(OTHER_AXIS.fullmatch, recorded)):
        out["datum_step"] = (*out.get("datum_step", ()), "cross_axis")
    worn = found.get("local_wear")
    if worn is not None and "since_reversal_mm" not in recorded and _is_worn_at_an_end(worn, columns):
        out["local_wear"] = ("lost_motion",)
    by_air_or_machine = (("thermal_drift", "dead_path"), ("thermal_expansion", "air_index"))
    without_temperature = not any(TEMPERATURE.fullmatch(column) for column in recorded)
    if without_temperature:
        out |= {by_air: (*out.get(by_air, ()), name) for name, by_air in by_air_or_machine if by_air in found}
    if AIR_TEMPERATURE not in recorded or without_temperature:
        for name, by_air in by_air_or_machine:
            finding = found.get(name)
            knows_none = without_temperature and AIR_TEMPERATURE not in recorded
            if finding is not None and _may_be_of_air(finding, columns, knows_none=knows_none):
                out[name] = (*out.get(name, ()), by_air)
    return out


def _may_be_of_air(finding: Finding, columns: Columns | None, *, knows_none: bool) -> bool:
    """Whether a drift or an expansion may be what the air does, where its temperature was not recorded, or none of the machine (the
    air's neither: knows_none). columns: of the rows, where the size of an expansion counts
    """
    if not any(is_temperature(name) for term in finding.terms for name in term.needs):
        return knows_none
    if finding.effect == "thermal_drift" or finding.is_implausible:
        return True
    return columns is not None and _growth_ppm(finding, columns) < MOST_OF_AIR_PPM


def _is_worn_at_an_end(finding: Finding, columns: Columns | None) -> bool:
    """Whether a worn zone reaches an end of the travel, unlike in the two directions: there are the reversals."""
    if columns is None or not any("direction" in term.needs for term in finding.terms):
        return False
    course_um, target = np.abs(sum(term.error_um(columns) for term in finding.terms)), columns["target_mm"]
    at_ends = (target == np.min(target)) | (target == np.max(target))
    return bool(np.max(course_um[at_ends]) > 0.5 * np.max(course_um))


def _growth_ppm(finding: Finding, columns: Columns) -> float:
    """Change over the rows of what an effect adds along the travel, ppm of it; infinite at one place."""
    ends_mm = [float(end(columns["target_mm"])) for end in (np.min, np.max)]
    there_um, here_um = (
        sum(term.error_um({**columns, "target_mm": np.full_like(columns["target_mm"], at)}) for term in finding.terms)
        for at in reversed(ends_mm)
    )
    travel_mm = ends_mm[1] - ends_mm[0]
    return float(np.ptp(there_um - here_um)) / travel_mm / UM_PER_MM_PPM if travel_mm > 0.0 else math.inf


def with_rivals(
    findings: Sequence[Finding],
    doubted: Collection[str],
    unseen: Mapping[str, Sequence[str]],
    recorded: Collection[str],
    carriers: Sequence[Carrier],
    *,
    columns: Columns | None = None,
) -> tuple[Finding, ...]:
    """The findings beside what is left, those of the effects in doubt beside the causes that nobody recorded.

    unseen: of each effect the columns that nobody recorded; columns: completed, of the rows, (n,) each
    """
    by_one_column = not_told_apart(findings, recorded, columns)
    out = []
    for finding in findings:
        names = (OUTSIDE, *(name for name in unseen if name != finding.effect)) if finding.effect in doubted else ()
        names = tuple(dict.fromkeys((*by_one_column.get(finding.effect, ()), *names)))
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


def unrecorded(effects: Sequence[Effect], survey: Survey, recorded: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Of each effect that could show in columns nobody recorded, these. A speed that was not recorded is rest."""
    absent = [name for name in SENSORS if name not in recorded]
    wider = replace(survey, varying=survey.varying.union(absent), mean={**dict.fromkeys(absent, 1.0), **survey.mean})
    read = {effect.id: {name for form in effect.forms(wider) for name in form.inputs} for effect in effects}
    return {
        effect: tuple(name for name in absent if name in names) for effect, names in read.items() if names & set(absent)
    }


def beside_unseen_causes(
    finding: Finding, names: Sequence[str], unseen: Mapping[str, Sequence[str]] = NOTHING
) -> Finding:
    """The finding with rivals that nobody recorded, together nearly as likely as itself."""
    other = finding.confidence * math.exp(-policy().unseen / policy().temperature)
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
