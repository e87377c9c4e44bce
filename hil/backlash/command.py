"""`hil backlash`: lost motion from the servo's torque (system B)."""

from __future__ import annotations

import argparse
import math
import sys

from drivers.drive import ServoDrive
from drivers.files import replace_file
from hil.app.terminal.axis_options import add_axis_arguments, add_password_options, open_store, tell_bench
from hil.app.terminal.output import number, print_facts, print_table, times, write_json
from hil.app.terminal.progress import telling_notes, terminal_progress
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.axis.backlash import FEEDS, METHODS, REVERSALS, BacklashConfig
from hil.backlash.documents import facts, form, report_html, verdict
from hil.backlash.job import (
    NEVER_WRITTEN,
    MeasuredBacklash,
    backlash_config,
    measure,
    original_values,
    put_back,
    unrestored,
    write_amount,
)
from hil.backlash.result import NAMES, fitted_lost_motion, mean_um
from hil.figures.iso230 import MEASURED_AT_A_REVERSAL, OTHER_REVERSAL_FIGURES
from hil.machine.wiring import connected_drive

EXAMPLE = """\
example:
  hil backlash X.toml --dry-run                     what would move, how far, and which parameters
  hil backlash X.toml --report backlash.html        measure both reversals; the drive's parameters are as before afterwards
  hil backlash X.toml --runs 5 --write              mean of five, written to the drive's backlash parameter and read back
  hil backlash X.toml --laser 53.2                  also say by which scale an instrument's figure and this one differ
  hil backlash X.toml --write-um 52                 measure nothing; write this amount
  hil backlash X.toml --feed creep                  a very slow feed instead of steps; quicker, less certain
  hil backlash X.toml --restore                     put back what was there before the first --write, or what an interruption left

The [backlash] section of the axis file says where, in which steps, and which parameters (hil/examples/backlash_axis.toml). No position
sensor is needed: the motor's torque shows when the table breaks away. Every reading is kept in the axis's folder, also those of an
interrupted run. For a drive without a backlash parameter --write enters the mean in the axis's sealed tables, beside their pitch, and
needs their passwords. Exit status 1: no break-away within the allowed steps (detection limit exceeded); everything was put back.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil backlash`."""
    parser = subparsers.add_parser(
        "backlash",
        description="Reverse, step until the table breaks away, and read the lost motion from the motor's torque, both ways.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--runs", type=_count, help="measurements of both reversals (default: the axis file's)")
    parser.add_argument("--method", choices=METHODS, help="the estimate that is used (default: the axis file's)")
    parser.add_argument(
        "--feed", choices=FEEDS, help="after the reversal: steps, or a very slow creep (default: the axis file's)"
    )
    parser.add_argument(
        "--reversals", choices=list(REVERSALS), help="both, or one direction alone (default: the axis file's)"
    )
    parser.add_argument(
        "--laser",
        type=_micrometres,
        metavar="UM",
        help="lost motion by an instrument at the same place, µm: says the [backlash] scale that makes this measurement agree",
    )
    parser.add_argument(
        "--write-um",
        type=_micrometres,
        metavar="UM",
        help="measure nothing; write this amount, µm, as --write does with the mean",
    )
    parser.add_argument(
        "--write",
        action="store_true",
        help="write the mean to the backlash parameter, and read it back; without one, enter it in the sealed tables",
    )
    parser.add_argument(
        "--restore",
        action="store_true",
        help="measure nothing; restore what an interrupted run left changed, else the values before the first --write",
    )
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_password_options(parser, key=True)
    parser.set_defaults(run=run)


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and 0 < int(text) <= 100):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a whole number, 1 to 100")
    return int(text)


def _micrometres(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 10_000.0:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected micrometres, 0 to 10000")
    return value


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
    with connected_drive(axis) as drive, telling_notes(drive):
        if args.restore:
            return _restore(axis, how, drive)
        if args.write_um is not None:
            kept = write_amount(axis, how, drive, args.write_um, store)
            where = how.parameter or f"the sealed tables {axis.tables_path}"
            print(f"written: {where} = {kept:g}, for {args.write_um:g} µm as typed; not yet proven (hil verify)")
            return 0
        with terminal_progress() as listener:
            measured = measure(axis, how, drive, write=args.write, store=store, listener=listener, tell=_say)
    _print(measured)
    if args.laser is not None:
        _compare(measured, args.laser)
    if args.write and how.parameter is not None:
        tell_bench(axis)
    if args.report:
        replace_file(args.report, report_html(axis, measured).encode())
    if args.json:
        write_json(args.json, form(axis, measured))
    return 0 if measured.result.lost_motion_um is not None else 1


def _compare(measured: MeasuredBacklash, laser_um: float) -> None:
    """One value of an instrument beside this measurement: the scale that makes them agree."""
    by_torque_um = measured.result.lost_motion_um
    if by_torque_um:
        print(
            f"by the instrument {laser_um:g} µm, by torque {by_torque_um:.2f} µm: [backlash] scale = {laser_um / by_torque_um:.4f}"
            f" makes them agree; it holds for this axis as it is now"
        )


def _say(text: str) -> None:
    print(f"hil: {' '.join(text.split())}", file=sys.stderr)


def _restore(axis: DriveAxis, how: BacklashConfig, drive: ServoDrive) -> int:
    found = put_back(axis, how, drive)
    if found is None:
        print(f"nothing to put back: the last measurement left everything as it was, and {NEVER_WRITTEN}")
        return 0
    print("put back: " + ", ".join(f"{name} = {value:g}" for name, value in found.values.items()))
    earlier = original_values(axis)
    if earlier is not None:
        values = ", ".join(f"{name} = {value:g}" for name, value in earlier.items())
        print(f"a written amount is still in force; before it there was {values}: --restore once more puts that back")
    return 0


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


def _print(measured: MeasuredBacklash) -> None:
    result = measured.result
    rows = [
        [
            f"{one.run}, {NAMES[one.trace.direction]}",
            number(one.published_um, 1),
            number(None if one.fitted is None else one.fitted.lost_motion_um),
            number(None if one.fitted is None else 1.96 * one.fitted.u_um),
            number(None if one.fitted is None else one.fitted.peak_um, 1),
        ]
        for one in result.reversals
    ]
    print_table(["run", "four-sample, µm", "fitted, µm", "± U95, µm", "break-away, µm"], rows)
    found = fitted_lost_motion(result.reversals, result.directions)
    by_rule = mean_um(result.reversals, "four-sample", result.directions)
    fitted = "–" if found is None else f"{found.mean_um:.2f} ± {found.u95_um:.2f} µm (95 %)"
    means = {"fitted": fitted, "four-sample": "–" if by_rule is None else f"{by_rule:.1f} µm"}
    print_facts(
        {
            **{f"mean, {name}": text for name, text in means.items()},
            **facts(measured.settings, result),
            "readings": str(measured.kept),
        }
    )
    print(f"{MEASURED_AT_A_REVERSAL['backlash']} ({OTHER_REVERSAL_FIGURES})")
    if result.lost_motion_um is None:
        print(verdict(result))
