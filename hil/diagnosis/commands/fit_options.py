"""Options of `hil fit`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_effects_option, add_json_option, add_records_argument

EXAMPLE = """\
example:
  hil fit records.csv --out model.json
  hil fit records.csv --runs 1-3 --out model.json
  hil fit records.csv --with velocity_lag --out model.json
  hil fit records.csv --with coolant_level --effects coolant_level.py --out model.json

The model is a table of the error per direction of arrival, smoothed as far as the repeats allow, and the effects named by --with.
`hil apply` uses it; `hil diagnose` determines which effects there are.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil fit`."""
    parser = subparsers.add_parser(
        "fit",
        description="Fit the bidirectional error table of an axis to measurement records.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_records_argument(parser)
    parser.add_argument("--out", metavar="MODEL", required=True, help="the model file to write")
    parser.add_argument(
        "--with",
        dest="wanted",
        metavar="EFFECT",
        action="append",
        default=[],
        help="id of an effect to be fitted beside the table; may be repeated",
    )
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.diagnosis.commands.fit"))
