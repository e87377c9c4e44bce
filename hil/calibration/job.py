"""Calibration and verification of an axis (system A) as jobs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hil.app.jobs.figures import error_figures
from hil.app.jobs.job import Job, Workplace, tell_unchecked
from hil.app.jobs.plan import Plan, Write, measuring_plan
from hil.app.jobs.zero_statement import NO_STATEMENT, ZeroStatement
from hil.axis.axis_file import AxisConfig
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.verify import Verification, verify
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore, compensation_in_force
from hil.correction.tables import SingleTable
from hil.figures.history import purpose_of_replay
from hil.machine.events import Listener, silent
from hil.machine.measure import bidirectional_steps, other_targets
from hil.machine.wiring import Machine
from hil.records.journal import Campaign

CALIBRATE, VERIFY, UNCORRECTED = "calibrate", "verify", "uncorrected"


# -- calibrate -----------------------------------------------------------------------------------------------------------
def calibration_plan(axis: AxisConfig) -> Plan:
    """The moves and writes of a calibration: the uncorrected axis, and at least one proof of the tables."""
    steps = bidirectional_steps(axis.measurement.targets_mm, axis.measurement.runs)
    writes = [Write("rows", str(axis.store.directory)), Write("tables", str(axis.tables_path))]
    return measuring_plan(axis, [*steps, *steps], writes, locked=True)


def run_calibration(
    machine: Machine,
    store: SealedStore | None,
    listener: Listener = silent,
    *,
    straightness: SingleTable | None = None,
    resume: bool = False,
    recording: str = "",
) -> Calibration:
    """Prepares and calibrates; each set of tables is sealed and stored once it is proven.

    recording: file name of a replayed recording, "" for a real machine; store: None for a recording, whose tables are
    not stored
    Raises what `calibrate` and preparing the session raise.
    """
    axis = machine.axis
    purpose = axis.purpose(CALIBRATE)
    campaign = Campaign.numbered(axis.store.directory, purpose_of_replay(purpose, recording), resume=resume)
    tell_unchecked(campaign, listener)
    machine.session.prepare(campaign.directory)
    store_tables = store.save_tables if store is not None else lambda _tables: None
    result = calibrate(machine.session, campaign, axis.correction, store_tables, listener, straightness=straightness)
    campaign.finish()
    return result


def calibration_job(axis: AxisConfig, *, resume: bool = False, zero: ZeroStatement = NO_STATEMENT) -> Job:
    """Job that returns a Calibration. Raises InputError for a new zero in a resumed campaign."""
    zero.check(resume=resume)

    def work(place: Workplace) -> Calibration:
        machine = place.machine()
        with zero.applied(machine.session):
            return run_calibration(machine, place.opened_store(), place.listener, resume=resume)

    return Job(CALIBRATE, zero.in_plan(calibration_plan(axis)), work)


def summarise(axis: AxisConfig, result: Calibration) -> dict[str, Any]:
    """The result of a calibration as plain values."""
    return {
        "axis": axis.name,
        "before": error_figures(result.before),
        "rounds": [
            {
                **error_figures(one.records),
                "tables": one.tables.digest(),
                "outside": [vars(section) for section in one.outside],
            }
            for one in result.rounds
        ],
        "inside": result.inside,
        "tables": result.tables.to_dict(),
    }


# -- verify --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Verified:
    """A verification, and the compensation that was in force, None for none."""

    compensation: Compensation | None
    result: Verification


def verification_plan(axis: AxisConfig, seed: int) -> Plan:
    """The moves and writes of a verification."""
    steps = bidirectional_steps(other_targets(axis.measurement, seed), axis.measurement.runs)
    return measuring_plan(axis, steps, [Write("rows", str(axis.store.directory))])


def run_verification(
    machine: Machine,
    compensation: Compensation | None,
    listener: Listener = silent,
    *,
    seed: int = 1,
    resume: bool = False,
    recording: str = "",
) -> Verification:
    """Prepares the session, puts the compensation into force, measures at other targets.

    compensation: None for the uncorrected machine; recording: file name of a replayed recording, "" for a real machine
    Raises what preparing and measuring raise.
    """
    axis = machine.axis
    purpose = {**axis.purpose(UNCORRECTED if compensation is None else VERIFY), "seed": seed}
    purpose |= {} if compensation is None else compensation_in_force(compensation)
    campaign = Campaign.numbered(axis.store.directory, purpose_of_replay(purpose, recording), resume=resume)
    tell_unchecked(campaign, listener)
    machine.session.prepare(campaign.directory, compensation)
    machine.session.compensation = compensation
    name = UNCORRECTED if compensation is None else VERIFY
    result = verify(machine.session, campaign, name, axis.correction.band, listener, seed=seed)
    campaign.finish()
    return result


def verification_job(
    axis: AxisConfig, *, corrected: bool = True, seed: int = 1, resume: bool = False, zero: ZeroStatement = NO_STATEMENT
) -> Job:
    """Job that returns a Verified, with the compensation in the axis's store, or without any."""

    def work(place: Workplace) -> Verified:
        compensation = place.opened_store().load() if corrected else None
        if compensation is not None and (warning := place.opened_store().warning()) is not None:
            place.tell(warning)
        machine = place.machine()
        with zero.applied(machine.session):
            result = run_verification(machine, compensation, place.listener, seed=seed, resume=resume)
        return Verified(compensation, result)

    plan = zero.in_plan(verification_plan(axis, seed))
    return Job(VERIFY if corrected else UNCORRECTED, plan, work)
