"""`hil calibrate`: measure an axis, compute its tables, prove them, store them sealed, revise until inside the band."""

from __future__ import annotations

import argparse
from dataclasses import replace

from drivers.errors import InputError
from hil.app.terminal.axis_options import (
    add_axis_arguments,
    add_password_options,
    add_zero_options,
    open_store,
    print_plan,
    tell_zero,
)
from hil.app.terminal.measuring_options import add_recording_options, machine_of, recording_name
from hil.app.terminal.output import write_json
from hil.app.terminal.progress import terminal_progress
from hil.app.terminal.summary import print_stages
from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration.calibrate import as_stored
from hil.calibration.job import calibration_plan, run_calibration, summarise
from hil.correction.compensation import Compensation
from hil.correction.manual import read_manual_tables, read_straightness
from hil.correction.tables import SingleTable
from hil.records.files import replace_file

EXAMPLE = """\
example:
  hil calibrate X.toml
  hil calibrate X.toml --resume             continue after an interruption
  hil calibrate X.toml --manual typed.csv   store tables that were typed or computed elsewhere, without measuring
  hil calibrate X.toml --new-zero           start again, with a new zero by the drive's homing
  hil calibrate X.toml --record machine.csv drive and instrument, recorded together
  hil calibrate X.toml --replay machine.csv the same again from the recording: nothing is connected, no table is stored

Exit status 1: sections stayed outside the band, and are named; or the proof contradicts the tables, and nothing is stored.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil calibrate`."""
    parser = subparsers.add_parser(
        "calibrate",
        description="Calibrate an axis by system A: measure every section both ways, compute the tables, prove and store them.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--resume", action="store_true", help="continue an interrupted calibration")
    parser.add_argument("--manual", metavar="TABLE.csv", help="store these tables instead of measured ones")
    parser.add_argument(
        "--straightness", metavar="TABLE.csv", help="store a straightness correction too: position_mm, deviation_um"
    )
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser, anew=True)
    add_recording_options(parser)
    add_password_options(parser, key=True)
    parser.set_defaults(run=run, resumes="calibrate")


def run(args: argparse.Namespace) -> int:
    """Returns 0: inside the band (or without a band); 1: some sections outside. Raises what `calibrate` and connecting
    raise.
    """
    axis = load_axis(args.axis)
    straightness = None if args.straightness is None else read_straightness(args.straightness)
    if args.manual is not None:
        return _store_manual(args, axis, straightness)
    if args.dry_run:
        print_plan(calibration_plan(axis))
        return 0
    store = None if args.replay else open_store(args, axis, writing=True)
    how = {"straightness": straightness, "resume": args.resume, "recording": recording_name(args)}
    with machine_of(args, axis) as machine, terminal_progress() as listener:
        tell_zero(args, machine)
        result = run_calibration(machine, store, listener, **how)
    summary = summarise(axis, result)
    print_stages({"before": summary["before"], **{f"round {n}": one for n, one in enumerate(summary["rounds"], 1)}})
    for section in result.outside:
        print(f"outside the band: {section}")
    print("nothing is stored: this was a recording" if store is None else f"stored {store.path}")
    if args.report:
        from hil.calibration.report import calibration_report  # noqa: PLC0415  (plots are slow to import)

        replace_file(args.report, calibration_report(axis, result).encode())
    if args.json:
        write_json(args.json, summary)
    return 0 if result.inside else 1


def _store_manual(args: argparse.Namespace, axis: AxisConfig, straightness: SingleTable | None) -> int:
    """Manual mode: stores the typed values in the form that the axis file asks for; nothing moves."""
    if args.resume or args.report or args.record or args.replay:
        raise InputError("--manual measures nothing: neither --resume, --report, --record nor --replay goes with it")
    typed = read_manual_tables(args.manual)
    if straightness is not None:
        if typed.straightness is not None:
            raise InputError("holds a straightness table already, and --straightness gives another", path=args.manual)
        typed = replace(typed, straightness=straightness)
    tables = as_stored(typed, axis.correction)
    Compensation(tables).check(axis.correction.bound, f"{args.manual}: correction not stored")
    if args.dry_run:
        print(f"axis {axis.name}: would move nothing")
        print(f"would write {axis.tables_path}")
        return 0
    store = open_store(args, axis, writing=True)
    store.save_tables(tables)
    print(f"stored {store.path}: tables {tables.digest()[:16]}, not yet proven (hil verify {args.axis})")
    if args.json:
        write_json(args.json, {"axis": axis.name, "digest": tables.digest(), "tables": tables.to_dict()})
    return 0
