"""Lost motion after a reversal by the axis's instrument (system C) as jobs: measured, fitted and proven; put into force
on request.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.errors import StateError
from hil.axis.axis_file import AxisConfig
from hil.axis.identity import drive_in_words
from hil.axis.lost_motion import LostMotionConfig, default_lost_motion
from hil.correction.compensation import Compensation
from hil.correction.rise import Rise, Shape
from hil.correction.store import SealedStore, bound_tables, compensation_in_force
from hil.desk.job import Job, Workplace, tell_unchecked
from hil.desk.plan import Move, Plan, Write, going_on
from hil.desk.zero_statement import NO_STATEMENT, ZeroStatement
from hil.figures.iso230 import MEASURED_AT_A_REVERSAL, OTHER_REVERSAL_FIGURES
from hil.lost_motion.estimate import NOT_SEPARATELY_DETERMINED, separately_determined
from hil.lost_motion.procedure import (
    COVERAGE,
    LostMotionResult,
    NoLostMotionError,
    measure_lost_motion,
    proof_steps,
    rms,
    stroke_steps,
    verdict,
)
from hil.lost_motion.published import BesidePublished, beside_published
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
@dataclass(frozen=True)
class MeasuredLostMotion:
    """A measurement. present: the compensation in force before, None for none; kept: the folder with its rows."""

    how: LostMotionConfig
    result: LostMotionResult
    present: Compensation | None
    kept: Path


def measuring_plan(axis: AxisConfig, how: LostMotionConfig, seed: int = 1, *, store: bool = False) -> Plan:
    """The moves and writes of a measurement."""
    velocity = axis.measurement.velocity_mm_s
    moves = [Move(what, how.low_mm, how.high_mm, velocity) for what in ("strokes", "proof")]
    writes = [Write("rows", str(axis.store.directory))]
    writes += [Write("lost_motion", str(axis.tables_path))] if store else []
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
    asked: Shape | Rise | None = None,
    resume: bool = False,
    computing: Computing = at_once,
) -> MeasuredLostMotion:
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
    measured = MeasuredLostMotion(how, result, present, campaign.directory)
    campaign.write(RESULT, (json.dumps(form(axis, measured, stored=False), indent=2) + "\n").encode())
    campaign.finish()
    return measured


def _decides_rows(how: LostMotionConfig) -> dict[str, Any]:
    """What of the section decides which rows are measured: the axis moves from place to place, not in streams."""
    return {name: value for name, value in asdict(how).items() if name != "travel_by"}


def measuring_job(
    axis: AxisConfig, how: LostMotionConfig, *, seed: int = 1, resume: bool = False, zero: ZeroStatement = NO_STATEMENT
) -> Job:
    """For the desk: returns a MeasuredLostMotion, beside what is stored as far as its password was given."""

    def work(place: Workplace) -> MeasuredLostMotion:
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
    return Job(MEASURE, plan, work, reached=lambda measured: measured.result.good or measured.result.needless)


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
def store_measured(store: SealedStore, measured: MeasuredLostMotion) -> None:
    """Puts a measurement into force. Raises StateError for one whose proof failed or that was measured with another
    compensation.
    """
    if not measured.result.good:
        raise StateError("the correction is not proven to be an improvement: it is not stored")
    now, then = store.stored(), measured.present
    if _in_force(now) != _in_force(then):
        raise StateError(
            "it was not measured with what is stored now: measure again, with the tables' reading password"
        )
    store.save(measured.result.compensation)


def _in_force(compensation: Compensation | None) -> dict[str, Any] | None:
    return None if compensation is None else compensation_in_force(compensation)


def store_job(axis: AxisConfig, measured: MeasuredLostMotion) -> Job:
    """Job that stores a measurement and returns it."""

    def work(place: Workplace) -> MeasuredLostMotion:
        store_measured(place.opened_store(), measured)
        return measured

    writes = (Write("lost_motion", str(axis.tables_path)),)
    return Job(STORE, Plan(axis.name, axis.drive.backend, writes=writes, locked=True), work)


# -- what came of it -------------------------------------------------------------------------------------------------------
def facts(measured: MeasuredLostMotion, stored: str) -> dict[str, str]:
    """The result in a few lines, as label -> text. stored: where, or "nothing"."""
    result, present = measured.result, measured.present
    found, proof = result.estimate, result.proof
    parameters = {name.replace("_", " "): str(each) for name, each in found.determined.items()}
    parameters |= {} if separately_determined(found.parameters) else {"single amounts": NOT_SEPARATELY_DETERMINED}
    before = (
        "nothing" if present is None else "the tables" if present.rise is None else "the tables and an earlier rise"
    )
    return {
        "lost motion": f"{found.amount_um:.2f} µm, rising as {found.rise.shape.name}",
        **({"shape": found.choice, "published form": beside_proof(result).sentence} if found.contenders else {}),
        **{f"  {name}": text + (" (k = 2)" if "±" in text else "") for name, text in parameters.items()},
        "noise of a reading": f"{result.stretch.noise_um:.3f} µm",
        "proof, before": f"{rms(proof.before_um):.2f} µm RMS, {abs(proof.before_um).max():.2f} at worst, with {before} in force",
        "proof, after": f"{rms(proof.after_um):.2f} µm RMS, {abs(proof.after_um).max():.2f} at worst",
        "gain": f"{proof.improvement_um.value:.3f} ± {COVERAGE * proof.improvement_um.std:.3f} µm RMS (k = 2)",
        "over-compensated": f"{proof.over_um:.2f} µm at worst, {100.0 * proof.over_um / found.amount_um:.1f} % of the lost motion",
        "stored": stored,
        "rows": str(measured.kept),
        "what it is": f"{MEASURED_AT_A_REVERSAL['lost_motion']} ({OTHER_REVERSAL_FIGURES})",
    }


def beside_proof(result: LostMotionResult) -> BesidePublished:
    """The document's form beside the running one, along the moves of the proof."""
    return beside_published(result.estimate, result.proof.after.target_mm.tolist())


