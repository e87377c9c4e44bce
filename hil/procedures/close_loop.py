"""The loop: calibrate, explore with the correction in force, diagnose what is left, add the missing effect, explore again.

Where two causes could have made what is left, the measurement that tells them apart best for its time is made next, and the diagnosis
is made anew from all rows together. It stops when one cause is left, when no run that can be made here separates them, or when what is
left is within the noise or unexplained.

Before and after are both measured, in campaigns of the same kind at other targets; nothing is reported from rows that were fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hil.axis import CorrectionConfig
from hil.compensation import Compensation
from hil.diagnosis import Diagnosis, diagnose
from hil.diagnosis.follow_up import FollowUp, follow_up
from hil.diagnosis.hypotheses import joined
from hil.diagnosis.planned_run import PlannedRun
from hil.effects import ALL, Effect
from hil.journal import Campaign
from hil.procedures.calibrate import Calibration, calibrate
from hil.procedures.events import Event, Listener, silent
from hil.procedures.explore import Exploration, Run, explore, plan_runs
from hil.procedures.extend import compensation_of
from hil.procedures.next_run import means_of, measure_run
from hil.procedures.session import AxisSession
from hil.records import REQUIRED, Records
from hil.tables import TableSet

Store = Callable[[Compensation], None]
Consent = Callable[[PlannedRun], bool]
"""Asked before a run that needs a person: whether somebody is there and does it."""

MOST_RUNS = 2
"""Further measurements asked for in one turn."""


@dataclass(frozen=True)
class Turn:
    """One turn of the loop.

    before: explored with the old compensation in force; after: explored anew with the extended one
    further: runs that were made to tell causes apart; follow: the last diagnosis with the rivals left and what would separate them
    """

    before: Records
    diagnosis: Diagnosis
    extended: Compensation
    after: Records
    further: tuple[PlannedRun, ...] = ()
    follow: FollowUp | None = None


@dataclass(frozen=True)
class Loop:
    """A calibration and the turn after it."""

    calibration: Calibration
    turn: Turn


def close_loop(
    session: AxisSession,
    campaign: Campaign,
    correction: CorrectionConfig,
    store: Store,
    listener: Listener = silent,
    *,
    how: Exploration | None = None,
    consent: Consent | None = None,
    plan: Sequence[Run] | None = None,
    effects: Sequence[Effect] = ALL,
) -> Loop:
    """Calibrate and turn the loop once, on a prepared session; leaves the extended compensation in force and stored."""
    calibration = calibrate(session, campaign, correction, lambda tables: store(Compensation(tables)), listener)
    tables = calibration.tables
    turn = turn_loop(session, campaign, tables, store, listener, how=how, consent=consent, plan=plan, effects=effects)
    return Loop(calibration, turn)


def turn_loop(
    session: AxisSession,
    campaign: Campaign,
    tables: TableSet,
    store: Store,
    listener: Listener = silent,
    *,
    how: Exploration | None = None,
    consent: Consent | None = None,
    plan: Sequence[Run] | None = None,
    effects: Sequence[Effect] = ALL,
) -> Turn:
    """Explore, diagnose, extend, explore again, on a prepared session with a compensation in force.

    consent: asks for a person where a run needs one; without it only runs that the axis makes alone are made
    plan: rows to explore with before and after, instead of those of `how`; effects: the catalogue, and what stands beside it

    What is fitted is the whole machine (measured - command), so that the new compensation replaces the old one. It is put into
    force only when the diagnosis recommends it: not where it would make runs it has not seen worse.
    """
    how = how or Exploration()
    before = explore(session, campaign, "before", plan or plan_runs(session, how, seed=1), listener)
    diagnosis, further, follow = _decide(session, campaign, before, consent, listener, effects=effects)
    extended = session.compensation or Compensation(tables)
    if diagnosis.recommended:
        extended = compensation_of(diagnosis.extended, tables)
        store(extended)
    session.compensation = extended
    after = explore(session, campaign, "after", plan or plan_runs(session, how, seed=2), listener)
    return Turn(before, diagnosis, extended, after, further, follow)


def _decide(
    session: AxisSession,
    campaign: Campaign,
    before: Records,
    consent: Consent | None,
    listener: Listener,
    *,
    effects: Sequence[Effect],
) -> tuple[Diagnosis, tuple[PlannedRun, ...], FollowUp]:
    """Diagnose; as long as causes are left that a run can tell apart, make the run and diagnose all rows together."""
    parts = [_issuable(session, before)]
    means = means_of(session)
    further: list[PlannedRun] = []
    while True:
        listener(Event("diagnose"))
        rows = joined(parts)
        diagnosis = diagnose(rows, effects=effects)
        refused = [run.name for run in further]
        follow = follow_up(diagnosis, rows, None, means, effects=effects, made=refused, seed=len(further))
        run = follow.run if len(further) < MOST_RUNS else None
        while run is not None and run.person and not (consent is not None and consent(run)):
            refused.append(run.name)
            run = follow_up(
                diagnosis,
                rows,
                None,
                means,
                effects=effects,
                persons=consent is not None,
                made=refused,
                seed=len(further),
            ).run
        if run is None:
            return follow.diagnosis, tuple(further), follow
        further.append(run)
        listener(Event("diagnose", f"next measurement: {run.describe()}"))
        measured = measure_run(session, campaign, f"next-{len(further)}", run, listener)
        parts.append(_issuable(session, measured))


def _issuable(session: AxisSession, records: Records) -> Records:
    """The records without what is only known after a motion (motor position and torque at the capture).

    An effect that reads such a column could be fitted, and never be put into force.
    """
    known = {*session.known(), *REQUIRED, "command_mm", "since_reversal_mm", "stroke_mm"}
    return Records.of({name: values for name, values in records.columns.items() if name in known})
