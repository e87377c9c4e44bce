"""Lost motion after a reversal by the axis's instrument (system C) as jobs: measured, fitted and proven; put into force
on request.
"""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

from drivers.errors import StateError
from hil.axis.axis_file import AxisConfig
from hil.axis.lost_motion import LostMotionConfig, default_lost_motion
from hil.correction.compensation import Compensation
from hil.correction.rise import Rise, RiseShape
from hil.correction.store import SealedStore, bound_tables, compensation_in_force
from hil.desk.job import Job, Workplace, tell_unchecked
from hil.desk.plan import Move, Plan, PlannedWrite, going_on
from hil.desk.zero_statement import NO_STATEMENT, ZeroStatement
from hil.lost_motion.measured import ReversalResult
from hil.lost_motion.procedure import NoLostMotionError, measure_lost_motion, proof_steps, stroke_steps
from hil.machine.computing import Computing, at_once
from hil.machine.events import Event, Listener, Point, silent
from hil.machine.machine import Machine
from hil.records.journal import Campaign

MEASURE, STORE = "lost motion", "lost motion store"
CAMPAIGN = "lost-motion"
RESULT = "result.json"
"""File of a measurement's result in its folder, for a screen that is started later and for the index of a fleet."""


def lost_motion_config(axis: AxisConfig) -> LostMotionConfig:
    """The axis file's [lost_motion] section, or the defaults. Raises InputError."""
    return axis.lost_motion or default_lost_motion(axis.path, axis.limits, axis.measurement.targets_mm)


# -- measure -------------------------------------------------------------------------------------------------------------
def measuring_plan(axis: AxisConfig, how: LostMotionConfig, seed: int = 1, *, store: bool = False) -> Plan:
    """The moves and writes of a measurement."""
    velocity = axis.measurement.velocity_mm_s
    moves = [Move(what, how.low_mm, how.high_mm, velocity) for what in ("strokes", "proof")]
    writes = [PlannedWrite("rows", str(axis.store.directory))]
    writes += [PlannedWrite("lost_motion", str(axis.tables_path))] if store else []
    return Plan(
        axis.name,
        axis.drive.backend,
        tuple(moves),
        tuple(writes),
        axis.measurement.home,
        axis.measurement.reference_mm,
        len(stroke_steps(how)) + 2 * len(proof_steps(how, seed)),
        axis.measurement.dwell_s + axis.measurement.reading_s,
        locked=store,
    )


def run_lost_motion(
    machine: Machine,
    how: LostMotionConfig,
    present: Compensation | None,
    listener: Listener = silent,
    *,
    seed: int = 1,
    asked: RiseShape | Rise | None = None,
    resume: bool = False,
    computing: Computing = at_once,
) -> ReversalResult:
    """Prepares, measures, fits and proves; stores nothing. present: the compensation in force; asked: as `estimate` has it;
    computing: how the fit is run.

    Raises what `measure_lost_motion` raises.
    """
    axis = machine.axis
    purpose = {**axis.purpose(CAMPAIGN), "how": _decides_rows(how), "seed": seed}
    if asked is not None:  # the proof is of that one
        purpose |= {"typed": asked.to_json()} if isinstance(asked, Rise) else {"shape": asked.name}
    purpose |= {} if present is None else compensation_in_force(present)
    campaign = Campaign.numbered(axis.store.directory, purpose, resume=resume)
    tell_unchecked(campaign, listener)
    machine.session.prepare(campaign.directory, present)
    try:
        result = measure_lost_motion(
            machine.session, campaign, how, present, listener, seed=seed, asked=asked, computing=computing
        )
    except NoLostMotionError:
        campaign.finish()  # it was measured as a whole
        raise
    measured = ReversalResult(axis, campaign.directory, how, result, present)
    campaign.write(RESULT, (json.dumps(measured.form(), indent=2) + "\n").encode())
    campaign.finish()
    return measured


def _decides_rows(how: LostMotionConfig) -> dict[str, Any]:
    """What of the section decides which rows are measured: the axis moves from place to place, not in streams."""
    return {name: value for name, value in asdict(how).items() if name != "travel_by"}


def measuring_job(
    axis: AxisConfig, how: LostMotionConfig, *, seed: int = 1, resume: bool = False, zero: ZeroStatement = NO_STATEMENT
) -> Job:
    """For the desk: returns a ReversalResult, beside what is stored as far as its password was given."""

    def work(place: Workplace) -> ReversalResult:
        present = None if place.store is None else place.store.stored()
        if present is None and bound_tables(axis) is not None:
            place.tell(SEALED)
        machine = place.machine()
        with zero.applied(machine.session):
            measured = run_lost_motion(
                machine, how, present, _named(place.listener), seed=seed, resume=resume, computing=place.computing
            )
        return measured

    plan = zero.in_plan(measuring_plan(axis, how, seed))
    if resume:
        plan = going_on(plan, axis.store.directory, CAMPAIGN)
    return Job(MEASURE, plan, work, reached=lambda measured: measured.good)


def _named(listener: Listener) -> Listener:
    """Prefixes the stages and series of the proof, since other procedures use the same names."""

    def tell(event: Event) -> None:
        found = event.found
        if event.stage in PROVING:
            if isinstance(found, Point):
                found = replace(found, series=f"{PROOF}{found.series}")
            event = replace(event, stage=f"{PROOF}{event.stage}", found=found)
        listener(event)

    return tell


PROVING, PROOF = ("before", "after"), "proof "
SEALED = (
    "the stored tables are sealed: what is measured now cannot be stored beside them without their reading password"
)


# -- store ---------------------------------------------------------------------------------------------------------------
def store_measured(store: SealedStore, measured: ReversalResult) -> None:
    """Puts a measurement into force. Raises StateError for one whose proof failed or that was measured with another
    compensation.
    """
    if not measured.raw.good:
        raise StateError("the correction is not proven to be an improvement: it is not stored")
    now, then = store.stored(), measured.present
    if _in_force(now) != _in_force(then):
        raise StateError(
            "it was not measured with what is stored now: measure again, with the tables' reading password"
        )
    store.save(measured.raw.compensation)


def _in_force(compensation: Compensation | None) -> dict[str, Any] | None:
    return None if compensation is None else compensation_in_force(compensation)


def store_job(axis: AxisConfig, measured: ReversalResult) -> Job:
    """Job that stores a measurement and returns it as stored."""

    def work(place: Workplace) -> ReversalResult:
        store_measured(place.opened_store(), measured)
        return replace(measured, stored=True)

    writes = (PlannedWrite("lost_motion", str(axis.tables_path)),)
    return Job(STORE, Plan(axis.name, axis.drive.backend, writes=writes, locked=True), work)
