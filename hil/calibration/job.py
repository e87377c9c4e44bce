"""Calibration and verification of an axis (system A) as jobs."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import CapabilityError, InputError, StateError, UnprovenError
from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.calibration.calibrate import Calibration, as_stored, calibrate
from hil.calibration.spacing import KIND as DENSE
from hil.calibration.spacing import Proposal, dense_steps, propose
from hil.calibration.straightness import StraightnessResult, measure_straightness
from hil.correction.compensation import Compensation
from hil.correction.manual import read_manual_tables
from hil.correction.store import BoundTables, SealedStore, bound_tables, compensation_in_force
from hil.correction.tables import (
    Band,
    DirectionalTable,
    NotJudged,
    OutsideBand,
    SignedSections,
    SingleTable,
    TableMode,
    TableSet,
    judge,
    section_means,
)
from hil.desk.job import Job, Workplace, tell_unchecked
from hil.desk.plan import Move, Plan, PlannedWrite, going_on, measuring_plan
from hil.desk.zero_statement import NO_STATEMENT, ZeroStatement
from hil.figures.error_figures import error_figures
from hil.figures.history import purpose_of_replay
from hil.machine.axes_wiring import connected_across
from hil.machine.events import Event, Listener, silent
from hil.machine.machine import Machine
from hil.machine.measure import bidirectional_steps, measure, other_targets
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.made_with import MadeWith
from hil.records.rows import Floats, Records

CALIBRATE, VERIFY, UNCORRECTED, STRAIGHTNESS = "calibrate", "verify", "uncorrected", "straightness"
MANUAL, ENTER, WITHDRAW = "manual", "enter backlash", "withdraw"


# -- calibrate -----------------------------------------------------------------------------------------------------------
def calibration_plan(axis: AxisConfig) -> Plan:
    """The moves and writes of a calibration: the uncorrected axis, and at least one proof of the tables."""
    steps = bidirectional_steps(axis.measurement.targets_mm, axis.measurement.runs)
    writes = [PlannedWrite("rows", str(axis.store.directory)), PlannedWrite("tables", str(axis.tables_path))]
    return measuring_plan(axis, [*steps, *steps], writes, locked=True)


@dataclass(frozen=True)
class DensePass:
    """The dense pass before a calibration. campaign: to be finished when the calibration is; going_on: whether the calibration of this
    pass is the one to resume."""

    proposal: Proposal
    campaign: Campaign
    going_on: bool


def run_dense_pass(machine: Machine, listener: Listener = silent, *, resume: bool = False) -> DensePass:
    """Prepares, measures the uncorrected axis densely, and proposes the spacing. Raises what `dense_steps` and measuring raise."""
    axis, session = machine.axis, machine.session
    steps, place = dense_steps(axis), axis.store.directory
    complete = Campaign.unfinished(place, DENSE) is None
    going_on = resume and (complete or Campaign.unfinished(place, CALIBRATE) is not None)
    campaign = Campaign.numbered(place, axis.purpose(DENSE), resume=resume)
    session.prepare(campaign.directory)
    session.compensation = None
    return DensePass(propose(axis, measure(session, campaign, DENSE, steps, listener)), campaign, going_on)


def run_calibration(
    machine: Machine,
    store: SealedStore | None,
    listener: Listener = silent,
    *,
    straightness: DirectionalTable | None = None,
    backlash: SingleTable | None = None,
    resume: bool = False,
    recording: str = "",
    then: Callable[[Calibration], None] = lambda _result: None,
) -> Calibration:
    """Prepares and calibrates; each set of tables is sealed and stored once it is proven.

    backlash: measured by other means (`hil.correction.manual.read_backlash`), beside the pitch that is measured now

    recording: file name of a replayed recording, "" for a real machine; store: None for a recording, whose tables are
    not stored; then: the rest of the job, called before its campaign counts as finished
    Raises what `calibrate`, preparing the session and `then` raise.
    """
    axis = machine.axis
    purpose = axis.purpose(CALIBRATE)
    if backlash is not None:
        purpose["backlash"] = {"position_mm": backlash.position_mm.tolist(), "value_um": backlash.value_um.tolist()}
    campaign = Campaign.numbered(axis.store.directory, purpose_of_replay(purpose, recording), resume=resume)
    tell_unchecked(campaign, listener)
    _tell_other_parameters(machine, store, listener)
    machine.session.prepare(campaign.directory)
    store_tables = store.save_tables if store is not None else lambda _tables: None
    result = calibrate(
        machine.session, campaign, axis.correction, store_tables, listener, straightness=straightness, backlash=backlash
    )
    then(result)
    campaign.finish()
    return result


def _tell_other_parameters(machine: Machine, store: SealedStore | None, listener: Listener) -> None:
    """Warns, before motion, where the drive no longer has what the present tables were made with: they are made anew now."""
    keeper, stored = machine.session.made_with, None if store is None else store.states()
    made_with = None if stored is None else stored.made_with
    if keeper is None or made_with is None:
        return
    if differing := made_with.differences(keeper.now(machine.session.drive, made_with)):
        what = f"the drive no longer has the parameters that the present tables were made with ({', '.join(differing)})"
        listener(Event(CALIBRATE, f"{what}: they are made anew with what it has now", warning=True))


def calibration_job(
    axis: AxisConfig,
    *,
    straightness: DirectionalTable | None = None,
    backlash: SingleTable | None = None,
    resume: bool = False,
    zero: ZeroStatement = NO_STATEMENT,
) -> Job:
    """Job that returns a Calibration. axis: its specified value may have other signs than its file's (`with_signs`); straightness:
    stored together with the tables; backlash: as for `run_calibration`. Raises InputError for a new zero in a resumed campaign."""
    zero.check(resume=resume)

    def work(place: Workplace) -> Calibration:
        machine = Machine(axis, place.machine().session)
        store, listener = place.opened_store(), place.listener
        with zero.applied(machine.session):
            return run_calibration(
                machine, store, listener, straightness=straightness, backlash=backlash, resume=resume
            )

    plan = zero.in_plan(calibration_plan(axis))
    if resume:
        plan = going_on(plan, axis.store.directory, CALIBRATE)
    beside = [] if straightness is None else [PlannedWrite("straightness", str(TablePart.of_both(straightness)))]
    beside += [] if backlash is None else [PlannedWrite("backlash", str(TablePart.of(backlash.value_um)))]
    if axis.correction.band is not None:
        beside.append(PlannedWrite("signs", signs_text(axis.correction.band)))
    return Job(CALIBRATE, replace(plan, writes=(*plan.writes, *beside)), work)


# -- signs of the specified value ----------------------------------------------------------------------------------------
def with_signs(axis: AxisConfig, signs: Sequence[SignedSections]) -> AxisConfig:
    """The axis with these signs of its specified value in place of its file's; a campaign of it states them in its purpose.

    Raises InputError for signs without a band, and for a section with two.
    """
    correction, signs = axis.correction, tuple(signs)
    if correction.band is None:
        if signs:
            raise InputError("has signs without a band_um", path=axis.path)
        return axis
    band = replace(correction.band, signs=signs)
    return replace(axis, correction=replace(correction, band=band, signs=signs))


def signs_of(purpose: Mapping[str, Any]) -> tuple[SignedSections, ...]:
    """The signs that a campaign was begun with. Raises InputError where its purpose does not hold them in their form."""
    try:
        band = purpose["correction"]["band"] or {}
        return tuple(SignedSections(**one) for one in band.get("signs", ()))
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError("the campaign does not say which signs its specified value had") from error


def backlash_of(purpose: Mapping[str, Any]) -> SingleTable | None:
    """The backlash by other means that a calibration was begun with. Raises InputError for one of another form."""
    form = purpose.get("backlash")
    try:
        return None if form is None else SingleTable(form["position_mm"], form["value_um"])
    except (KeyError, TypeError) as error:
        raise InputError("the campaign does not say which backlash it was begun with") from error


def signs_text(band: Band) -> str:
    """Band and signs in short, in no language: each stretch with the signs of its + and - direction; the others have + and +."""
    parts = [
        f"{one.from_mm:g} … {one.to_mm:g} mm: {'/'.join('+' if sign > 0 else '−' for sign in (one.plus, one.minus))}"
        for one in band.signs
    ]
    return f"{band.low_um:g} … {band.high_um:g} µm, {'; '.join((*parts, '… +/+') if parts else ('+/+',))}"


# -- a backlash measured by other means ----------------------------------------------------------------------------------
def enter_backlash(
    store: SealedStore,
    axis: AxisConfig,
    backlash: SingleTable,
    made_with: MadeWith | None = None,
    *,
    alone: bool = True,
) -> Compensation:
    """Stores a backlash, D = C - B on positions of its own, beside the stored pitch; nothing moves, and it is not proven.

    made_with, alone: as for `beside_stored`. Raises what that and saving raise.
    """
    entered = beside_stored(store, axis, backlash, made_with, alone=alone)
    store.save(entered, measured=False)
    return entered


def beside_stored(
    store: SealedStore,
    axis: AxisConfig,
    backlash: SingleTable,
    made_with: MadeWith | None = None,
    *,
    alone: bool = True,
) -> Compensation:
    """What is stored, with a backlash beside its pitch; nothing is written.

    It takes the place of what the stored tables took a reversal out by, so that it counts once. Without stored tables it stands
    alone, the + direction being that of the datum; made_with: what the drive has then, None for not known; alone: whether it may.
    Raises InputError where it may not, StateError beside fitted effects of a reversal or a combined store of a specified accuracy,
    and what loading raises.
    """
    present = store.stored()
    if present is None and not alone:
        raise InputError("holds no tables of the axis, expected a pitch to enter a backlash beside", path=store.path)
    if present is None:
        ends = np.array([axis.limits.travel_min_mm, axis.limits.travel_max_mm])
        only = TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, DirectionalTable.constant(ends, 0.0), backlash)
        entered = Compensation(only, made_with=made_with)
    else:
        why = ""
        if Compensation(present.tables.zero(present.tables.nodes_mm), present.terms).corrects_reversal:
            why = "fitted effects beside the tables take a part of the reversal out, and it would count twice"
        elif axis.correction.band is not None and present.tables.specified is None:
            why = "the stored tables hold pitch and specified accuracy in one, whose directions could not be told from a backlash"
        if why:
            raise StateError(
                f"{store.path}: {why}; calibrate again with the backlash (hil calibrate {axis.path} --backlash)"
            )
        entered = replace(present, tables=present.tables.with_backlash(backlash))
    return entered


def entering_job(axis: AxisConfig, backlash: SingleTable) -> Job:
    """Job that stores a backlash beside the stored pitch and returns the Compensation; nothing moves."""
    plan = Plan(axis.name, axis.drive.backend, writes=(PlannedWrite("tables", str(axis.tables_path)),), locked=True)
    return Job(ENTER, plan, lambda place: enter_backlash(place.opened_store(), axis, backlash, alone=False))


def withdrawal_job(axis: AxisConfig) -> Job:
    """Job that takes the axis's tables, effects and lost motion out of force and returns what they stated; nothing moves."""

    def work(place: Workplace) -> BoundTables:
        stated = place.opened_store().withdraw()
        if place.session is not None:
            place.session.compensation = None
        return stated

    writes = (PlannedWrite("withdrawn", str(axis.tables_path)),)
    return Job(WITHDRAW, Plan(axis.name, axis.drive.backend, writes=writes, locked=True), work)


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
        "fine_steps": [
            {"target_mm": target_mm, "direction": direction, "moved_um": moved_um}
            for (target_mm, direction), moved_um in sorted(result.moved_um.items())
        ],
        "fine_total_um": axis.correction.fine_total_um,
        "tables": result.tables.to_dict(),
    }


