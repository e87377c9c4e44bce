"""`hil import`: converts a controller's table, or measurements of another program, to the formats of this program."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from drivers.files import read_text, replace_file
from hil.app.terminal.output import add_json_option, print_facts, write_json
from hil.correction.formats import CONTROLLERS, MEASUREMENTS, manual_csv
from hil.correction.formats.commands.options import (
    CONTROLLER_OPTIONS,
    Option,
    add_options,
    as_typed,
    controller_names,
    settings_from,
)
from hil.correction.formats.common import both_directions
from hil.correction.formats.measured_csv import parse_column
from hil.correction.tables import TableSet
from hil.records.files import naming
from hil.records.rows import Records, to_csv

EXAMPLE = """\
example:
  hil import x.comp --format linuxcnc --out x.csv           a table file of manual mode, to look at, edit, or store
  hil import X.NC --format fanuc --axis 1 --out tables.json
  hil import Sample.Lin --format keysight --out records.csv
  hil import X.rtl --format renishaw --out records.csv
  hil import log.txt --format lines --pattern '^\\d+ +(?P<target_mm>\\S+) +(?P<error_um>\\S+)' --out records.csv
  hil import lab.csv --format csv --column target_mm=Soll --column measured_mm=Ist:um --decimal , --infer --out records.csv
  hil import report.csv --format iso-wide --cells deviation_um --out records.csv

Options of a controller's format that the file does not say (unit, type, reference, detection unit) must be those it was written with.
"""

MEASUREMENT_OPTIONS = (
    Option(
        "--pattern",
        "pattern",
        str,
        "lines: regular expression with groups target_<unit>, error_<unit> or measured_<unit>, …",
    ),
    Option("--delimiter", "delimiter", str, "csv, iso-wide: what parts the columns (default: found)"),
    Option("--decimal", "decimal", str, "csv, iso-wide, keysight, renishaw, lines: decimal mark, . (default) or ,"),
    Option(
        "--infer",
        "infer",
        None,
        "csv: read run and direction off the order of the targets; refused where it does not say them",
        switch=True,
    ),
    Option("--cells", "cells", str, "iso-wide: deviation_um (default), deviation_mm or position_mm"),
    Option("--column", "columns", None, "csv: where a column stands"),
)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil import`."""
    parser = subparsers.add_parser(
        "import",
        description="Turn a controller's compensation file into tables, or another program's measurements into records.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", metavar="FILE", help="the file to read")
    names = [*controller_names(), *(one.name for one in MEASUREMENTS)]
    parser.add_argument("--format", required=True, choices=names, help="what it is")
    parser.add_argument(
        "--out", metavar="OUT", required=True, help="tables: .csv (manual mode) or .json; measurements: records .csv"
    )
    add_options(parser, "options of the controllers' formats", CONTROLLER_OPTIONS)
    add_options(parser, "options of the measurements' formats", MEASUREMENT_OPTIONS[:-1])
    parser.add_argument(
        "--column",
        metavar="NAME=HEADER[:UNIT]",
        action="append",
        default=[],
        help="csv: where a column of ours stands (target_mm, measured_mm or error_um, run, direction, …); may be repeated",
    )
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """0: written. Raises InputError with file and line for what cannot be read."""
    args.format_column = dict(parse_column(text) for text in args.column) or None
    options = (*CONTROLLER_OPTIONS, *MEASUREMENT_OPTIONS)
    for controller in CONTROLLERS:
        if controller.name == args.format:
            settings = settings_from(args, args.format, controller.settings, options)
            with naming(args.file), as_typed(options):
                tables = controller.read(read_text(args.file, older=True), settings)
            return _write_tables(args, tables)
    measurement = next(one for one in MEASUREMENTS if one.name == args.format)
    settings = settings_from(args, args.format, measurement.settings, options)
    with naming(args.file), as_typed(options):
        records = measurement.read(read_text(args.file, older=True), settings)
    return _write_records(args, records)


def _write_tables(args: argparse.Namespace, tables: TableSet) -> int:
    if Path(args.out).suffix.lower() == ".json":
        text = json.dumps(tables.to_dict(), indent=1) + "\n"
    else:
        with naming(args.out):
            text = manual_csv.dump(tables, f"from {Path(args.file).name}, {args.format}")
    replace_file(args.out, text.encode())
    table = both_directions(tables, cross_axis=True)
    facts: dict[str, Any] = {
        "points": len(table.position_mm),
        "from_mm": float(table.position_mm[0]),
        "to_mm": float(table.position_mm[-1]),
        "mode": tables.mode.value,
        "tables": tables.digest(),
    }
    print_facts(
        {
            "tables": f"{facts['points']} positions, {facts['from_mm']:g} to {facts['to_mm']:g} mm, {tables.mode.value}",
            "correction": f"{min(table.plus_um.min(), table.minus_um.min()):.3f} to"
            f" {max(table.plus_um.max(), table.minus_um.max()):.3f} µm",
            "written": str(args.out),
        }
    )
    if args.json:
        write_json(args.json, {"file": str(args.file), "format": args.format, "written": str(args.out), **facts})
    return 0


def _write_records(args: argparse.Namespace, records: Records) -> int:
    if Path(args.out).suffix.lower() == ".json":
        raise InputError("measurements are written as records .csv, not as JSON", path=args.out)
    replace_file(args.out, to_csv(records, f"from {Path(args.file).name}, {args.format}").encode())
    facts = {"rows": len(records), "runs": len(records.runs), "targets": len(set(records.target_mm.tolist()))}
    print_facts(
        {
            "records": f"{facts['rows']} rows, {facts['runs']} runs, {facts['targets']} targets",
            "error": f"{records.error_um.min():.3f} to {records.error_um.max():.3f} µm",
            "written": str(args.out),
        }
    )
    if args.json:
        write_json(args.json, {"file": str(args.file), "format": args.format, "written": str(args.out), **facts})
    return 0
