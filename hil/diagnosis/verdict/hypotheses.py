"""Possible causes of an error, each with its weight by the records: those the records can show, and those hidden in
them.

A cause is hidden where the column it follows was never logged or never changed: a constant load looks like backlash, an
unmeasured tilt like a lead error. Such a column is assumed here - constant where it is set, a smooth course where it
varies by itself - and the cause competes with that.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.noise.evidence import LinearCampaign, Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.choose import problem_of
from hil.diagnosis.search.fit import START_ROUGHNESS, Choice, JointFit, start_noise, static_part
from hil.diagnosis.search.rank import rank
from hil.diagnosis.search.searcher import GRID, ConditionalSearch, Effort, Searcher
from hil.effects import Effect, Form, Survey, Term
from hil.effects.history import complete, time_column
from hil.effects.model import Model
from hil.effects.warming import is_about_a_point
from hil.records.rows import Records, concatenate

Floats = NDArray[np.float64]

WIDE = Effort(contenders=20, rounds=4, grid=GRID[::2], rich=4)
COURSES = (1, 2, 3, 4, 6)
"""Orders of the smooth courses assumed for an unseen column."""

SET = {"load_kg": 1.0, "pos_y_mm": 100.0, "abbe_offset_mm": 0.0, "setup": 1.0}
"""Columns that a person sets, with the level assumed where none is recorded."""
IN_TIME = ("temp_screw_c", "air_temp_c")
ALONG = ("pitch_urad",)
REST = {"temp_screw_c": 20.0, "air_temp_c": 20.0, "pitch_urad": 0.0}
SENSED = re.compile(r"temp_\w+_c|air_\w+|pitch_urad|yaw_urad")


@dataclass(frozen=True)
class Unseen:
    """A cause through a column that the records lack: its form, and its columns (n, k).

    courses: assumed course of the column about its usual value, one for each of the k, shape (n, k)
    """

    effect: Effect
    form: Form
    column: str
    design: Floats
    courses: Floats

    @property
    def wanders(self) -> bool:
        """Whether it is an offset that follows an unread sensor, and so may take any course in time."""
        return self.column in IN_TIME and "target_mm" not in self.form.inputs


@dataclass(frozen=True)
class Hypothesis:
    """A cause with its weight among all, its log Bayes factor, the best form it has in the records, and the unseen
    column it needs, if any.
    """

    effect: Effect
    weight: float
    gain: float
    choice: Choice | None
    unseen: Unseen | None

    @property
    def id(self) -> str:
        """Id of the effect."""
        return self.effect.id


def joined(parts: Sequence[Records]) -> Records:
    """Campaigns one after another as one; a set column without values had the first level of a later campaign.

    A sensor that was missing leaves its cells empty. Raises InputError as `Records.of`.
    """
    columns = dict.fromkeys(name for part in parts for name in part.columns)
    usual = {name: next(float(p[name][0]) for p in parts if name in p) for name in columns if is_set(name)}
    usual |= {name: value for name, value in (("abbe_offset_mm", 0.0), ("setup", 1.0)) if name in usual}
    timed = all("time_s" in part for part in parts)
    whole = []
    for part in parts:
        full = dict(part.columns)
        if "since_reversal_mm" in columns or "stroke_mm" in columns:
            full |= {name: v for name, v in complete(full).items() if name in ("since_reversal_mm", "stroke_mm")}
        for name in columns:
            if name not in full:
                rest = part.command_mm if name == "command_mm" else np.full(len(part), usual.get(name, math.nan))
                full[name] = np.zeros(len(part)) if name == "velocity_mm_s" else rest
        if not timed:
            full.pop("time_s", None)
        whole.append(Records.of(full))
    return concatenate(whole)


def is_set(column: str) -> bool:
    """Whether a column is set by a person, not read."""
    return column in SET or bool(re.fullmatch(r"pos_\w+_mm", column))


def segments(records: Records) -> tuple[Records, ...]:
    """The records split by which sensors were there, each without its empty columns."""
    sensors = [name for name in records.columns if SENSED.fullmatch(name)]
    there = np.array([np.isfinite(records[name]) for name in sensors]).reshape(len(sensors), len(records))
    kinds = np.unique(there, axis=1)
    parts = []
    for kind in kinds.T:
        rows = np.all(there == kind[:, None], axis=0)
        gone = {name for name, filled in zip(sensors, kind, strict=True) if not filled}
        part = records.where(rows)
        parts.append(
            (int(np.flatnonzero(rows)[0]), Records.of({n: v for n, v in part.columns.items() if n not in gone}))
        )
    return tuple(part for _, part in sorted(parts, key=lambda item: item[0]))


def weigh(
    records: Records, declared: Model | None, effects: Sequence[Effect], beside: Sequence[Term] = ()
) -> tuple[Hypothesis, ...]:
    """Every cause with its weight, the likeliest first.

    beside: effects known to be there. Raises InputError for too few rows.
    """
    total: dict[str, float] = {}
    best: dict[str, Hypothesis] = {}
    once = {effect.id for effect in effects if effect.once}
    for part in segments(records):
        for effect in effects:
            total.setdefault(effect.id, effect.log_odds if effect.static else 0.0)
        for hypothesis in _weigh_part(part, declared, effects, beside):
            name = hypothesis.id
            least = 0.0 if name in once else policy().worst
            total[name] += max(hypothesis.gain, least)
            best[name] = hypothesis
    gains = {name: total[name] for name in best}
    if not gains:
        return ()
    top = max(gains.values())
    raw = {name: math.exp((gain - top) / policy().temperature) for name, gain in gains.items()}
    whole = sum(raw.values())
    found = [replace(best[name], weight=raw[name] / whole, gain=gains[name]) for name in gains]
    return tuple(sorted(found, key=lambda h: -h.weight))


def _weigh_part(
    records: Records, declared: Model | None, effects: Sequence[Effect], beside: Sequence[Term]
) -> list[Hypothesis]:
    """The gain of each cause over none in records of complete columns; causes that they cannot show are left out."""
    searcher = searcher_of(records, declared, effects)
    campaign = searcher.linear.campaign
    rest = [choice_of(term) for term in beside if all(name in campaign.columns for name in term.needs)]
    if declared is not None and rest:
        absorbed = static_part(LinearCampaign(campaign), rest)
        searcher = Searcher(replace(searcher.setting, static=absorbed), searcher.candidates, effort=WIDE)
    noise = searcher.fit_noise(rest, start_noise(campaign))
    before, _ = searcher.profiled_evidence(rest, noise)
    found: dict[str, Hypothesis] = {}
    for ranked in rank(searcher, rest, noise):
        if declared is not None and _is_static(campaign, ranked.choice, searcher.fit([ranked.choice], noise)):
            continue
        found[ranked.effect] = Hypothesis(ranked.choice.effect, 0.0, ranked.evidence - before, ranked.choice, None)
    conditional = ConditionalSearch(searcher, rest)
    noises = [noise, noise.calm(), *(replace(noise, ar=a, rho=r, offset=o) for a, r, o in WIDE.grid)]
    projections = [(conditional.projection(trial), conditional.base(trial)) for trial in dict.fromkeys(noises)]
    for unseen in unseen_causes(campaign, effects):
        if _hidden(projections[0][0].prepared(unseen.design), projections[0][0].normal(unseen.design)[0]):
            continue
        gain = (
            max(base + projection.gain(unseen.design) for projection, base in projections) - before - policy().simpler
        )
        name = unseen.effect.id
        if name not in found or gain > found[name].gain:
            found[name] = Hypothesis(unseen.effect, 0.0, gain, None, unseen)
    for hypothesis in list(found.values()):  # an unseen drift may follow any course that a drift may
        loose = found.get("beam_drift")
        if loose is None or hypothesis.unseen is None or not hypothesis.unseen.wanders:
            continue
        gain = loose.gain - loose.effect.log_odds - policy().simpler
        if hypothesis.gain < gain:
            found[hypothesis.id] = replace(hypothesis, gain=gain)
    return list(found.values())


def _is_static(campaign: CampaignRows, choice: Choice, fit: JointFit) -> bool:
    """Whether a cause that depends on time was present from the first row on, so that a table would hold it.

    A drift that settles at once is a shape along the travel under another name.
    """
    if time_column(campaign.columns) not in choice.form.inputs or choice.form.shrunk or not fit.found:
        return False
    drawn = fit.found[0].error_um(campaign.columns)
    noise = Noise(offset=1.0, even=START_ROUGHNESS, odd=START_ROUGHNESS)
    projection = LinearCampaign(campaign).projection(noise, drawn - float(np.mean(drawn)))
    return bool(float(projection.rss) < policy().still ** 2 * float(np.sum(projection.y**2)))


def _hidden(prepared: Floats, left: Floats) -> bool:
    """Whether less than a hundredth of the columns' norm remains beside the table."""
    return bool(np.max(np.diag(left)) < 1e-4 * np.max(np.sum(prepared**2, axis=0)))