# -- typed tables --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class TablePart:
    """One part of tables in short: how many places it has, its lowest and its highest correction, µm."""

    places: int
    low_um: float
    high_um: float

    @classmethod
    def of(cls, values_um: Floats) -> TablePart:
        """The part with these corrections."""
        return cls(len(values_um), float(values_um.min()), float(values_um.max()))

    @classmethod
    def of_both(cls, table: DirectionalTable) -> TablePart:
        return replace(cls.of(np.concatenate([table.plus_um, table.minus_um])), places=len(table.position_mm))

    def __str__(self) -> str:
        return f"{self.low_um:.2f} to {self.high_um:.2f} µm, {self.places} places"


def parts_of(tables: TableSet) -> dict[str, TablePart]:
    """The parts that are added to commands, by the name of their text on the screen, in the form in which they are stored."""
    pitch, specified, straightness = tables.pitch, tables.specified, tables.straightness
    nodes = pitch.position_mm
    parts = {f"pitch_{name}": tables.pitch_um(nodes, sign) for name, sign in (("plus", 1), ("minus", -1))}
    if specified is not None:
        parts |= {"specified_plus": specified.plus_um, "specified_minus": specified.minus_um}
    if straightness is not None:
        name = "straightness_across" if tables.straightness_axis else "straightness"
        return {each: TablePart.of(values_um) for each, values_um in parts.items()} | {
            name: TablePart.of_both(straightness)
        }
    return {name: TablePart.of(values_um) for name, values_um in parts.items()}


