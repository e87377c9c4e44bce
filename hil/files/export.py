"""`hil export`: writes the tables in force as a file of a CNC controller."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text, replace_file
from hil.axis.axis_file import load_axis
from hil.correction.bound import CorrectionBound
from hil.correction.compensation import Compensation
from hil.correction.formats import CONTROLLERS, export_within
from hil.correction.formats.common import Export, tables_only
from hil.correction.manual import read_manual_tables
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.effects.model import FORMAT as MODEL_FORMAT
from hil.effects.model import Model
from hil.effects.user_effects import catalogue_with
from hil.files.controller_options import CONTROLLER_OPTIONS, as_typed, settings_from
from hil.records.files import naming, parse_json
from hil.ui.terminal.axis_options import open_store
from hil.ui.terminal.output import print_facts, write_json


def run(args: argparse.Namespace) -> int:
    """0: written. Raises InputError for tables that the format cannot hold, saying what to change."""
    controller = next(one for one in CONTROLLERS if one.name == args.format)
    settings = settings_from(args, args.format, controller.settings, CONTROLLER_OPTIONS)
    with naming(args.source), as_typed(CONTROLLER_OPTIONS):
        tables = tables_only(read_source(args), leave_out_effects=args.tables_only)
        if (
            Path(args.source).suffix.lower() != ".toml"
        ):  # an axis's store holds what it gives against the axis file's bound
            Compensation(tables).check(CorrectionBound(*args.bound), f"{args.source}: correction not exported")
        asked = args.format_tolerance_um is not None
        made = export_within(controller, tables, settings) if asked else controller.export(tables, settings)
    if not args.dry_run:
        replace_file(args.out, made.text.encode("ascii"))
    _say(args, tables, made)
    if args.json:
        write_json(
            args.json,
            {
                "source": str(args.source),
                "format": args.format,
                "settings": vars(settings),
                "tables": tables.digest(),
                "points": made.points,
                "deviation_um": made.deviation_um,
                "shift_um": made.shift_um,
                "notes": list(made.notes),
                "written": None if args.dry_run else str(args.out),
            },
        )
    return 0


def read_source(args: argparse.Namespace) -> Compensation:
    """Contents of the source. Raises InputError naming it."""
    suffix = Path(args.source).suffix.lower()
    if suffix == ".toml":
        return open_store(args, load_axis(args.source), writing=False).load(catalogue_with(args.effects))
    if suffix == ".csv":
        return Compensation(read_manual_tables(args.source))
    if suffix != ".json":
        raise InputError(f"is a {suffix or 'file without suffix'}, expected .toml, .csv or .json", path=args.source)
    text = read_text(args.source, expected="tables or a model (JSON)")
    try:
        data = parse_json(text)
    except ValueError as error:
        raise InputError(f"is not JSON: {error}", path=args.source) from error
    if isinstance(data, dict) and data.get("format") == MODEL_FORMAT:
        model = Model.from_json(text, args.source, catalogue_with(args.effects))
        held = model.table
        table = DirectionalTable(*(np.array(part) for part in (held.positions_mm, held.forward_um, held.backward_um)))
        return Compensation(TableSet(TableMode.BIDIRECTIONAL, table.scaled(-1.0)), model.terms)
    if isinstance(data, dict) and isinstance(data.get("tables"), dict):
        data = data["tables"]
    with naming(args.source):
        return Compensation(TableSet.from_dict(data))


def _say(args: argparse.Namespace, tables: TableSet, made: Export) -> None:
    facts = {
        "tables": tables.digest()[:16],
        "points": f"{made.points} per direction",
        "deviation": f"at most {made.deviation_um:.4f} µm from the tables, read back from the file",
    }
    if made.shift_um:
        facts["shift"] = f"{made.shift_um:+.4f} µm taken out everywhere: zero at the reference point"
    facts["would write" if args.dry_run else "written"] = str(args.out)
    print_facts(facts)
    for note in made.notes:
        print(f"set: {note}")
