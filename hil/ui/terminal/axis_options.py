"""Arguments, sealed store and dry run of the verbs that work on an axis."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from drivers.errors import BridgeError, InputError
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.correction import TABLES
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore, bound_tables
from hil.desk.plan import Plan
from hil.desk.zero_statement import ZeroStatement
from hil.effects import ALL, Effect
from hil.ui.terminal.options import KEY, READING
from hil.ui.terminal.passwords import own_passwords, password

if TYPE_CHECKING:  # the drivers take longer to load than a dry run needs
    from hil.machine.machine import Machine


def tell_bench(axis: DriveAxis) -> None:
    """Say that the bench forgets what was written to its drive, after a verb that wrote to it."""
    if axis.drive.backend == "bench":
        print(
            f"axis {axis.name} is on the bench, which starts anew with each command: the next one does not find what was written"
            " (a drive of `hil sim drive` keeps it)"
        )


def tell_zero(args: argparse.Namespace, machine: Machine) -> None:
    """Apply the zero options to the session. Raises InputError for a new zero in a resumed campaign."""
    said = ZeroStatement(anew=getattr(args, "new_zero", False), instrument_zeroed=args.instrument_zeroed)
    said.check(resume=getattr(args, "resume", False))
    zero = machine.session.zero
    if zero is not None:
        zero.anew, zero.instrument_zeroed = said.anew, said.instrument_zeroed


def open_store(args: argparse.Namespace, axis: AxisConfig, *, writing: bool) -> SealedStore:
    """The axis's sealed store; writing: with the builder's private key. Passwords are asked for here, before any motion.

    Raises InputError for a missing password, and as `SealedStore.of`.
    """
    usual, usual_key = axis.store.password_file, axis.store.key_password_file
    key = (
        password(args.key_password_file, KEY, "builder key's password", os.environ, usual=usual_key)
        if writing
        else None
    )
    own = own_passwords(args.table_password, TABLES, "--table-password")
    anew = writing and not has_tables(axis)
    reading = password(args.password_file, READING, "reading password", os.environ, usual=usual, new=anew)
    return SealedStore.of(axis, reading, key, own=own)


def has_tables(axis: AxisConfig) -> bool:
    """Whether a password for this axis's tables was chosen already; True where that cannot be read, which opening says."""
    try:
        return bound_tables(axis) is not None
    except (BridgeError, OSError):
        return axis.tables_path.exists()


def load_stored(store: SealedStore, effects: Sequence[Effect] = ALL) -> Compensation:
    """The stored compensation; a warning of the store is printed. Raises as `SealedStore.load`."""
    if not store.path.exists():
        raise InputError(
            f"is not there: axis {store.axis} has no tables yet, hil calibrate makes them", path=store.path
        )
    compensation = store.load(effects)
    warning = store.warning()
    if warning is not None:
        print(f"hil: {warning}", file=sys.stderr)
    return compensation


def load_cross(args: argparse.Namespace, axis: AxisConfig) -> Compensation | None:
    """What is stored for the axis that this axis's straightness moves, None where nothing is. Raises as `open_store`."""
    if axis.straightness is None:
        return None
    other = load_drive_axis(axis.straightness.axis_file)
    if not isinstance(other, AxisConfig) or bound_tables(other) is None:
        return None
    return load_stored(open_store(args, other, writing=False))


_WRITTEN = {"rows": "rows of each pass below ", "tables": ""}


def print_plan(axis: AxisConfig, plan: Plan) -> None:
    """Print the plan of a job that measures along the axis. Raises InputError for an axis that its drive's registers cannot hold."""
    if axis.drive.backend == "modbus":
        from hil.machine.modbus_wiring import check_registers  # noqa: PLC0415  (a verb loads the wire its axis file names)

        check_registers(axis)
    homing = "home it, " if plan.homes else ""
    reach = plan.reach_mm
    if reach is not None:
        print(f"axis {plan.axis} over {plan.backend}: would enable it, {homing}take the datum at {plan.datum_mm:g} mm")
        speeds = " and ".join(f"{velocity:g}" for velocity in sorted({move.velocity_mm_s for move in plan.moves}))
        print(f"would move between {reach[0]:.3f} and {reach[1]:.3f} mm (corrections come on top) at {speeds} mm/s")
        if plan.positions:
            print(f"would capture {plan.positions} positions, {plan.at_rest_s:g} s at rest each")
        if plan.travel_s:
            print(f"would take some {plan.seconds / 60:.0f} min, without homing, settling and repeated rounds")
    for write in plan.writes:
        print(f"would write {_WRITTEN.get(write.what, '')}{write.place}")