def manual_tables(
    axis: AxisConfig,
    path: str | Path,
    straightness: DirectionalTable | None = None,
    backlash: SingleTable | None = None,
) -> TableSet:
    """Typed tables in the form in which the axis file has them stored, with a straightness correction and a backlash beside them.

    Raises InputError, and CorrectionBoundError for a correction beyond the axis's bound.
    """
    typed = read_manual_tables(path, backlash)
    if straightness is not None:
        if typed.straightness is not None:
            raise InputError("holds a straightness table already, and --straightness gives another", path=path)
        typed = replace(typed, straightness=straightness)
    tables = as_stored(typed, axis.correction)
    Compensation(tables).check(axis.correction.bound, f"{path}: correction not stored")
    return tables


def kept_text(axis: AxisConfig, name: str, text: str) -> Path:
    """What was typed on the screen, kept in the axis's folder; the file. Raises InputError for a folder that cannot be written."""
    path = axis.store.directory / name
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text.encode())
    return path


def manual_job(axis: AxisConfig, tables: TableSet) -> Job:
    """Job that stores typed tables and returns them; nothing moves."""

    def work(place: Workplace) -> TableSet:
        place.opened_store().save(Compensation(tables), measured=False)
        return tables

    writes = (PlannedWrite("tables", str(axis.tables_path)),)
    return Job(MANUAL, Plan(axis.name, axis.drive.backend, writes=writes, locked=True), work)


