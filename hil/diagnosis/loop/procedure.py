"""The loop: calibrate, explore with the correction in force, diagnose what is left, add the missing effect, explore again.

Where two causes could have made what is left, the measurement that tells them apart best for its time is made next, and the diagnosis
is made anew from all rows together. It stops when one cause is left, when no run that can be made here separates them, or when what is
left is within the noise or unexplained.

What only shows in motion is found in a second turn, of passes at feed, where the drive takes set-points in its cycle.

Before and after are both measured, in campaigns of the same kind at other targets; nothing is reported from rows that were fitted.
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
from hil.calibration.in_motion import InMotion, check_passes, measure_in_motion, plan_passes
from hil.calibration.latency import dated
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, SingleTable, TableSet
from hil.diagnosis import Diagnosis, diagnose
from hil.diagnosis.follow_up import FollowUp, follow_up, ruled_out
from hil.diagnosis.loop.next_run import means_of, measure_run
from hil.diagnosis.next.planned_run import PlannedRun
from hil.diagnosis.verdict.hypotheses import joined
from hil.effects import ALL, Effect
from hil.effects.base import Term
from hil.effects.model import Model, PitchTable
from hil.figures.latency import Latency
from hil.machine.computing import Computing, at_once
from hil.machine.events import Event, Listener, silent
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import REQUIRED, Floats, Records


def compensation_of(model: Model, like: TableSet) -> Compensation:
    """What a fitted model comes to as tables and terms; mode, specified accuracy and straightness stay those of `like`.

    The straightness table of `like` is part of the same command, so its share is taken out of the pitch table.
    """
    nodes = np.array(model.table.positions_mm)
    share = _straightness_share_um(like, nodes)
    pitch = DirectionalTable(
        nodes, -np.array(model.table.forward_um) - share, -np.array(model.table.backward_um) - share
    )
    backlash = SingleTable(nodes, pitch.plus_um - pitch.minus_um)
    return Compensation(replace(like, pitch=pitch, backlash=backlash), model.terms)


def bounded(session: AxisSession, model: Model, like: TableSet, rows: Records) -> Compensation:
    """`compensation_of`, held against the axis's bound: along the axis, and in the rows that the model was fitted to.

    Raises CorrectionBoundError naming the worst place.
    """
    extended, what = compensation_of(model, like), "extended correction not used"
    extended.check(session.steering.bound, what)
    extended.check_rows(session.steering.bound, what, rows.columns)
    return extended


def model_of(compensation: Compensation) -> Model:
    """What a compensation in force comes to as a declared model: the opposite of `compensation_of`.

    A deliberate deviation (specified accuracy) is not an error of the machine and stays out.
    """
    tables = compensation.tables
    nodes = tables.pitch.position_mm
    share = _straightness_share_um(tables, nodes)
    table = PitchTable.of(nodes, -(tables.pitch.plus_um + share), -(tables.pitch.minus_um + share))
    return Model(table, tuple(term for term in compensation.terms if isinstance(term, Term)))


def _straightness_share_um(tables: TableSet, nodes_mm: Floats) -> Floats:
    """What the straightness table adds to the axis's own command at the nodes; nothing where it corrects another axis."""
    if tables.straightness is None or tables.straightness_axis:
        return np.zeros(len(nodes_mm))
    return tables.straightness.at(nodes_mm)


def issuable(session: AxisSession, records: Records) -> Records:
    """The records without what is only known after a motion (motor position and torque at the capture).

    An effect that reads such a column could be fitted, and never be put into force.
    """
    known = {*session.known(), *REQUIRED, "command_mm", "since_reversal_mm", "stroke_mm"}
    return Records.of({name: values for name, values in records.columns.items() if name in known})


Store = Callable[[Compensation], None]
Consent = Callable[[PlannedRun], bool]
"""Asked before a run that needs a person: whether somebody is there and does it."""

MOST_RUNS = 2
"""Further measurements asked for in one turn."""
SURE = 0.95
"""A name of such a confidence stands; below it the set of rivals does."""


@dataclass(frozen=True)
class Turning:
    """How a loop is turned.

    exploration, or instead of it plan: what is measured before and after; consent: asks for a person where a run needs one, without
    it only runs that the axis makes alone are made; most_further: runs to tell causes apart; effects: the catalogue, and what stands
    beside it; in_motion: passes of a second turn, at feed, where they are wanted; computing: how the diagnosis is made
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

    before: explored with the old compensation in force; after: explored anew with the extended one
    diagnosed: the rows that the diagnosis is of, those before and those of the further runs
    further: runs that were made to tell causes apart; follow: the last diagnosis with the rivals left and what would separate
    them, None where rivals were not looked into; latency: of the instrument, where it was measured for this turn
    """

    before: Records
    diagnosis: Diagnosis
    extended: Compensation
    after: Records
    diagnosed: Records
    further: tuple[PlannedRun, ...] = ()
    follow: FollowUp | None = None
    latency: Latency | None = None


