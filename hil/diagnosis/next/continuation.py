"""Predictions of each cause in a run that has not been made, and how well its rivals could be fitted to them.

Errors are predicted and refitted under a known noise; nothing is random or measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.joining import SENSED, SET, is_set, segments
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.diagnosing import rows_of
from hil.diagnosis.model.evidence import Candidate, Fit, Noise, Part
from hil.diagnosis.model.rows import NO_MEMORY, ROUGH, Given, ModelRows
from hil.diagnosis.next.causes import (
    ALONG,
    COURSES,
    IN_TIME,
    REST,
    Hypothesis,
    Unseen,
    response,
    smooth_courses,
    unseen_causes,
)
from hil.diagnosis.next.feasible import THERMOMETER
from hil.diagnosis.next.planned_run import Means, PlannedRun, motion_columns
from hil.diagnosis.table import DeclaredShape
from hil.effects import Effect, Form, Term
from hil.effects.history import BRANCH, time_column
from hil.effects.model import Model
from hil.records.rows import Floats, Records

Columns = Mapping[str, Floats]

TYPICAL_OFFSET = 0.25
"""Offset between runs, in standard deviations of the white noise, where the records do not determine it."""
TYPICAL_ARM_MM = 150.0
WARMING_S, WANDER_S = 900.0, 1800.0
"""Time constant with which strokes warm an axis, and period of changes in its surroundings, s."""
USUAL_SWING = {"temp": 0.3, "air": 1.0}
"""Amplitude of such changes over the standard deviation in the records, or in K where there are none; no more than there was in so
much time.
"""
HEAT = 2.0
"""Temperature change by strokes over that seen in the records."""
LEAST_WANDER = 0.5
"""Least assumed drift of a quantity that was constantly off its usual value, as a share of that."""
HIDDEN = 1e-7
"""Share of a column's squared norm below rounding."""
SAME = 0.1
"""Share of an error that a form may miss and still represent it."""