# -- verify --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Verification:
    """The result of a verification; `outside` is empty without a band. not_judged: where none is asked for; compensation: in force,
    None for none."""

    records: Records
    outside: tuple[OutsideBand, ...]
    not_judged: tuple[NotJudged, ...]
    compensation: Compensation | None

    @property
    def good(self) -> bool:
        """No judged section is outside the band."""
        return not self.outside


def band_sentence(band: Band, result: Verification) -> str:
    """How many section means lie inside the band. They are compared as they are, without their uncertainty."""
    means = section_means(result.records)
    total = int(sum(np.isfinite(one).sum() for one in (means.plus_um, means.minus_um))) - len(result.not_judged)
    return f"band {band}: {total - len(result.outside)} of {total} section means inside (simple acceptance, without uncertainty)"


def verify(
    session: AxisSession,
    campaign: Campaign,
    name: str = "verify",
    band: Band | None = None,
    listener: Listener = silent,
    *,
    seed: int = 1,
) -> Verification:
    """Measures on a prepared session with the compensation in force.

    seed: determines the other targets. Raises InputError for rows of another plan, and what stops the axis.
    """
    steps = bidirectional_steps(other_targets(session.how, seed), session.how.runs)
    records = measure(session, campaign, name, steps, listener)
    outside, not_judged = ((), ()) if band is None else judge(section_means(records), band, session.how.targets_mm)
    return Verification(records, outside, not_judged, session.compensation)


def verification_plan(axis: AxisConfig, seed: int) -> Plan:
    steps = bidirectional_steps(other_targets(axis.measurement, seed), axis.measurement.runs)
    return measuring_plan(axis, steps, [PlannedWrite("rows", str(axis.store.directory))])


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
    purpose = _verification_purpose(axis, compensation, seed)
    campaign = Campaign.numbered(axis.store.directory, purpose_of_replay(purpose, recording), resume=resume)
    tell_unchecked(campaign, listener)
    machine.session.prepare(campaign.directory, compensation)
    machine.session.compensation = compensation
    name = UNCORRECTED if compensation is None else VERIFY
    result = verify(machine.session, campaign, name, axis.correction.band, listener, seed=seed)
    campaign.finish()
    return result


def _verification_purpose(axis: AxisConfig, compensation: Compensation | None, seed: int) -> dict[str, Any]:
    if compensation is None:
        return {**axis.purpose(UNCORRECTED), "seed": seed}
    return {**axis.purpose(VERIFY), "seed": seed, **compensation_in_force(compensation)}


def run_proof(machine: Machine, listener: Listener, *, resume: bool) -> Verification:
    """The verification that ends a calibration, of what it has put into force. resume: the last one of the same is continued.

    Raises as `run_verification`."""
    compensation = machine.session.compensation
    left = Campaign.latest(machine.axis.store.directory, VERIFY) if resume else None
    same = left is not None and left.purpose == json.loads(
        json.dumps(_verification_purpose(machine.axis, compensation, 1))
    )
    return run_verification(machine, compensation, listener, resume=same)


def verification_job(
    axis: AxisConfig,
    *,
    corrected: bool = True,
    seed: int = 1,
    resume: bool = False,
    zero: ZeroStatement = NO_STATEMENT,
    across: Across | None = None,
) -> Job:
    """Job that returns a Verification, with the compensation in the axis's store, or without any. across: the axis that its
    straightness moves, which the job connects too; None: no other is."""

    def work(place: Workplace) -> Verification:
        compensation = place.opened_store().load() if corrected else None
        if compensation is not None and (warning := place.opened_store().warning()) is not None:
            place.tell(warning)
        with ExitStack() as stack:
            machine = place.machine() if across is None else stack.enter_context(across.machine(axis, place))
            machine = Machine(axis, machine.session)
            with zero.applied(machine.session):
                return run_verification(machine, compensation, place.listener, seed=seed, resume=resume)

    plan, kind = zero.in_plan(verification_plan(axis, seed)), VERIFY if corrected else UNCORRECTED
    if across is not None:
        plan = across.in_plan(plan, axis)
    if resume:
        plan = going_on(plan, axis.store.directory, kind)
    return Job(kind, plan, work, connects=across is not None)