@dataclass(frozen=True)
class Loop:
    """A calibration, the turn after it at rest, and that in motion where it was asked for."""

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
    """Calibrate and turn the loop, on a prepared session; leaves the extended compensation in force and stored.

    Raises CapabilityError before anything moves where passes in motion are asked of a drive that takes no set-points in its cycle.
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
    """Explore, diagnose, extend, explore again, on a prepared session with a compensation in force.

    What is fitted is the whole machine (measured - command), so that the new compensation replaces the old one. It is put into
    force only when the diagnosis recommends it: not where it would make runs it has not seen worse. Raises CorrectionBoundError for
    one beyond the axis's bound, before it is stored.
    """
    how = turning or Turning()
    runs = [how.plan or plan_runs(session, how.exploration, seed) for seed in (1, 2)]
    before = explore(session, campaign, "before", runs[0], listener)
    diagnosis, rows, further, follow = _decide(session, campaign, before, how, listener)
    extended = session.compensation or Compensation(tables)
    if diagnosis.recommended:
        extended = bounded(session, diagnosis.extended, tables, rows)
        store(extended)
    session.compensation = extended
    after = explore(session, campaign, "after", runs[1], listener)
    return Turn(before, diagnosis, extended, after, rows, further, follow)


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
    """The same with passes at feed, for what no campaign at rest can see; with a compensation in force.

    Rows in motion are few and say little of the table, so that the compensation in force is what is declared here: only what it lacks
    is added.
    """
    compensation = session.compensation
    if compensation is None:
        raise InputError("no compensation is in force; expected that of a calibration")
    how, latency = dated(session, campaign, how, listener)
    passes = [plan_passes(session, how, seed) for seed in (1, 2)]
    before = measure_in_motion(session, campaign, "motion-before", passes[0], how=how, listener=listener)
    listener(Event("diagnose"))
    rows = issuable(session, before)
    diagnosis = computing(session, partial(diagnose, rows, model_of(compensation), effects=effects))
    extended = compensation
    if diagnosis.recommended:
        extended = bounded(session, diagnosis.extended, compensation.tables, rows)
        store(extended)
    session.compensation = extended
    after = measure_in_motion(session, campaign, "motion-after", passes[1], how=how, listener=listener)
    return Turn(before, diagnosis, extended, after, rows, latency=latency)


def _decide(
    session: AxisSession, campaign: Campaign, before: Records, how: Turning, listener: Listener
) -> tuple[Diagnosis, Records, tuple[PlannedRun, ...], FollowUp | None]:
    """Diagnose; as long as causes are left that a run can tell apart, make the run and diagnose all rows together.

    Rows of unlike campaigns weigh differently on every cause, so a search over all of them anew could change its mind for no good
    reason. What a run was made for is therefore decided first, by the weights of just the causes it was to tell apart; those that lose
    are not looked for again.
    """
    parts = [issuable(session, before)]
    means = means_of(session)
    effects = tuple(how.effects)
    computing = partial(how.computing, session)
    further: list[PlannedRun] = []
    while True:
        listener(Event("diagnose"))
        rows = joined(parts) if further else parts[0]
        diagnosis = computing(partial(diagnose, rows, effects=effects))
        if how.most_further == 0:
            return diagnosis, rows, (), None
        refused = [run.name for run in further]
        weighing = partial(follow_up, diagnosis, rows, None, means, effects=effects, seed=len(further))
        follow = asked = computing(partial(weighing, made=refused))
        run = asked.run if len(further) < how.most_further and _in_doubt(diagnosis) else None
        while run is not None and run.person and not (how.consent is not None and how.consent(run)):
            refused.append(run.name)
            asked = computing(partial(weighing, made=refused, persons=how.consent is not None))
            run = asked.run
        if run is None:
            return follow.diagnosis, rows, tuple(further), follow
        further.append(run)
        listener(Event("diagnose", f"next measurement: {run.describe()}"))
        measured = measure_run(session, campaign, f"next-{len(further)}", run, listener)
        parts.append(issuable(session, measured))
        gone = computing(partial(ruled_out, asked, joined(parts), None, effects=effects))
        effects = tuple(effect for effect in effects if effect.id not in gone)


def _in_doubt(diagnosis: Diagnosis) -> bool:
    """Whether what makes most of the error could be something else.

    A small companion in doubt is not worth a run: rows of another kind weigh on everything that is fitted to all of them together.
    """
    return bool(diagnosis.findings) and diagnosis.findings[0].confidence < SURE
