"""Options of `hil iso230`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option

EXAMPLE = """\
example:
  hil iso230 records.csv
  hil iso230 records.csv --json figures.json

The deviation of a row is measured - target: with a correction in force, the figures are those of the corrected axis.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil iso230`."""
    parser = subparsers.add_parser(
        "iso230",
        description="Accuracy and repeatability of positioning of a linear axis by ISO 230-2:2014.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "records", metavar="RECORDS.csv", help="measurement records: run, direction, target_mm, measured_mm"
    )
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.iso230"))
