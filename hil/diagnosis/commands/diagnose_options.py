"""Options of `hil diagnose`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_effects_option, add_json_option, add_records_argument

EXAMPLE = """\
example:
  hil diagnose records.csv --json diagnosis.json --out extended.json
  hil diagnose check.csv --model model.json --json diagnosis.json --out extended.json
  hil diagnose records.csv --effects coolant_level.py
  hil diagnose records.csv --out extended.json --non-parametric     corrects the unexplained part too

Without --model the declared model (a table per direction) is fitted from the records themselves. Exit 0: the residual is
explained or within the noise; 1: structure remains that no effect of the catalogue explains.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil diagnose`."""
    parser = subparsers.add_parser(
        "diagnose",
        description="Find the effect that the declared model lacks, name what it could be confused with, and extend the model.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_records_argument(parser)
    parser.add_argument(
        "--model", metavar="MODEL", help="the declared model (`hil fit`); default: fitted from the records"
    )
    parser.add_argument("--out", metavar="EXTENDED", help="write the extended model; `hil apply` uses it")
    parser.add_argument(
        "--axis", metavar="AXIS.toml", help="the axis file: its pitch is used in planning the next measurement"
    )
    parser.add_argument(
        "--non-parametric",
        action="store_true",
        help="where something is unexplained: put a smooth function of the columns that carry it into the extended model, though its"
        " cause is unknown; refused where it does not help on runs left out, or a column is not known when a command is issued",
    )
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.diagnosis.commands.diagnose"))
