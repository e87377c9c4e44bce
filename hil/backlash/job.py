"""Lost motion from the servo's torque (system B) as jobs: measure, restore after an interruption, write, switch the
compensation.

Beside the note of an interrupted measurement (`hil.backlash.neutral_settings`) one more file is kept in the axis's
folder: the drive's values before a measured amount was first written, and the amount last written. With it the original
can be restored and the compensation switched off and on.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.drive import ServoDrive
from drivers.errors import InputError, StateError
from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.axis.backlash import BacklashConfig, default_backlash
from hil.axis.zero import made_with_keeper
from hil.backlash.measured import BacklashResult
from hil.backlash.neutral_settings import SettingsBefore, read_before, restore
from hil.backlash.procedure import check_drive, measure_backlash
from hil.backlash.result import NAMES
from hil.backlash.settings import NOTE, backlash_settings
from hil.backlash.trace import ReversalTrace
from hil.calibration.job import enter_backlash
from hil.correction.store import SealedStore, bound_tables
from hil.correction.tables import SingleTable
from hil.desk.job import Job, Workplace
from hil.desk.plan import Move, Plan, PlannedWrite
from hil.machine.events import Listener, silent
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.records.files import read_note
from hil.records.made_with import same

MEASURE, LOOK = "backlash", "backlash look"
WRITE, RESTORE, SWITCH = "backlash write", "backlash restore", "backlash switch"
WRITTEN = "backlash-written.json"
"""Journal: the values before the first write, and the last one written. It is there until they are put back."""
NEVER_WRITTEN = "no amount was written since the drive was as it is"


def backlash_config(axis: DriveAxis, **given: Any) -> BacklashConfig:
    """The axis file's [backlash] section, or the defaults, with the given values replaced. Raises InputError."""
    how = axis.backlash or default_backlash(axis.path, axis.limits, axis.scaling, axis.drive.backend)
    return replace(how, **{name: value for name, value in given.items() if value is not None})


def _parameters(axis: DriveAxis, how: BacklashConfig) -> list[str]:
    """Names of the settings: the amount and the acceleration switch."""
    if how.parameter is None:
        return [str(axis.tables_path)]
    return [name for name in (how.parameter, how.acceleration) if name]


# -- measure -------------------------------------------------------------------------------------------------------------
def measuring_plan(axis: DriveAxis, how: BacklashConfig, *, write: bool = False) -> Plan:
    moves = []
    for direction in how.directions:
        ends = (how.start_mm(direction), how.turning_mm(direction), how.end_mm(direction))
        moves.append(Move(f"reverse {NAMES[direction]}", min(ends), max(ends), how.travel_velocity_mm_s))
    places = _parameters(axis, how)
    writes = [PlannedWrite("meanwhile", place) for place in places] if how.parameter else []
    writes += [PlannedWrite("parameter", places[0])] if write else []
    return Plan(axis.name, axis.drive.backend, tuple(moves), tuple(writes), how.home, locked=write)


def measure(
    axis: DriveAxis,
    how: BacklashConfig,
    drive: ServoDrive,
    *,
    write: bool = False,
    store: SealedStore | None = None,
    listener: Listener = silent,
    tell: Callable[[str], None],
) -> BacklashResult:
    """Measures on an open drive; every reversal is written to disk as it is measured, also an interrupted one.

    store: where the mean goes that is to be written, for a drive without a parameter
    Raises what `check_drive`, `refuse_twice` and `measure_backlash` raise.
    """
    settings = backlash_settings(axis, how, drive)
    check_drive(drive, how)
    if write:
        refuse_twice(axis, how, drive)
        if how.parameter is None:
            _require_store(axis, store)
    kept = _next_file(axis.store.directory)
    remember, keep = partial(_remember, axis), _keeper(kept, axis.name, how.reversals)
    into_drive = write and how.parameter is not None
    raw = measure_backlash(
        drive, how, settings, write=into_drive, remember=remember, keep=keep, listener=listener, tell=tell
    )
    if write and not into_drive and raw.lost_motion_um is not None:
        amount_um = settings.amount_of(raw.lost_motion_um)
        _into_tables(axis, store, drive, amount_um)
        raw = replace(raw, written=amount_um)
    return BacklashResult(axis, None, how, settings, raw, kept)


def _require_store(axis: DriveAxis, store: SealedStore | None) -> AxisConfig:
    """Raises InputError for an axis whose lost motion nothing would use, or whose store is not open."""
    if not isinstance(axis, AxisConfig):
        raise InputError(
            "names no backlash parameter of the drive ([backlash] parameter) and no [instrument]: nothing would use the amount, so"
            " it is not written",
            path=axis.path,
        )
    if store is None:
        raise InputError(
            f"axis {axis.name}: its drive has no backlash parameter, so the amount goes into the sealed tables: they are not open"
        )
    return axis


def _into_tables(axis: DriveAxis, store: SealedStore | None, drive: ServoDrive, amount_um: float) -> None:
    """Enters the lost motion in the axis's tables, the same everywhere."""
    measured = _require_store(axis, store)
    if store is not None:
        made_with = made_with_keeper(measured).now(drive)
        enter_backlash(
            store, measured, SingleTable(np.array([measured.limits.travel_min_mm]), np.array([amount_um])), made_with
        )


