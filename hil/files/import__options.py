"""Options of `hil import`."""

from __future__ import annotations

import argparse

from hil.correction import CONTROLLER_FORMATS, MEASUREMENT_FORMATS
from hil.files.controller_options import (
    CONTROLLER_OPTIONS,
    Option,
    add_options,
)
from hil.ui.terminal.options import Later, add_json_option

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
    names = [*CONTROLLER_FORMATS, *MEASUREMENT_FORMATS]
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
    parser.set_defaults(run=Later("hil.files.import_"))
