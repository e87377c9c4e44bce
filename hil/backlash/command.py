"""`hil backlash`: lost motion from the servo's torque (system B)."""

from __future__ import annotations

import argparse
from typing import Any

from drivers.drive import ServoDrive
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.axis.backlash import BacklashConfig
from hil.backlash.job import (
    NEVER_WRITTEN,
    backlash_config,
    measure,
    original_values,
    put_back,
    unrestored,
    write_amount,
)
from hil.backlash.measured import HEAD, BacklashResult
from hil.backlash.result import NAMES
from hil.figures.iso230 import MEASURED_AT_A_REVERSAL, OTHER_REVERSAL_FIGURES
from hil.machine.wiring import connected_drive
from hil.ui.terminal.axis_options import open_store, tell_bench
from hil.ui.terminal.output import finish, print_facts, print_table, say, times, write_json
from hil.ui.terminal.progress import telling_notes, terminal_progress


def run(args: argparse.Namespace) -> int:
    """Returns 0: measured; 1: detection limit exceeded. Raises what `measure_backlash` raises."""
    axis = load_drive_axis(args.axis)
    how = backlash_config(axis, runs=args.runs, method=args.method, feed=args.feed, reversals=args.reversals)
    if args.dry_run:
        _print_plan(axis, how, args)
        return 0
    store = None
    writes = args.write or args.write_um is not None
    if writes and how.parameter is None and isinstance(axis, AxisConfig) and not args.restore:
        store = open_store(args, axis, writing=True)
    found = None
    with connected_drive(axis) as drive, telling_notes(drive):
        if args.restore:
            done = _restore(axis, how, drive)
        elif args.write_um is not None:
            kept = write_amount(axis, how, drive, args.write_um, store)
            where = how.parameter or f"the sealed tables {axis.tables_path}"
            print(f"written: {where} = {kept:g}, for {args.write_um:g} µm as typed; not yet proven (hil verify)")
            done = {"amount_um": args.write_um, "written": {how.parameter or str(axis.tables_path): kept}}
        else:
            with terminal_progress() as listener:
                found = measure(axis, how, drive, write=args.write, store=store, listener=listener, tell=say)
    if found is not None:
        return _measured(args, axis, found)
    if args.json:
        write_json(args.json, {"axis": axis.name, **done})
    return 0


def _measured(args: argparse.Namespace, axis: DriveAxis, found: BacklashResult) -> int:
    """Say a measurement; its exit status."""
    _print(found)
    if args.laser is not None and found.lost_motion_um:
        scale = args.laser / found.lost_motion_um
        print(
            f"by the instrument {args.laser:g} µm, by torque {found.lost_motion_um:.2f} µm: [backlash] scale = {scale:.4f}"
            f" makes them agree; it holds for this axis as it is now"
        )
    if args.write and found.how.parameter is not None:
        tell_bench(axis)
    return finish(args, found)


def _restore(axis: DriveAxis, how: BacklashConfig, drive: ServoDrive) -> dict[str, Any]:
    """Put back, and say so; what was put back, and what the next --restore puts back, by name, None where there is nothing."""
    found = put_back(axis, how, drive)
    if found is None:
        print(f"nothing to put back: the last measurement left everything as it was, and {NEVER_WRITTEN}")
        return {"restored": None, "restorable": None}
    print("put back: " + ", ".join(f"{name} = {value:g}" for name, value in found.values.items()))
    earlier = original_values(axis)
    if earlier is not None:
        values = ", ".join(f"{name} = {value:g}" for name, value in earlier.items())
        print(f"a written amount is still in force; before it there was {values}: --restore once more puts that back")
    return {"restored": found.values, "restorable": earlier}


def _print_plan(axis: DriveAxis, how: BacklashConfig, args: argparse.Namespace) -> None:
    if args.write_um is not None and not args.restore:
        print(
            f"axis {axis.name}: would write {args.write_um:g} µm to {how.parameter or axis.tables_path}; moves nothing"
        )
        return
    if args.restore:
        where, earlier = f"axis {axis.name} over {axis.drive.backend}: would write back", original_values(axis)
        if unrestored(axis):
            print(f"{where} what an interrupted measurement noted")
        elif earlier is None:
            print(f"{where} nothing: {NEVER_WRITTEN}")
        else:
            print(f"{where} {', '.join(f'{name} = {value:g}' for name, value in earlier.items())}")
        return
    print(
        f"axis {axis.name} over {axis.drive.backend}: would enable it{', home it' if how.home else ''} and, {times(how.runs)}:"
    )
    feed = f"creep at {how.creep_um_s:g} µm/s" if how.feed == "creep" else f"go in steps of {how.step_um:g} µm"
    for direction in how.directions:
        print(
            f"  {NAMES[direction]}: from {how.start_mm(direction):g} mm to {how.turning_mm(direction):g} mm, turn back, and"
            f" {feed}, to {how.end_mm(direction):g} mm at most"
        )
    if how.parameter is None:
        print(
            f"  no parameter of the drive is touched; --write enters the amount in the sealed tables {axis.tables_path}"
        )
    else:
        names = [name for name in (how.parameter, how.acceleration) if name]
        print(f"  meanwhile {' and '.join(names)} would be 0, and as before afterwards")
    print(f"  the mean would {'take the place of the amount' if args.write else 'not be written'}")


def _print(found: BacklashResult) -> None:
    print_table(HEAD, found.table())
    fitted, by_rule_um = found.raw.fitted, found.raw.by_rule_um
    means = {
        "mean, fitted": "–" if fitted is None else f"{fitted.mean_um:.2f} ± {fitted.u95_um:.2f} µm (95 %)",
        "mean, four-sample": "–" if by_rule_um is None else f"{by_rule_um:.1f} µm",
    }
    print_facts({**means, **found.parameters(), "readings": str(found.kept)})
    print(f"{MEASURED_AT_A_REVERSAL['backlash']} ({OTHER_REVERSAL_FIGURES})")
    if found.verdict:
        print(found.verdict)
