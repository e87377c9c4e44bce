"""Options of `hil apply`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_effects_option, add_json_option, add_records_argument

EXAMPLE = """\
example:
  hil apply --model model.json records.csv --out corrected.csv

OUT.csv holds the rows with two columns more: correction_um, what the model adds to the command of that row from what is
known when the row is commanded; residual_um, the error of the uncorrected machine (measured - command) plus that correction.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil apply`."""
    parser = subparsers.add_parser(
        "apply",
        description="Apply a model of `hil fit` or `hil diagnose` to records.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--model", metavar="MODEL", required=True, help="model file of `hil fit` or `hil diagnose --out`"
    )
    add_records_argument(parser)
    parser.add_argument("--out", metavar="OUT.csv", required=True, help="the records with two columns added")
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.diagnosis.commands.apply"))