class Continuation:
    """The records, and the error by each cause in them; `discrimination` predicts a run after them."""

    def __init__(self, records: Records, declared: Model | None, causes: Sequence[Hypothesis], means: Means) -> None:
        self.declared, self.means = declared, means
        rows = rows_of(prepare(segments(records)[-1]), declared)
        self.base = rows.campaign
        self.causes = [_as_in(self.base, cause) for cause in causes]
        self.noise = Noise(NO_MEMORY, np.log([ROUGH**0.5, ROUGH**0.5, TYPICAL_OFFSET]))
        self.terms: list[Term | None] = []
        self.so_far: list[Floats] = []
        catalogue = Catalogue(rows, [cause.effect for cause in self.causes])
        noise_um = []
        for cause in self.causes:
            part = _part(catalogue, cause)
            fit = Fit(rows, () if part is None else (part,), self.noise)
            self.terms.append(None if part is None or part.of is None else _term(fit, part, part.of))
            self.so_far.append(np.zeros(rows.n) if part is None else fit.course_um(part))
            noise_um.append(fit.sigma)
        self.noise_um = min(noise_um)
        self.given: Given | None = None
        if declared is not None:
            plain = declared.with_terms(())
            self.given = Given(plain, DeclaredShape.of(plain.table, self.noise_um), ())
        self.apart_so_far = self._misfits(self.base, np.column_stack(self.so_far), None)

    def discrimination(self, run: PlannedRun) -> Floats:
        """Σ(f_i - f_j)²/σ² that the run adds when i is the cause and j is refitted to everything, shape (causes,
        causes).
        """
        plan = self._planned(run)
        whole = prepare(Records.of(self._together(plan)))
        n = len(self.base)
        later = {name: values[n:] for name, values in whole.columns.items()}
        varied = [name for name in run.adds if is_set(name) or name == "velocity_mm_s"]
        drawn = [
            np.concatenate([so_far, self._continued(index, whole, later, plan, varied)])
            for index, so_far in enumerate(self.so_far)
        ]
        logged = {name: plan[name] for name in run.adds if SENSED.fullmatch(name)}
        apart = self._misfits(whole, np.column_stack(drawn), logged)
        return np.asarray(np.maximum(apart - self.apart_so_far, 0.0))

    # -- columns of the run ------------------------------------------------------------------------------------------------
    def _planned(self, run: PlannedRun) -> dict[str, Floats]:
        """The predictable columns of a run: those that follow from its rows, and typical courses of sensors."""
        base = self.base.columns
        timed = time_column(base) == "time_s"
        start = float(base["time_s"][-1]) + 60.0 if timed else 0.0
        plan = motion_columns(run.points, self.means, start_s=start)
        strokes = plan["strokes_s"]
        since = plan["time_s"] - start
        for name in {*base, *run.adds} - set(plan):
            kind = name.split("_")[0]
            old = base.get(name)
            if SENSED.fullmatch(name) and kind in USUAL_SWING:
                middle, spread = (20.0, 1.0) if old is None else (float(np.mean(old)), float(np.std(old)))
                wave = np.sin(2 * np.pi * since / WANDER_S)
                swing = USUAL_SWING[kind] * spread
                if old is not None and timed:
                    swing = min(swing, _amplitude(wave, since, self.base, old))
                warmth = self._warmth(since, strokes) if kind == "temp" else 0.0
                plan[name] = middle + spread * warmth + swing * (wave - np.mean(wave))
            elif old is not None and name in ("pitch_urad", "yaw_urad"):
                order = np.argsort(base["target_mm"])
                plan[name] = np.interp(plan["target_mm"], base["target_mm"][order], old[order])
        return plan

    @staticmethod
    def _warmth(since_s: Floats, strokes_s: Floats) -> Floats:
        """Warmth of the axis row by row, in units of its change in the records: gained in strokes, lost with time."""
        out, state, before = np.empty(len(since_s)), 0.0, 0.0
        for i, (now, fast) in enumerate(zip(since_s, strokes_s, strict=True)):
            for duration, aim in ((now - before - fast, 0.0), (fast, 3.0 * HEAT)):
                state += (aim - state) * (1.0 - np.exp(-max(duration, 0.0) / WARMING_S))
            out[i], before = state, now
        return out

    def _together(self, plan: Columns) -> dict[str, Floats]:
        """Records and run as one; a set column without values had its usual level, sensors not in both are left out."""
        base, m = self.base.columns, len(plan["run"])
        whole: dict[str, Floats] = {}
        for name in {*base, *plan}:
            if name in ("row_order", "strokes_s", *BRANCH) or (name == "time_s" and "time_s" not in base):
                continue
            if name in base and name in plan:
                whole[name] = np.concatenate([base[name], plan[name]])
            elif name in base and not SENSED.fullmatch(name):
                whole[name] = np.concatenate([base[name], np.full(m, float(np.mean(base[name])))])
            elif name in plan and not SENSED.fullmatch(name):
                before = plan[name][0] if name == "load_kg" or name.startswith("pos_") else SET.get(name, 0.0)
                whole[name] = np.concatenate([np.full(len(self.base), before), plan[name]])
        whole["command_mm"] = whole["measured_mm"] = whole["target_mm"]
        return whole

    # -- what the cause would do -------------------------------------------------------------------------------------------
    def _continued(
        self, index: int, whole: CampaignRows, later: Columns, plan: Columns, varied: Sequence[str]
    ) -> Floats:
        """Error by a cause in the run, µm, shape (m,)."""
        cause, so_far = self.causes[index], self.so_far[index]
        drawn = self._through_new(cause.effect, whole, varied, so_far)
        if drawn is None:
            drawn = self._as_seen(index, later, plan) if cause.unseen is None else self._unseen(index, later, plan)
        return drawn

    def _as_seen(self, index: int, later: Columns, plan: Columns) -> Floats:
        """A cause that the records show: its term is evaluated on the run; a random drift continues as its own past,
        reversed in time.
        """
        term = self.terms[index]
        if term is None or term.form.shrunk:
            time = self.base.columns[time_column(self.base.columns)]
            return np.asarray(np.interp(time[-1] - (plan["time_s"] - plan["time_s"][0]), time, self.so_far[index]))
        columns = {**later, **{name: values for name, values in plan.items() if name in term.needs}}
        return term.error_um(columns)

    def _unseen(self, index: int, later: Columns, plan: Columns) -> Floats:
        """A cause through a column that the records lack."""
        unseen, so_far = self.causes[index].unseen, self.so_far[index]
        if unseen is None or unseen.column in ALONG:
            order = np.argsort(self.base.x)
            return np.asarray(np.interp(later["target_mm"], self.base.x[order], so_far[order]))
        if unseen.column in IN_TIME:
            return self._wandering(unseen, so_far, later, plan)
        coefficients = np.linalg.lstsq(_constant(unseen, self.base.columns), so_far, rcond=1e-9)[0]
        return np.asarray(_constant(unseen, later) @ coefficients)

    def _through_new(self, effect: Effect, whole: CampaignRows, varied: Sequence[str], so_far: Floats) -> Floats | None:
        """By a form of the effect that reads a column which the run varies for the first time, if such a form fits the
        records.
        """
        n = len(so_far)
        best: tuple[float, Floats] | None = None
        for form in effect.forms(whole.survey) if varied else ():
            if not set(form.inputs) & set(varied) or form.shrunk:
                continue
            theta = min(form.starts, key=lambda start: abs(start[0] - TYPICAL_ARM_MM) if start else 0.0)
            design = effect.basis(form, theta, whole.columns)
            centred = so_far - np.mean(so_far)
            old = np.column_stack([design[:n], np.ones(n)])
            coefficients = np.linalg.lstsq(old, centred, rcond=1e-9)[0]
            rounding = HIDDEN * np.sum(centred**2)  # of forms that miss less the first is taken, the simplest
            missed = float(max(np.sum((centred - old @ coefficients) ** 2), rounding))
            if best is None or missed < best[0] * 0.999:
                best = missed, np.asarray(design[n:] @ coefficients[:-1] + coefficients[-1] + np.mean(so_far))
        if best is None or best[0] > SAME * float(np.sum((so_far - np.mean(so_far)) ** 2)) + 1e-12:
            return None
        return best[1]

    def _wandering(self, unseen: Unseen, so_far: Floats, later: Columns, plan: Columns) -> Floats:
        """The column is where it was in the mean, as nobody knows where it is now, and varies as far as it did in as much time; by
        strokes, where it is a temperature, and where it is logged, as far as it did at all.
        """
        coefficients = np.linalg.lstsq(unseen.design, so_far, rcond=1e-9)[0]
        course = unseen.courses @ coefficients
        level, size = float(np.mean(course)), float(np.std(course))
        since = plan["time_s"] - plan["time_s"][0]
        wave = np.sin(2 * np.pi * since / WANDER_S)
        if "time_s" in self.base.columns:
            wave *= _amplitude(wave, since, self.base, course) / max(size, 1e-12)
        if unseen.column in plan or (unseen.column == THERMOMETER and np.any(plan["strokes_s"] > 0)):
            size = max(size, LEAST_WANDER * abs(level))
            wave = (
                plan[unseen.column] - REST[unseen.column]
                if unseen.column in plan
                else self._warmth(since, plan["strokes_s"])
            )
        ahead = np.column_stack([np.ones(len(wave)), wave - wave[0]])
        drawn = response(unseen.effect, unseen.form, unseen.column, later, ahead)
        return np.asarray(drawn @ [level, size])

    # -- how well rivals could follow --------------------------------------------------------------------------------------
    def _misfits(self, campaign: CampaignRows, drawn: Floats, logged: Columns | None) -> Floats:
        """Σ(f_i - f_j)²/σ² with j fitted to the error by i (a column of `drawn`), beside table and offsets, shape
        (causes, causes).
        """
        rows = ModelRows(campaign, self.given)
        fit = Fit(rows, (), self.noise)
        whole = _left_of(fit, drawn)
        out = np.empty((len(self.causes), len(self.causes)))
        loose = None
        for j, cause in enumerate(self.causes):
            designs = self._designs(campaign, cause.effect, logged or {})
            out[:, j] = np.minimum(whole, _left(fit, drawn, designs)) if designs else whole
            if cause.shown is not None and cause.shown.form.shrunk:
                loose = j
                random = cause.effect.basis(_refreshed(cause, campaign), cause.shown.theta, campaign.columns)
                free = Part(cause.id, (), random[:, :0], random * max(cause.shown.ratio, 1.0) ** 0.5, random[:, :0])
                out[:, j] = np.minimum(out[:, j], _left_of(Fit(rows, (free,), self.noise), drawn))
        read = {name.split("_")[0] for name in logged or {}}
        for j, cause in enumerate(self.causes):
            wandering = [u for u in unseen_causes(campaign, [cause.effect]) if u.wanders]
            if loose is not None and any(u.column.split("_")[0] not in read for u in wandering):
                out[:, j] = np.minimum(out[:, j], out[:, loose])
        out -= np.diag(out)[:, None]  # the misfit of a cause to its own prediction is no information
        return np.asarray(np.maximum(out, 0.0) / self.noise_um**2)

    def _designs(self, campaign: CampaignRows, effect: Effect, logged: Columns) -> list[Floats]:
        """Every way in which an effect could be fitted to records and run."""
        designs = [
            effect.basis(form, theta, campaign.columns)
            for form in effect.forms(campaign.survey)
            if form.scan and not form.shrunk
            for theta in form.starts
        ]
        n, m = len(self.base), len(campaign) - len(self.base)
        old = {name: values[:n] for name, values in campaign.columns.items()}
        new = {name: values[n:] for name, values in campaign.columns.items()}
        for unseen in unseen_causes(campaign, [effect]):
            name = unseen.column
            if not m or name not in REST or name in ALONG:
                designs.append(unseen.design)
            elif unseen.courses.shape[1] == max(COURSES):
                before = response(effect, unseen.form, name, old, smooth_courses(old, name))
                course = (logged[name] - REST[name])[:, None] if name in logged else smooth_courses(new, name)
                after = response(effect, unseen.form, name, new, course)
                designs.append(_apart(before, after))
        return designs


