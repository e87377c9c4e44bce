"""Options of `hil iso230-4`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option

EXAMPLE = """\
example:
  hil iso230-4 ccw.json cw.json                     two results of `hil circle --json`, the second with --clockwise
  hil iso230-4 path.csv --radius 100                one path: no bi-directional figures
  hil iso230-4 ccw.csv cw.csv --radius 150 --json figures.json

A CSV file has a header and the points of one turn in the order of time: x_mm,y_mm, or angle_deg,deviation_um of a telescoping bar (the
angle from the first axis, the deviation from the nominal radius). Lines that begin with # are left out. Other columns are ignored.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil iso230-4`."""
    parser = subparsers.add_parser(
        "iso230-4",
        description="Circular deviation G, radial deviation F and, of both senses, G(b) and D by ISO 230-4:2005.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("paths", metavar="PATH", nargs="+", help="one or two files: .json of `hil circle`, or .csv")
    parser.add_argument("--radius", metavar="MM", type=float, help="nominal radius of paths in CSV files")
    parser.add_argument(
        "--circle", metavar="NAME", help="which circle of a .json: uncorrected, tables, corrected (default: the last)"
    )
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.iso230_4"))
