"""Options of `hil export`."""

from __future__ import annotations

import argparse

from hil.correction import CONTROLLER_FORMATS, MAX_CORRECTION_UM, MAX_SLOPE_UM_PER_MM
from hil.files.controller_options import (
    CONTROLLER_OPTIONS,
    add_options,
)
from hil.ui.terminal.options import Later, add_effects_option, add_json_option, add_password_options, positive

EXAMPLE = """\
example:
  hil export X.toml --format linuxcnc --out x.comp
  hil export X.toml --format sinumerik --axis X1 --reference-mm 0 --allow-shift --out CEC_X.INI
  hil export typed.csv --format fanuc --axis 1 --step-mm 50 --magnification 2 --out X.NC
  hil export tables.json --format twincat --axis 2 --name Y --out achskw2.lis

SOURCE is an axis file (its sealed store is read), a table file of manual mode (.csv), or tables or a model as JSON. The file is read
back before it is handed out; what a controller must be set to besides is printed.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil export`."""
    parser = subparsers.add_parser(
        "export",
        description="Write the correction tables of an axis in the format of a CNC controller.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", metavar="SOURCE", help="AXIS.toml, TABLE.csv, or tables or a model as JSON")
    parser.add_argument("--format", required=True, choices=CONTROLLER_FORMATS, help="the controller")
    parser.add_argument("--out", metavar="FILE", required=True, help="the file to write")
    parser.add_argument(
        "--tables-only",
        action="store_true",
        help="leave out fitted effects that no table holds: of load, time, velocity …",
    )
    parser.add_argument(
        "--bound",
        nargs=2,
        type=positive,
        default=(MAX_CORRECTION_UM, MAX_SLOPE_UM_PER_MM),
        metavar=("UM", "UM_PER_MM"),
        help=f"of a source without axis file: a larger or steeper correction is refused"
        f" (default {MAX_CORRECTION_UM:g} {MAX_SLOPE_UM_PER_MM:g}; an axis file states its own)",
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be written, and write nothing")
    add_options(parser, "options of the formats", CONTROLLER_OPTIONS)
    add_password_options(parser, key=False)
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.export"), own_plan=True)
