"""The loop: calibrate, explore with the correction in force, diagnose what is left, add the missing effect, explore again.

Where two causes could have made what is left, the measurement that tells them apart best for its time is made next, and the diagnosis
is made anew from all rows together. It stops when one cause is left, when no run that can be made here separates them, or when what is
left is within the noise or unexplained.

Before and after are both measured, in campaigns of the same kind at other targets; nothing is reported from rows that were fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

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
from hil.procedures.extend import compensation_of, issuable
from hil.procedures.next_run import means_of, measure_run
from hil.procedures.session import AxisSession
from hil.records import Records
from hil.tables import TableSet

Store = Callable[[Compensation], None]
Consent = Callable[[PlannedRun], bool]
"""Asked before a run that needs a person: whether somebody is there and does it."""

MOST_RUNS = 2
"""Further measurements asked for in one turn."""
SURE = 0.95
"""A name of such a confidence stands; below it the set of rivals does."""


@dataclass(frozen=True)
class Turn:
    """One turn of the loop.

    before: explored with the old compensation in force; after: explored anew with the extended one
    diagnosed: the rows that the diagnosis is of, those before and those of the further runs
    further: runs that were made to tell causes apart; follow: the last diagnosis with the rivals left and what would separate
    them, None where rivals were not looked into
    """

    before: Records
    diagnosis: Diagnosis
    extended: Compensation
    after: Records
    diagnosed: Records
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
    most_further: int = MOST_RUNS,
    effects: Sequence[Effect] = ALL,
) -> Loop:
    """Calibrate and turn the loop once, on a prepared session; leaves the extended compensation in force and stored."""
    calibration = calibrate(session, campaign, correction, lambda tables: store(Compensation(tables)), listener)
    tables = calibration.tables
    turn = turn_loop(
        session,
        campaign,
        tables,
        store,
        listener,
        how=how,
        consent=consent,
        plan=plan,
        most_further=most_further,
        effects=effects,
    )
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
    most_further: int = MOST_RUNS,
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
    asking = Asking(consent, most_further, tuple(effects))
    diagnosis, rows, further, follow = _decide(session, campaign, before, asking, listener)
    extended = session.compensation or Compensation(tables)
    if diagnosis.recommended:
        extended = compensation_of(diagnosis.extended, tables)
        store(extended)
    session.compensation = extended
    after = explore(session, campaign, "after", plan or plan_runs(session, how, seed=2), listener)
    return Turn(before, diagnosis, extended, after, rows, further, follow)


@dataclass(frozen=True)
class Asking:
    """Who is asked for a run that needs a person, how many runs may be made, and which effects are looked for."""

    consent: Consent | None
    most: int
    effects: tuple[Effect, ...]


def _decide(
    session: AxisSession, campaign: Campaign, before: Records, asking: Asking, listener: Listener
) -> tuple[Diagnosis, Records, tuple[PlannedRun, ...], FollowUp | None]:
    """Diagnose; as long as causes are left that a run can tell apart, make the run and diagnose all rows together."""
    parts = [issuable(session, before)]
    means = means_of(session)
    further: list[PlannedRun] = []
    while True:
        listener(Event("diagnose"))
        rows = joined(parts) if further else parts[0]
        diagnosis = diagnose(rows, effects=asking.effects)
        if asking.most == 0:
            return diagnosis, rows, (), None
        refused = [run.name for run in further]
        weighing = partial(follow_up, diagnosis, rows, None, means, effects=asking.effects, seed=len(further))
        follow = weighing(made=refused)
        run = follow.run if len(further) < asking.most and _in_doubt(diagnosis) else None
        while run is not None and run.person and not (asking.consent is not None and asking.consent(run)):
            refused.append(run.name)
            run = weighing(made=refused, persons=asking.consent is not None).run
        if run is None:
            return follow.diagnosis, rows, tuple(further), follow
        further.append(run)
        listener(Event("diagnose", f"next measurement: {run.describe()}"))
        measured = measure_run(session, campaign, f"next-{len(further)}", run, listener)
        parts.append(issuable(session, measured))


def _in_doubt(diagnosis: Diagnosis) -> bool:
    """Whether what makes most of the error could be something else.

    A small companion in doubt is not worth a run: rows of another kind weigh on everything that is fitted to all of them together.
    """
    return bool(diagnosis.findings) and diagnosis.findings[0].confidence < SURE
