"""`hil iso230`: the figures of ISO 230-2 from a record file."""

from __future__ import annotations

import argparse

from hil.figures.iso230 import iso230
from hil.figures.verdict import accuracy
from hil.records.files import naming
from hil.records.rows import read_csv
from hil.ui.terminal.output import write_json
from hil.ui.terminal.summary import print_figures


def run(args: argparse.Namespace) -> int:
    """Prints the figures and writes them as JSON on request. Returns 0. Raises InputError for records that cannot give
    them.
    """
    with naming(args.records):
        records = read_csv(args.records)
        figures = iso230(records)
    print(accuracy(records, None, None, None))
    print_figures(figures)
    if args.json:
        write_json(args.json, {"records": str(args.records), **figures.as_json()})
    return 0
