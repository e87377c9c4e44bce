"""Jobs of the correction table that a drive holds: written, proven, taken out; on an open drive or axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

from drivers.correction_table import TableDescription
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError, InputError
from hil.axis.axis_file import AxisConfig, DriveAxis, iso_targets
from hil.axis.zero import made_with_keeper, zero_keeper
from hil.correction.compensation import Compensation
from hil.correction.formats.common import tables_only
from hil.correction.store import compensation_in_force
from hil.correction.tables import DirectionalTable
from hil.desk.job import Tell
from hil.drive_table import DEVIATION_UM, PROVERS, TOLERANCE_UM
from hil.drive_table.change import (
    Snapshot,
    changing,
    held_table,
    remember_zero,
    remembered_made_with,
    remembered_zero,
    snapshot,
    zero_note,
)
from hil.drive_table.curve import DriveCurve, check_curve, largest_deviation_um
from hil.drive_table.proof import ProofMotion, TableProof, prove_by_drive, prove_by_instrument
from hil.drive_table.quantise import DriveTable, drive_table, wanted_of
from hil.drive_table.result import DriveTableResult
from hil.machine.events import Listener, silent
from hil.machine.session import AxisSession
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import described_table
from hil.records.journal import Campaign
from hil.records.made_with import MadeWith, MadeWithError
from hil.records.zero import Zero, read_zero

NOTE = "drive-table-before.json"


@dataclass(frozen=True)
class Proving:
    """How a table is proven. by: "instrument", "drive" (the value that it says it adds) or "nothing"; positions: number of positions,
    chosen by seed; runs: of each block; tolerance_um: of each difference, its uncertainty included."""

    by: str = "instrument"
    positions: int = 7
    runs: int = 2
    tolerance_um: float = TOLERANCE_UM
    seed: int = 1

    def __post_init__(self) -> None:
        """Raises InputError for a way that is none, fewer than 2 positions or 1 run."""
        if self.by not in PROVERS or self.positions < 2 or self.runs < 1:
            known = ", ".join(PROVERS)
            raise InputError(f"proof {self}, expected by one of {known}, 2 or more positions, 1 run or more")

    def targets_mm(self, axis: AxisConfig) -> tuple[float, ...]:
        """Positions spread over the measured travel, off the nodes."""
        where = axis.measurement.targets_mm
        return iso_targets(where[0], where[-1], self.positions, 0.3, self.seed)


@dataclass(frozen=True)
class Stored:
    """The bridge's compensation, and the table that a drive would have to hold in its place."""

    compensation: Compensation
    wanted: DirectionalTable

    @classmethod
    def of(cls, compensation: Compensation, *, leave_out_effects: bool = False) -> Stored:
        """Raises InputError for parts that no table holds."""
        wanted = wanted_of(compensation, leave_out_effects=leave_out_effects)
        if leave_out_effects:
            tables = tables_only(compensation, leave_out_effects=True)
            compensation = replace(compensation, tables=tables, terms=(), rise=None)
        return cls(compensation, wanted)


@dataclass(frozen=True)
class ConnectedAxis:
    """An axis that is connected. session: None without its instrument"""

    axis: AxisConfig
    drive: ServoDrive
    session: AxisSession | None
    listener: Listener = silent


def require_description(axis: DriveAxis) -> TableDescription:
    """The table that the drive can hold, by its map. Raises CapabilityError without one."""
    description = described_table(axis)
    if description is None:
        raise CapabilityError(f"axis {axis.name}: no map describes a correction table of its drive (correction_table)")
    return description


def made_table(axis: AxisConfig, stored: Stored, deviation_um: float = DEVIATION_UM) -> DriveTable:
    """The drive's table for the stored ones. deviation_um: largest that is allowed. Raises as `drive_table`."""
    description, bound = require_description(axis), axis.correction.bound
    return drive_table(stored.wanted, description, axis.scaling, axis.limits, deviation_um=deviation_um, bound=bound)


def download(there: ConnectedAxis, stored: Stored, made: DriveTable, how: Proving, tell: Tell) -> DriveTableResult:
    """Write, read back, prove, and switch on what is proven; else, and after any error, put back what was there."""
    axis, drive = there.axis, there.drive
    zero = zero_keeper(axis).kept(tables=stored.compensation.zero)
    with changing(drive, axis.store.directory / NOTE, tell) as change:
        made_with = _made_with(axis, drive, stored.compensation)
        change.write(made.raw)
        proof = _prove(there, stored, how)
        if proof is None or proof.good:
            change.switch(True)
        else:
            change.undo()
    if not change.undone:
        zero = stored.compensation.zero or zero or read_zero(axis.zero_path)
        remember_zero(zero_note(axis), made.raw, zero, made_with)
    return DriveTableResult(axis, None, proof, made.deviation_um, made, change.undone, change.seconds)