def _part(catalogue: Catalogue, cause: Hypothesis) -> Part | None:
    """A cause as a part of the model of the records, None for one without a form there."""
    if cause.shown is not None:
        return catalogue.part(cause.shown, 0.0)
    if cause.unseen is None:
        return None
    none = cause.unseen.design[:, :0]
    return Part(cause.id, (), cause.unseen.design, none, none)


def _term(fit: Fit, part: Part, shown: Candidate) -> Term | None:
    """The term of a part, without its uncertainty; None for a shrunk form, which continues by itself."""
    if shown.form.shrunk:
        return None
    return Term(shown.effect, shown.form, shown.theta, tuple(fit.beta[fit.where(part, "free")].tolist()), ())


def _as_in(base: CampaignRows, cause: Hypothesis) -> Hypothesis:
    """A cause as it applies to these rows, which may lack the column of its form in other rows; without a form where
    none applies.
    """
    unseen = cause.unseen
    if cause.shown is not None and all(name in base.columns for name in cause.shown.form.inputs):
        return cause
    alike = [
        other
        for other in unseen_causes(base, [cause.effect])
        if unseen is None
        or (other.column, other.form.name, other.design.shape[1])
        == (unseen.column, unseen.form.name, unseen.design.shape[1])
    ]
    return replace(cause, shown=None, unseen=alike[0] if alike else None)


