"""The loop: calibrate, explore with the correction in force, diagnose what is left, add the missing effect, explore again.

Before and after are both measured, in campaigns of the same kind at other targets; nothing is reported from rows that were fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.axis import CorrectionConfig
from hil.compensation import Compensation
from hil.diagnosis import Diagnosis, diagnose
from hil.journal import Campaign
from hil.procedures.calibrate import Calibration, calibrate
from hil.procedures.events import Event, Listener, silent
from hil.procedures.explore import Exploration, explore, plan_runs
from hil.procedures.extend import compensation_of
from hil.procedures.session import AxisSession
from hil.records import REQUIRED, Records
from hil.tables import TableSet

Store = Callable[[Compensation], None]


@dataclass(frozen=True)
class Turn:
    """One turn of the loop.

    before: explored with the old compensation in force; after: explored anew with the extended one
    """

    before: Records
    diagnosis: Diagnosis
    extended: Compensation
    after: Records


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
) -> Loop:
    """Calibrate and turn the loop once, on a prepared session; leaves the extended compensation in force and stored."""
    calibration = calibrate(session, campaign, correction, lambda tables: store(Compensation(tables)), listener)
    return Loop(calibration, turn_loop(session, campaign, calibration.tables, store, listener, how=how))


def turn_loop(
    session: AxisSession,
    campaign: Campaign,
    tables: TableSet,
    store: Store,
    listener: Listener = silent,
    *,
    how: Exploration | None = None,
) -> Turn:
    """Explore, diagnose, extend, explore again, on a prepared session with a compensation in force.

    What is fitted is the whole machine (measured - command), so that the new compensation replaces the old one. It is put into
    force only when the diagnosis recommends it: not where it would make runs it has not seen worse.
    """
    how = how or Exploration()
    before = explore(session, campaign, "before", plan_runs(session, how, seed=1), listener)
    listener(Event("diagnose"))
    diagnosis = diagnose(_issuable(session, before))
    extended = session.compensation or Compensation(tables)
    if diagnosis.recommended:
        extended = compensation_of(diagnosis.extended, tables)
        store(extended)
    session.compensation = extended
    after = explore(session, campaign, "after", plan_runs(session, how, seed=2), listener)
    return Turn(before, diagnosis, extended, after)


def _issuable(session: AxisSession, records: Records) -> Records:
    """The records without what is only known after a motion (motor position and torque at the capture).

    An effect that reads such a column could be fitted, and never be put into force.
    """
    known = {*session.known(), *REQUIRED, "command_mm", "since_reversal_mm", "stroke_mm"}
    return Records.of({name: values for name, values in records.columns.items() if name in known})