def prove(there: ConnectedAxis, stored: Stored, how: Proving) -> DriveTableResult:
    """Prove the table that the drive holds. Raises, before any motion, InputError where nothing is to prove it, ZeroError and
    MadeWithError for a table of another zero, or made with other parameters."""
    if how.by == "nothing":
        raise InputError("proof by nothing, expected by instrument or drive")
    axis, drive = there.axis, there.drive
    zero_keeper(axis).kept(tables=stored.compensation.zero)
    table = held_table(drive)
    raw = table.read()
    zero_keeper(axis).kept(tables=remembered_zero(zero_note(axis), raw))
    made_with_keeper(axis).check(drive, remembered_made_with(zero_note(axis), raw), reversal=True)
    curve = DriveCurve(table.description, raw, axis.scaling)
    check_curve(curve, axis.limits, axis.correction.bound)  # the proof switches it on
    limits = axis.limits
    deviation_um = largest_deviation_um(curve, stored.wanted, limits.travel_min_mm, limits.travel_max_mm)
    return DriveTableResult(axis, None, _prove(there, stored, how), deviation_um)


def remove(axis: DriveAxis, drive: ServoDrive, tell: Tell, *, keep_contents: bool = False) -> Snapshot:
    """Switch the drive's correction off and empty its table; what it holds then."""
    with changing(drive, axis.store.directory / NOTE, tell) as change:
        if keep_contents:
            change.switch(False)
        else:
            change.write(type(change.found.raw)())
            zero_note(axis).unlink(missing_ok=True)
        return snapshot(change.table)


@dataclass(frozen=True)
class Held:
    """What a drive holds. zero: that its table was made in, None where it is not known"""

    description: TableDescription
    found: Snapshot
    curve: DriveCurve
    zero: Zero | None


def held(axis: DriveAxis, drive: ServoDrive) -> Held:
    """Read the drive's table; nothing moves."""
    table = held_table(drive)
    found = snapshot(table)
    curve = DriveCurve(table.description, found.raw, drive.scaling)
    return Held(table.description, found, curve, remembered_zero(zero_note(axis), found.raw))


def _prove(there: ConnectedAxis, stored: Stored, how: Proving) -> TableProof | None:
    axis, targets, measuring = there.axis, how.targets_mm(there.axis), there.axis.measurement
    if how.by == "nothing":
        return None
    if how.by == "drive":
        way = ProofMotion(measuring.velocity_mm_s, measuring.overrun_mm, measuring.home)
        with Supervisor([WatchedAxis(there.drive)]) as moving:
            return prove_by_drive(moving, stored.wanted, targets, way, there.listener, tolerance_um=how.tolerance_um)
    if there.session is None:
        raise CapabilityError(f"axis {axis.name} is open without its instrument")
    proof = {"targets_mm": list(targets), "runs": how.runs}
    purpose = {**axis.purpose("prove-drive-table"), **compensation_in_force(stored.compensation), "proof": proof}
    campaign = Campaign.numbered(axis.store.directory, purpose, resume=False)
    return prove_by_instrument(
        *(there.session, campaign, stored.compensation, targets, there.listener),
        runs=how.runs,
        tolerance_um=how.tolerance_um,
    )


def _made_with(axis: AxisConfig, drive: ServoDrive, compensation: Compensation) -> MadeWith:
    """What the open drive has. Raises MadeWithError unless the tables were made with it; tables that take the reversal out and state
    nothing must find the drive's own amount 0.
    """
    keeper, reversal = made_with_keeper(axis), compensation.corrects_reversal
    keeper.check(drive, compensation.made_with, reversal=reversal)
    now = keeper.now(drive, compensation.made_with)
    amounts = {address: value for address, value in now.backlash.items() if value}
    if compensation.made_with is None and reversal and amounts:
        raise MadeWithError(
            f"axis {axis.name}: its tables do not state which parameters the drive had, and with {', '.join(amounts)} ="
            f" {', '.join(f'{value:g}' for value in amounts.values())} the reversal may be corrected twice: calibrate again"
            f" (hil calibrate {axis.path}), or set it to 0"
        )
    return now
