"""`hil import`: converts a controller's table, or measurements of another program, to the formats of this program."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from drivers.files import read_text, replace_file
from hil.correction.formats import CONTROLLERS, MEASUREMENTS
from hil.correction.formats.common import both_directions
from hil.correction.formats.measured_csv import parse_column
from hil.correction.manual import manual_text
from hil.correction.tables import TableSet
from hil.files.controller_options import CONTROLLER_OPTIONS, MEASUREMENT_OPTIONS, as_typed, settings_from
from hil.records.files import naming
from hil.records.rows import Records, to_csv
from hil.ui.terminal.output import print_facts, write_json


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
            text = manual_text(tables, f"from {Path(args.file).name}, {args.format}")
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