def _apart(before: Floats, after: Floats) -> Floats:
    """Block-diagonal columns: those for the records are 0 in the run, and the reverse."""
    (n, k), (m, q) = before.shape, after.shape
    return np.block([[before, np.zeros((n, q))], [np.zeros((m, k)), after]])


def _amplitude(wave: Floats, since_s: Floats, campaign: CampaignRows, course: Floats) -> float:
    """By how much a wave of a run (m,) must be multiplied to vary as far as a course of the rows (n,) did in as much time."""
    return _swing(campaign, course, float(since_s[-1])) / max(float(np.std(wave)), 1e-12)


def _swing(campaign: CampaignRows, course: Floats, span_s: float) -> float:
    """How far a course of the rows (n,) varies within so much time: its standard deviation in parts of a run of that length."""
    time_s = campaign.columns["time_s"]
    start_s = np.array([np.min(time_s[campaign.run == number]) for number in range(campaign.runs)])
    step_s = float(np.median(np.abs(np.diff(time_s))))
    since = (time_s - start_s[campaign.run]) // max(span_s, 2.0 * step_s, 1e-9)
    _, part, rows = np.unique(np.column_stack([campaign.run, since]), axis=0, return_inverse=True, return_counts=True)
    off = course - (np.bincount(part.ravel(), course) / rows)[part.ravel()]
    return float(np.sqrt(np.sum(off**2) / max(len(course) - len(rows), 1)))


def _constant(unseen: Unseen, columns: Columns) -> Floats:
    """Columns of an unseen cause where what it follows stays as it was, shape (n, k)."""
    level = columns.get(unseen.column, np.full(len(columns["run"]), SET.get(unseen.column, 1.0)))
    return unseen.effect.basis(unseen.form, unseen.form.starts[0], {**columns, unseen.column: np.asarray(level)})


def _refreshed(cause: Hypothesis, campaign: CampaignRows) -> Form:
    """The same form with its constants for these rows."""
    form = cause.shown.form if cause.shown is not None else None
    found = [f for f in cause.effect.forms(campaign.survey) if form is not None and f.name == form.name]
    return found[0]


def _left_of(fit: Fit, drawn: Floats) -> Floats:
    """Squares of some errors (n, b) that a fit leaves, over the noise, (b,)."""
    return np.asarray(np.sum(fit.rows.white(drawn, fit.noise.memory) * fit.beside(drawn), axis=0).clip(1e-300))


def _left(fit: Fit, drawn: Floats, designs: Sequence[Floats]) -> Floats:
    """The same after the best of some designs (n, k)."""
    rest = fit.beside(drawn)
    most = np.zeros(drawn.shape[1])
    for width in sorted({design.shape[1] for design in designs}):
        side = np.hstack([design for design in designs if design.shape[1] == width])
        white = fit.rows.white(side, fit.noise.memory)
        blocks, left = (m.reshape(len(m), -1, width).transpose(1, 0, 2) for m in (white, fit.beside(side)))
        root = np.sqrt(np.maximum(np.sum(blocks**2, axis=1), 1e-300))
        gram = blocks.transpose(0, 2, 1) @ left / (root[:, :, None] * root[:, None, :])
        b = (white.T @ rest).reshape(len(blocks), width, -1) / root[:, :, None]
        explained = np.sum(b * np.linalg.solve(gram + HIDDEN * np.eye(width), b), axis=1)
        most = np.maximum(most, np.max(explained, axis=0))
    return np.maximum(_left_of(fit, drawn) - most, 0.0)