def searcher_of(records: Records, declared: Model | None, effects: Sequence[Effect]) -> Searcher:
    """The search of all effects against the declared table, or against one fitted from the records."""
    campaign = prepare(records)
    problem = problem_of(campaign, effects, declared, 0)
    if problem.given is None:
        return Searcher(problem.free, problem.candidates, effort=WIDE)
    return Searcher(problem.given, enumerate_candidates(campaign, effects), effort=WIDE)


def choice_of(term: Term) -> Choice:
    """A fitted term as a choice of its form and parameters."""
    return Choice(term.effect, term.form, term.theta, variance=10.0)


def unseen_causes(campaign: CampaignRows, effects: Sequence[Effect]) -> list[Unseen]:
    """Each way in which an effect could act through a column that the campaign lacks or never changed."""
    survey = campaign.survey
    out: list[Unseen] = []
    for column, level in _levels(campaign).items():
        for effect, form in _forms_with(survey, column, level, effects):
            constant = {**campaign.columns, column: np.full(len(campaign), level)}
            out.append(Unseen(effect, form, column, effect.basis(form, form.starts[0], constant), np.zeros((0, 0))))
    for column in (*IN_TIME, *ALONG):
        if _has_alike(survey, column):
            continue
        courses = smooth_courses(campaign.columns, column)
        wanders = [courses[:, 1 : order + 1] for order in COURSES]
        constant_too = [courses[:, :1], *(courses[:, : order + 1] for order in COURSES)]
        for effect, form in _forms_with(survey, column, REST[column], effects):
            if is_about_a_point(form):  # two coefficients for each course; growth about zero stands for it
                continue
            seen = column in IN_TIME and "target_mm" in form.inputs  # alone, a constant is the datum's
            for part in (*wanders, *(constant_too if seen else [])):
                out.append(Unseen(effect, form, column, response(effect, form, column, campaign.columns, part), part))
    return out


