"""The loop: calibrate, explore with the correction in force, diagnose the residual, add the missing effect, explore
again.

Where two causes fit the residual, the measurement that separates them best for its time is made next, and the diagnosis
is repeated with all rows. This ends when one cause remains, when no possible run separates them, or when the residual
is within the noise or unexplained.

Effects of motion are found in a second turn, of passes at feed, where the drive takes set-points in its cycle.

Before and after are both measured, in campaigns of the same kind at other targets; no reported figure is of rows that
were fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from drivers.errors import InputError
from hil.axis.axis_file import CorrectionConfig
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.explore import Exploration, ExploringRun, explore, plan_runs
from hil.calibration.in_motion import check_passes, measure_in_motion, plan_passes
from hil.calibration.latency import dated
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, SingleTable, TableSet
from hil.diagnosis import Diagnosis, Figures, diagnose
from hil.diagnosis.follow_up import FollowUp, diagnosed, follow_up, ruled_out
from hil.diagnosis.joining import joined
from hil.diagnosis.loop.next_run import means_of, runs_of
from hil.diagnosis.next.next_measurement import DECIDED
from hil.diagnosis.next.planned_run import PlannedRun
from hil.effects import ALL, Effect
from hil.effects.base import Term
from hil.effects.model import Model, PitchTable
from hil.figures.latency import Latency
from hil.machine.computing import Computing, at_once
from hil.machine.events import Event, Listener, silent
from hil.machine.in_motion_settings import InMotion
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import REQUIRED, Records


def compensation_of(model: Model, like: TableSet) -> Compensation:
    """A fitted model as tables and terms; mode, specified accuracy and straightness are those of `like`.

    The straightness table of `like` is part of the same command, so its share is subtracted from the pitch table.
    """
    nodes = np.array(model.table.positions_mm)
    pitch = DirectionalTable(nodes, -np.array(model.table.forward_um), -np.array(model.table.backward_um))
    if like.straightness is not None and not like.straightness_axis:
        pitch = pitch.plus_at_own(like.straightness.scaled(-1.0))
    backlash = SingleTable(nodes, pitch.plus_um - pitch.minus_um)
    return Compensation(replace(like, pitch=pitch, backlash=backlash), model.terms)


def bounded(session: AxisSession, model: Model, like: TableSet, rows: Records) -> Compensation:
    """`compensation_of`, checked against the axis's bound: along the axis, and in the rows that the model was fitted
    to.

    Raises CorrectionBoundError naming the largest excess.
    """
    extended, what = compensation_of(model, like), "extended correction not used"
    extended.check(session.command_state.bound, what)
    extended.check_rows(session.command_state.bound, what, rows.columns)
    return extended


def model_of(compensation: Compensation) -> Model:
    """A compensation in force as a declared model: the inverse of `compensation_of`.

    A deliberate deviation (specified accuracy) is not an error of the machine and is left out.
    """
    tables = compensation.tables
    nodes = tables.pitch.position_mm
    own = tables.pitch
    if tables.straightness is not None and not tables.straightness_axis:
        own = own.plus_at_own(tables.straightness)
    table = PitchTable.of(nodes, -own.plus_um, -own.minus_um)
    return Model(table, tuple(term for term in compensation.terms if isinstance(term, Term)))


def issuable(session: AxisSession, records: Records) -> Records:
    """The records without columns that are only known after a motion (motor position and torque at the capture).

    An effect that reads such a column could be fitted, but not put into force.
    """
    known = issuable_columns(session)
    return Records.of({name: values for name, values in records.columns.items() if name in known})


def issuable_columns(session: AxisSession) -> set[str]:
    """Names of the columns that are known when a set-point is issued, and of those that every record has."""
    return {*session.known(), *REQUIRED, "command_mm", "since_reversal_mm", "stroke_mm"}


Store = Callable[[Compensation], None]
Consent = Callable[[PlannedRun], bool]
"""Called before a run that needs a person: whether a person is there and does it."""

MOST_RUNS = 2
"""Most further measurements in one turn."""


@dataclass(frozen=True)
class Turning:
    """Settings of a loop.

    exploration, or instead of it plan: the campaigns before and after; consent: asks for a person where a run needs
    one, None: only automatic runs are made; most_further: most runs to separate causes; effects: the catalogue and user
    effects; in_motion: passes of a second turn, at feed; computing: how the diagnosis is run
    """

    exploration: Exploration = field(default_factory=Exploration)
    plan: Sequence[ExploringRun] | None = None
    consent: Consent | None = None
    most_further: int = MOST_RUNS
    effects: Sequence[Effect] = ALL
    in_motion: InMotion | None = None
    computing: Computing = field(default=at_once)


@dataclass(frozen=True)
class Turn:
    """One turn of the loop.

    before: explored with the old compensation in force; after: explored again with the extended one
    extended: in force at the end: where it measured worse than the old one, that is the old one again (`withdrawn`)
    diagnosed: the rows of the diagnosis, those before and those of the further runs
    further: runs made to separate causes; follow: the last diagnosis with the remaining rivals and what would separate
    them; latency: of the instrument, where it was measured for this turn
    """

    before: Records
    follow: FollowUp
    extended: Compensation
    after: Records
    diagnosed: Records
    further: tuple[PlannedRun, ...] = ()
    latency: Latency | None = None
    withdrawn: bool = False

    @property
    def diagnosis(self) -> Diagnosis:
        """The verdict, with all its rivals."""
        return self.follow.diagnosis


@dataclass(frozen=True)
class Loop:
    """A calibration, the turn after it at rest, and that in motion if requested."""

    calibration: Calibration
    turn: Turn
    in_motion: Turn | None = None


def close_loop(
    session: AxisSession,
    campaign: Campaign,
    correction: CorrectionConfig,
    store: Store,
    listener: Listener = silent,
    *,
    turning: Turning | None = None,
) -> Loop:
    """Calibrates and closes the loop on a prepared session; leaves the extended compensation in force and stored.

    Raises CapabilityError before any motion where passes in motion are requested of a drive that takes no set-points in
    its cycle, and what `calibrate` and `turn_loop` raise.
    """
    turning = turning or Turning()
    if turning.in_motion is not None:
        check_passes(session, turning.in_motion)
    calibration = calibrate(session, campaign, correction, lambda tables: store(Compensation(tables)), listener)
    turn = turn_loop(session, campaign, calibration.tables, store, listener, turning=turning)
    if turning.in_motion is None:
        return Loop(calibration, turn)
    moving = turn_in_motion(
        *(session, campaign, turning.in_motion, store, listener), effects=turning.effects, computing=turning.computing
    )
    return Loop(calibration, turn, moving)


def turn_loop(
    session: AxisSession,
    campaign: Campaign,
    tables: TableSet,
    store: Store,
    listener: Listener = silent,
    *,
    turning: Turning | None = None,
) -> Turn:
    """Explores, diagnoses, extends, and explores again, on a prepared session with a compensation in force.

    The whole machine is fitted (measured - command), so that the new compensation replaces the old one. It is put into
    force only when the diagnosis recommends it, that is, not where it would make left-out runs worse, and stays there only where the
    axis then measures no worse than before. Raises CorrectionBoundError for one beyond the axis's bound, before it is stored.
    """
    how = turning or Turning()
    old = session.compensation or Compensation(tables)
    runs = [how.plan or plan_runs(session, how.exploration, seed) for seed in (1, 2)]
    before = explore(session, campaign, "before", runs[0], listener)
    follow, rows, further = decide(session, campaign, before, how, listener)
    correction = correction_of(session, follow.diagnosis, rows, effects=how.effects, computing=how.computing)
    extended = old
    if correction.recommended:
        extended = bounded(session, correction.extended, tables, rows)
        store(extended)
    session.compensation = extended
    after = explore(session, campaign, "after", runs[1], listener)
    turn = Turn(before, follow, extended, after, rows, further)
    return turn if extended is old else proven(session, turn, old, store, listener)


def proven(session: AxisSession, turn: Turn, old: Compensation, store: Store, listener: Listener) -> Turn:
    """The turn, with the old compensation in force and stored again where the axis measured worse with the extended one."""
    before_um, after_um = (Figures.of(rows.error_um).rms_um for rows in (turn.before, turn.after))
    if measured_no_worse(before_um, after_um, turn.diagnosis.noise.within_run_um):
        return turn
    store(old)
    session.compensation = old
    worse = f"{after_um:.3g} µm RMS with the extended correction, {before_um:.3g} µm before"
    listener(Event("diagnose", f"{worse}: it is withdrawn, and the one before is in force again", warning=True))
    return replace(turn, extended=old, withdrawn=True)


def measured_no_worse(before_um: float, after_um: float, noise_um: float) -> bool:
    """Whether an axis measured no worse than before, or within the noise; RMS each, µm."""
    return after_um <= max(before_um, 2 * noise_um)


def turn_in_motion(
    session: AxisSession,
    campaign: Campaign,
    how: InMotion,
    store: Store,
    listener: Listener = silent,
    *,
    effects: Sequence[Effect] = ALL,
    computing: Computing = at_once,
) -> Turn:
    """The same with passes at feed, for effects that no campaign at rest shows; with a compensation in force.

    Rows in motion are few and determine the table badly, so the compensation in force is the declared model, and only
    missing effects are added. Raises InputError without a compensation in force, and as `turn_loop` and `dated`.
    """
    compensation = session.compensation
    if compensation is None:
        raise InputError("no compensation is in force; expected that of a calibration")
    how, latency = dated(session, campaign, how, listener)
    passes = [plan_passes(session, how, seed) for seed in (1, 2)]
    before = measure_in_motion(session, campaign, "motion-before", passes[0], how=how, listener=listener)
    listener(Event("diagnose"))
    declared = model_of(compensation)
    follow = unasked(computing(session, partial(diagnosed, before, declared, effects, means=means_of(session))))
    extended = compensation
    correction = correction_of(
        session, follow.diagnosis, before, declared=declared, effects=effects, computing=computing
    )
    if correction.recommended:
        extended = bounded(session, correction.extended, compensation.tables, before)
        store(extended)
    session.compensation = extended
    after = measure_in_motion(session, campaign, "motion-after", passes[1], how=how, listener=listener)
    turn = Turn(before, follow, extended, after, before, latency=latency)
    return turn if extended is compensation else proven(session, turn, compensation, store, listener)


def unasked(follow: FollowUp) -> FollowUp:
    """The verdict with its rivals, where no further measurement was asked for."""
    return replace(follow, finding=None, prospect=None)


def correction_of(
    session: AxisSession,
    diagnosis: Diagnosis,
    rows: Records,
    *,
    declared: Model | None = None,
    effects: Sequence[Effect],
    computing: Computing,
) -> Diagnosis:
    """The diagnosis whose extended model goes into force: that of the verdict itself.

    Where an effect of the verdict reads a column that is not known when a set-point is issued, it is a diagnosis of the other columns;
    the verdict stays that of all.
    """
    known = issuable_columns(session)
    if all(name in known for term in diagnosis.extended.terms for name in term.needs):
        return diagnosis
    return computing(session, partial(diagnose, issuable(session, rows), declared, effects=effects))


def decide(
    session: AxisSession, campaign: Campaign, before: Records, how: Turning, listener: Listener
) -> tuple[FollowUp, Records, tuple[PlannedRun, ...]]:
    """Diagnoses; while a run can separate remaining causes, makes the run and diagnoses all rows together.

    Rows of unlike campaigns weigh differently on every cause, so a new search over all of them could change its result
    without reason. The question of a run is therefore decided first, by the weights of just the causes it was to
    separate; rejected causes are excluded from the next search.
    """
    parts = [before]
    means = means_of(session)
    effects = tuple(how.effects)
    computing = partial(how.computing, session)
    further: list[PlannedRun] = []
    while True:
        listener(Event("diagnose"))
        rows = joined(parts) if further else parts[0]
        refused = [run.name for run in further]
        examining = partial(diagnosed, rows, None, effects, means=means, made=refused, seed=len(further))
        follow = asked = computing(examining)
        if how.most_further == 0:
            return unasked(follow), rows, ()
        weighing = partial(follow_up, follow.diagnosis, rows, None, means, effects=effects, seed=len(further))
        run = asked.run if len(further) < how.most_further and _in_doubt(follow.diagnosis) else None
        while run is not None and run.person and not (how.consent is not None and how.consent(run)):
            refused.append(run.name)
            asked = computing(partial(weighing, made=refused, persons=how.consent is not None))
            run = asked.run
        if run is None:
            return follow, rows, tuple(further)
        further.append(run)
        listener(Event("diagnose", f"next measurement: {run.describe()}"))
        measured = explore(session, campaign, f"next-{len(further)}", runs_of(run.points), listener)
        parts.append(measured)
        gone = computing(partial(ruled_out, asked, joined(parts), effects=effects))
        effects = tuple(effect for effect in effects if effect.id not in gone)


def _in_doubt(diagnosis: Diagnosis) -> bool:
    """Whether the largest part of the error could have another cause.

    A small further finding in doubt does not justify a run, since rows of another kind affect everything fitted to all
    of them together.
    """
    return bool(diagnosis.findings) and diagnosis.findings[0].confidence < DECIDED