def measuring_job(axis: DriveAxis, how: BacklashConfig, *, write: bool = False) -> Job:
    """Job that returns a BacklashResult; write: the mean is written."""

    def work(place: Workplace) -> BacklashResult:
        return measure(axis, how, place.drive, write=write, store=place.store, listener=place.listener, tell=place.tell)

    return Job(MEASURE, measuring_plan(axis, how, write=write), work, reached=lambda found: found.good)


def _next_file(directory: Path) -> Path:
    taken = [int(path.stem.rpartition("-")[2]) for path in directory.glob("backlash-[0-9]*.jsonl")]
    return directory / f"backlash-{max(taken, default=0) + 1:03d}.jsonl"


def _keeper(path: Path, axis: str, reversals: str) -> Callable[[int, ReversalTrace], None]:
    """Appends one line of JSON per reversal, complete or interrupted, with what the measurement is of and when it began."""
    of = {"axis": axis, "reversals": reversals, "begun": datetime.now().astimezone().isoformat(timespec="seconds")}

    def keep(run: int, trace: ReversalTrace) -> None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"run": run, **of, **trace.to_json()}) + "\n")

    return keep


def refuse_twice(axis: DriveAxis, how: BacklashConfig, drive: ServoDrive, amount: float | None = None) -> None:
    """Raises StateError where the drive would take a reversal out that the axis's stored tables, or its own table, take out already.

    amount: to be written, in the parameter's unit, None while it is not measured; the one that the tables were made with is right.
    Raises what reading the store's header and the parameter raise.
    """
    refuse_while_drive_corrects(drive, "with a backlash amount the reversal would be corrected twice")
    tables = None if how.parameter is None else bound_tables(axis)
    if tables is None or how.parameter is None or tables.corrects_reversal is False:
        return
    address, present = drive.read_number(how.parameter)
    made_with = present if tables.made_with is None else tables.made_with.backlash.get(address, present)
    if amount is not None and same(amount, made_with):
        return
    known = (
        "correct the reversal already"
        if tables.corrects_reversal
        else "do not say that they leave the reversal uncorrected"
    )
    raise StateError(
        f"axis {axis.name}: {how.parameter} is not written, as the tables in {axis.tables_path} {known}, and it would be corrected"
        f" twice; take them out of force first (hil calibrate {axis.path} --withdraw), write, and calibrate again"
    )


# -- the parameter ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class CompensationState:
    """The drive's backlash compensation at present.

    amount: in the parameter's own unit, of which 1 is amount_um; original, written: its value before this program wrote
    one, and the last value written; None while nothing was written
    """

    name: str
    amount: float
    amount_um: float
    original: float | None = None
    written: float | None = None
    interrupted: bool = False  # a measurement ended without restoring the settings
    noted: float | None = None  # the value before that measurement
    resolution: float = 1.0
    scale: float = 1.0

    @property
    def on(self) -> bool:
        return self.amount != 0.0

    @property
    def to_restore(self) -> float | None:
        """The value that restoring writes, None for none."""
        return self.noted if self.interrupted else self.original

    def amount_of(self, lost_motion_um: float) -> float:
        """The amount for a lost motion measured by torque, µm, in the parameter's unit, rounded to its resolution."""
        backlash_um = lost_motion_um * self.scale
        return round(round(backlash_um / self.amount_um / self.resolution) * self.resolution, 9)


def read_compensation(
    axis: DriveAxis, how: BacklashConfig, drive: ServoDrive, store: SealedStore | None = None
) -> CompensationState:
    """Reads it from the open drive; of a drive without a parameter from the opened store. Raises what reading raises."""
    settings = backlash_settings(axis, how, drive)
    present = store.stored() if how.parameter is None and store is not None else None
    if present is not None:
        tables = present.tables
        own_um = tables.pitch_um(tables.nodes_mm, 1) - tables.pitch_um(tables.nodes_mm, -1)
        return CompensationState(str(axis.tables_path), float(own_um.mean()), 1.0, interrupted=settings.note.exists())
    written = _written(axis)
    original = None if written is None else written["before"].get(settings.amount.name)
    last = None if written is None else written["amount"]
    name, before = settings.amount.name, read_before(settings)
    noted = before.values[name] if before.from_note else None
    return CompensationState(
        *(name, settings.amount.read(), settings.amount_um, original, last, before.from_note, noted),
        settings.amount.resolution,
        how.scale,
    )


def look_job(axis: DriveAxis, how: BacklashConfig) -> Job:
    """Job that returns a CompensationState; moves and writes nothing."""
    plan = Plan(axis.name, axis.drive.backend)
    return Job(LOOK, plan, lambda place: read_compensation(axis, how, place.drive, place.store))


