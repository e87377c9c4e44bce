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

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.joining import SET, segments
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.diagnosing import rows_of
from hil.diagnosis.model.evidence import Candidate, Fit, Part
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.search import Search
from hil.diagnosis.model.unlogged import UNKNOWN
from hil.effects import Effect, Form, Survey, Term
from hil.effects.history import time_column
from hil.effects.model import Model
from hil.effects.warming import is_about_a_point
from hil.records.rows import Floats, Records

LEAST = 0.02
"""Weight of a cause from which it is compared."""
WORST = -12.0
"""Least log odds of a cause in one part of the records: no form is exactly right."""
HIDDEN = 1e-4
"""Share of the squares of its columns that must be left beside the table for a cause to be weighed."""
COURSES = (1, 2, 3, 4, 6)
"""Orders of the smooth courses assumed for an unseen column."""

IN_TIME = ("temp_screw_c", "air_temp_c")
ALONG = ("pitch_urad",)
REST = {"temp_screw_c": 20.0, "air_temp_c": 20.0, "pitch_urad": 0.0}


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
        return self.column in IN_TIME and not {"target_mm", "direction"} & set(self.form.inputs)


@dataclass(frozen=True)
class Hypothesis:
    """A cause with its weight among all, its log Bayes factor, the best form it has in the records, and the unseen
    column it needs, if any.
    """

    effect: Effect
    weight: float
    gain: float
    shown: Candidate | None
    unseen: Unseen | None

    @property
    def id(self) -> str:
        return self.effect.id


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
        for hypothesis in _weigh_part(part, declared, effects, beside):
            name = hypothesis.id
            least = 0.0 if name in once else WORST
            total[name] = total.get(name, 0.0) + max(hypothesis.gain, least)
            best[name] = hypothesis
    if not best:
        return ()
    top = max(total.values())
    raw = {name: math.exp((gain - top) / USUAL.temperature) for name, gain in total.items()}
    whole = sum(raw.values())
    found = [replace(best[name], weight=raw[name] / whole, gain=total[name]) for name in best]
    return tuple(sorted(found, key=lambda h: -h.weight))


def _weigh_part(
    records: Records, declared: Model | None, effects: Sequence[Effect], beside: Sequence[Term]
) -> list[Hypothesis]:
    """The gain of each cause over none in records of complete columns; causes that they cannot show are left out."""
    rows = rows_of(prepare(records), declared)
    search = Search(rows, Catalogue(rows, effects))
    known = [term for term in beside if all(name in rows.campaign.columns for name in term.needs)]
    parts = tuple(_part_of(search, term) for term in known)
    scored = search.scored(parts)
    found: dict[str, Hypothesis] = {}
    shown = [(one.log_p - scored[0].log_p, one.part.of) for one in search.alternatives(parts, remainder=False)]
    shown += [(one.gain, one.candidate) for one in search.catalogue.ranked([search.fit(parts)])]  # those far behind
    for gain, candidate in shown:
        if candidate is not None and candidate.effect.id not in found:
            found[candidate.effect.id] = Hypothesis(candidate.effect, 0.0, gain, candidate, None)
    fits = [Fit(rows, parts, one.noise) for one in scored]
    for unseen in unseen_causes(rows.campaign, effects):
        if _hidden(fits[0], unseen.design):
            continue
        gain = max(fit.log_p + _gain(fit, unseen.design) for fit in fits) - fits[0].log_p - UNKNOWN
        name = unseen.effect.id
        if name not in found or gain > found[name].gain:
            found[name] = Hypothesis(unseen.effect, 0.0, gain, None, unseen)
    loose = found.get("beam_drift")
    if loose is not None:  # an unseen drift may follow any course that a drift may
        gain = loose.gain - loose.effect.log_odds - UNKNOWN
        for name, one in found.items():
            if one.unseen is not None and one.unseen.wanders and one.gain < gain:
                found[name] = replace(one, gain=gain)
    return list(found.values())


def _part_of(search: Search, term: Term) -> Part:
    """A term as a part of the model, of a shrunk form with the likeliest variance."""
    one = Candidate(term.effect, term.form, term.theta)
    if term.form.shrunk:
        columns = term.effect.basis(term.form, term.theta, search.rows.campaign.columns)
        one = replace(one, ratio=search.fit(()).random_gain(columns)[1])
    return search.catalogue.part(one, 0.0)


def _gain(fit: Fit, columns: Floats) -> float:
    """Of a column that was set as of one that was recorded, of a course as of any random function, in units of its own size."""
    return (
        fit.gain(columns) if columns.shape[1] == 1 else fit.random_gain(columns / max(float(np.std(columns)), 1e-12))[0]
    )


def _hidden(fit: Fit, columns: Floats) -> bool:
    """Whether less than a hundredth of the columns' norm remains beside the table."""
    white = fit.rows.white(columns, fit.noise.memory)
    return bool(np.max(np.diag(fit.normal(columns)[0])) < HIDDEN * np.max(np.sum(white**2, axis=0)))


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