def sentences(measured: MeasuredLostMotion) -> Sequence[str]:
    """Sentences on what is wrong with the result; empty for a good one."""
    return verdict(measured.result)


def report_html(axis: AxisConfig, measured: MeasuredLostMotion, stored: str) -> str:
    """The report as an HTML page."""
    from hil.lost_motion.report import LostMotionReport, render_lost_motion  # noqa: PLC0415  (plots are slow to import)

    how, result = measured.how, measured.result
    identity = {
        "Axis": axis.name,
        "Drive": drive_in_words(axis),
        "Measured": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "Strokes": f"{how.stroke_mm:g} mm around {how.at_mm:g} mm, {how.runs} to and fro, {how.places} places after each turning",
        "Proof": f"{how.proof_moves} moves of all lengths there, before and after",
    }
    title = f"Lost motion of axis {axis.name} after a reversal"
    report = LostMotionReport(
        title, result.estimate, result.proof, verdict(result), identity, facts(measured, stored), beside_proof(result)
    )
    return render_lost_motion(report)


def form(axis: AxisConfig, measured: MeasuredLostMotion, *, stored: bool) -> dict[str, Any]:
    """The machine-readable result."""
    result, proof = measured.result, measured.result.proof
    return {
        "axis": axis.name,
        "good": result.good,
        "stored": stored,
        "needless": result.needless,
        **result.estimate.to_json(),
        "noise_um": result.stretch.noise_um,
        "reversals": [
            {"direction": one.direction, "travel_mm": one.travel_mm.tolist(), "error_um": one.error_um.tolist()}
            for one in result.estimate.reversals
        ],
        "proof": {
            "moves": measured.how.proof_moves,
            "before": {"rms_um": rms(proof.before_um), "peak_um": float(abs(proof.before_um).max())},
            "after": {"rms_um": rms(proof.after_um), "peak_um": float(abs(proof.after_um).max())},
            "over_compensation_um": proof.over_um,
            "improvement_um": {"value": proof.improvement_um.value, "std": proof.improvement_um.std},
        },
        "published_form": beside_proof(result).to_json(),
        "verdict": list(verdict(result)),
    }