def write_job(axis: DriveAxis, how: BacklashConfig, lost_motion_um: float) -> Job:
    """Job that writes a measured mean to the drive's parameter and reads it back; returns a CompensationState."""

    def work(place: Workplace) -> CompensationState:
        write_amount(axis, how, place.drive, lost_motion_um * how.scale, place.store)
        return read_compensation(axis, how, place.drive, place.store)

    return Job(WRITE, _parameter_plan(axis, how), work)


def write_amount(
    axis: DriveAxis, how: BacklashConfig, drive: ServoDrive, backlash_um: float, store: SealedStore | None = None
) -> float:
    """Puts an amount of backlash, µm, into the drive's parameter and reads it back, or enters it in the opened store.

    Returns it as it is kept, in the parameter's unit. Raises what `refuse_twice` and writing raise.
    """
    settings = backlash_settings(axis, how, drive)
    amount = settings.amount_for(backlash_um)
    if how.parameter is None:
        refuse_twice(axis, how, drive)
        _into_tables(axis, store, drive, amount)
        return amount
    refuse_twice(axis, how, drive, amount)
    _remember(axis, {setting.name: setting.read() for setting in settings.settings()}, amount)
    settings.amount.write(amount)
    return amount


def restore_job(axis: DriveAxis, how: BacklashConfig) -> Job:
    """Job that restores what an interrupted measurement left changed, else the values before the first write; returns a
    CompensationState.

    Which of the two is decided here, when the plan is made: a job that needs no builder never undoes a builder's write.
    """
    interrupted = unrestored(axis)

    def work(place: Workplace) -> CompensationState:
        if put_back(axis, how, place.drive, interrupted=interrupted) is None:
            what = "what an interrupted measurement left changed is put back already"
            raise StateError(f"nothing to restore: {what if interrupted else NEVER_WRITTEN}")
        return read_compensation(axis, how, place.drive, place.store)

    plan = _parameter_plan(axis, how)
    return Job(RESTORE, replace(plan, locked=not interrupted), work)


def switch_job(axis: DriveAxis, how: BacklashConfig, *, on: bool) -> Job:
    """Job that switches the compensation off (amount 0), or on again with its last amount; returns a CompensationState."""

    def work(place: Workplace) -> CompensationState:
        settings = backlash_settings(axis, how, place.drive)
        present = settings.amount.read()
        if on and present == 0.0:
            written = _written(axis)
            if written is None or not written["amount"]:
                raise StateError("there is no amount to switch on: measure the lost motion and write it first")
            refuse_twice(axis, how, place.drive, written["amount"])
            settings.amount.write(written["amount"])
        elif not on and present != 0.0:
            before = {setting.name: setting.read() for setting in settings.settings()}
            _remember(axis, before, present)
            settings.amount.write(0)
        return read_compensation(axis, how, place.drive, place.store)

    return Job(SWITCH, _parameter_plan(axis, how), work)


def unrestored(axis: DriveAxis) -> bool:
    """Whether an interrupted measurement left the drive's settings changed."""
    return (axis.store.directory / NOTE).exists()


def put_back(
    axis: DriveAxis, how: BacklashConfig, drive: ServoDrive, *, interrupted: bool | None = None
) -> SettingsBefore | None:
    """Restores what an interrupted measurement left changed, else the values before the first write; None where nothing was changed.

    interrupted: only the first (True) is to be undone, or what it was when asked (None: now). Raises NotRestoredError, and what
    writing a parameter raises: then the journal is kept, and it can be done again.
    """
    settings = backlash_settings(axis, how, drive)
    found = restore(settings)
    written = _written(axis)
    if found is not None or interrupted or written is None:
        return found
    before: dict[str, float] = written["before"]
    if settings.amount.name in before:
        refuse_twice(axis, how, drive, before[settings.amount.name])
    for setting in settings.settings():
        if setting.name in before:
            setting.write(before[setting.name])
    (axis.store.directory / WRITTEN).unlink()
    return SettingsBefore(before, from_note=False)


def original_values(axis: DriveAxis) -> dict[str, float] | None:
    """The values before the first write, by name; None where nothing was written, or it is put back. Raises InputError for a
    damaged journal.
    """
    written = _written(axis)
    return None if written is None else written["before"]


def _parameter_plan(axis: DriveAxis, how: BacklashConfig) -> Plan:
    return Plan(
        axis.name, axis.drive.backend, writes=(PlannedWrite("parameter", _parameters(axis, how)[0]),), locked=True
    )


def _remember(axis: DriveAxis, before: dict[str, float], amount: float) -> None:
    """Stores the values before the first write, and the amount about to be written. Called before the write: a power
    cut in between must not lose the original.
    """
    earlier = _written(axis)
    kept = before if earlier is None else earlier["before"]
    form = {"before": kept, "amount": amount}
    replace_file(axis.store.directory / WRITTEN, (json.dumps(form, indent=2) + "\n").encode())


def _written(axis: DriveAxis) -> dict[str, Any] | None:
    def read(form: Any) -> dict[str, Any]:
        return {"before": {str(k): float(v) for k, v in form["before"].items()}, "amount": float(form["amount"])}

    wrong = "does not hold what was written to the drive, and what was there before"
    return read_note(axis.store.directory / WRITTEN, read, wrong)