# -- straightness --------------------------------------------------------------------------------------------------------
def straightness_plan(axis: AxisConfig, seed: int) -> Plan:
    """The moves of this axis and the writes of a measurement of its straightness."""
    runs = axis.measurement.runs
    steps = bidirectional_steps(axis.measurement.targets_mm, runs)
    proof = bidirectional_steps(other_targets(axis.measurement, seed), runs)
    writes = [PlannedWrite("rows", str(axis.store.directory)), PlannedWrite("tables", str(axis.tables_path))]
    return measuring_plan(axis, [*steps, *proof, *proof], writes, locked=True)


def run_straightness(
    machine: Machine,
    store: SealedStore,
    present: Compensation | None,
    own: Compensation | None,
    listener: Listener = silent,
    *,
    seed: int = 1,
    resume: bool = False,
) -> StraightnessResult:
    """Prepares both axes of `connected_across`, measures, proves and stores beside the tables of this axis.

    present: what is stored for this axis, own: for the axis that is moved; both in force. Raises what `measure_straightness` raises.
    """
    axis, session = machine.axis, machine.session
    config, cross = axis.across(), session.require_cross()
    purpose = {**axis.purpose(STRAIGHTNESS), "seed": seed, "moves": cross.name, "at_mm": config.at_mm}
    purpose |= {} if present is None else compensation_in_force(present)
    purpose |= {} if own is None else {"own": compensation_in_force(own)}
    campaign = Campaign.numbered(axis.store.directory, purpose, resume=resume)
    tell_unchecked(campaign, listener)
    cross.corrected_by(own)
    session.prepare(campaign.directory, present)
    try:
        result = measure_straightness(session, campaign, config, present, listener, seed=seed)
    except UnprovenError:
        campaign.finish()
        raise
    store.save(result.compensation)
    campaign.finish()
    return result


@dataclass(frozen=True)
class Across:
    """The axis that straightness moves, for a job that connects both. store: with its own tables, opened; None where it is not."""

    axis: DriveAxis
    store: SealedStore | None

    @classmethod
    def of(cls, axis: AxisConfig, store: SealedStore | None) -> Across:
        """As the axis file names it. Raises InputError for an axis file without [straightness]."""
        return cls(load_drive_axis(axis.across().axis_file), store)

    @contextmanager
    def machine(self, axis: AxisConfig, place: Workplace) -> Iterator[Machine]:
        """Both axes, shown on their desks. Raises CapabilityError while its stored tables are not opened, and as
        `connected_across`."""
        there = isinstance(self.axis, AxisConfig) and bound_tables(self.axis) is not None
        if there and self.store is None:
            raise CapabilityError(f"the tables of axis {self.axis.name} are sealed: give the reading password first")
        with connected_across(axis, waiting=place.waiting) as machine:
            session = machine.session
            place.watch(axis.name, session.drive, session)
            if session.cross is not None:
                place.watch(self.axis.name, session.cross.drive, None)
                session.cross.corrected_by(self.store.load() if there and self.store is not None else None)
            yield machine

    def in_plan(self, plan: Plan, axis: AxisConfig) -> Plan:
        if axis.straightness is None:
            return plan
        at_mm, limits = axis.straightness.at_mm, self.axis.limits
        return replace(
            plan, moves=(*plan.moves, Move(f"across {self.axis.name}", at_mm, at_mm, limits.max_velocity_mm_s, "goes"))
        )


def straightness_job(axis: AxisConfig, across: Across, *, seed: int = 1, zero: ZeroStatement = NO_STATEMENT) -> Job:
    """Job that measures the straightness, proves and stores it, and returns a StraightnessResult."""

    def work(place: Workplace) -> StraightnessResult:
        store = place.opened_store()
        present = store.stored()
        with across.machine(axis, place) as machine, zero.applied(machine.session):
            own = None if machine.session.cross is None else machine.session.cross.state.compensation
            return run_straightness(machine, store, present, own, place.listener, seed=seed)

    plan = across.in_plan(zero.in_plan(straightness_plan(axis, seed)), axis)
    return Job(STRAIGHTNESS, plan, work, connects=True)