def _levels(campaign: CampaignRows) -> dict[str, float]:
    """Columns that are set and did not change, at the level they had."""
    found = {}
    for name in ("velocity_mm_s", "load_kg", *(n for n in campaign.columns if re.fullmatch(r"pos_\w+_mm", n))):
        if name in campaign.columns and not campaign.survey.has(name):
            found[name] = float(np.nan_to_num(campaign.columns[name][0]))
    if "load_kg" not in campaign.columns:
        found["load_kg"] = SET["load_kg"]
    if not any(re.fullmatch(r"pos_\w+_mm", n) for n in campaign.columns):
        found["pos_y_mm"] = SET["pos_y_mm"]
    return {name: level for name, level in found.items() if level != 0.0}


def _has_alike(survey: Survey, column: str) -> bool:
    """Whether a sensor of the same kind is there."""
    if column.startswith("temp_"):
        return bool(survey.temperatures)
    if column.startswith("air_"):
        return any(name.startswith("air_") for name in survey.varying)
    return any(survey.has(name) for name in ("pitch_urad", "yaw_urad", "abbe_offset_mm"))


def _forms_with(survey: Survey, column: str, mean: float, effects: Sequence[Effect]) -> list[tuple[Effect, Form]]:
    """The plain forms that read a column, were it there."""
    wider = replace(survey, varying=survey.varying | {column}, mean={**survey.mean, column: mean})
    return [
        (effect, form)
        for effect in effects
        for form in effect.forms(wider)
        if column in form.inputs and form.scan and not form.nonlinear and not form.shrunk
    ]


def smooth_courses(columns: Mapping[str, Floats], column: str) -> Floats:
    """Possible courses of a sensor about its usual value, along the travel or in time, shape (n, 1 + orders).

    The first is a constant.
    """
    along = columns["target_mm"] if column in ALONG else columns[time_column(columns)]
    low, high = float(np.min(along)), float(np.max(along))
    v = (2 * along - low - high) / max(high - low, 1e-9)
    return np.asarray(legendre.legvander(v, max(COURSES)), dtype=np.float64)


def response(effect: Effect, form: Form, column: str, columns: Mapping[str, Floats], courses: Floats) -> Floats:
    """Columns of a form of one coefficient for each course (n, k) of a column about its usual value, shape (n, k)."""
    usual = np.full(len(courses), REST[column])
    rest = effect.basis(form, form.starts[0], {**columns, column: usual})
    blocks = [effect.basis(form, form.starts[0], {**columns, column: usual + c}) - rest for c in courses.T]
    return np.asarray(np.hstack([rest[:, :0], *blocks]), dtype=np.float64)
