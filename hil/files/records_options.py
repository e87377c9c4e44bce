"""Options of `hil records`."""

from __future__ import annotations

import argparse
from typing import Any

from hil.correction import WIDE_ISO_CELLS
from hil.figures import FIGURES
from hil.ui.terminal.options import Later, add_json_option

EXAMPLE = """\
example:
  hil records list .                                    every campaign below this directory, by date
  hil records inspect X-campaign/calibrate-003          its purpose, its passes, whether they are unchanged
  hil records merge jan.csv feb.csv --out both.csv      runs numbered on, times by the dates of the passes
  hil records export X-campaign/verify-001/verify.csv --format iso-wide --out table.csv
  hil records history X-campaign --figure A --figure R --out history.html

Exit status 1: inspect found a pass that was changed, torn, or cannot be read.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil records` with its jobs."""
    parser = subparsers.add_parser(
        "records",
        description="List, inspect, merge and export measurement records. No existing file is changed.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    one = _job(jobs, "list", "every campaign below some directories, by date", Later("hil.files.records", "run_list"))
    one.add_argument("places", metavar="DIRECTORY", nargs="+")
    one = _job(
        jobs,
        "inspect",
        "one campaign: purpose, passes, whether they are unchanged",
        Later("hil.files.records", "run_inspect"),
    )
    one.add_argument("campaign", metavar="CAMPAIGN", help="its directory")
    one = _job(jobs, "merge", "record files as one, in the order of time", Later("hil.files.records", "run_merge"))
    one.add_argument("records", metavar="RECORDS.csv", nargs="+")
    one.add_argument("--out", metavar="OUT.csv", required=True)
    one = _job(jobs, "export", "records for other programs", Later("hil.files.records", "run_export"))
    one.add_argument("records", metavar="RECORDS.csv")
    one.add_argument("--format", choices=("csv", "iso-wide", "json"), required=True)
    one.add_argument(
        "--cells", choices=tuple(WIDE_ISO_CELLS), default="deviation_um", help="iso-wide (default deviation_um)"
    )
    one.add_argument("--decimal", choices=(".", ","), default=".", help="iso-wide: decimal mark (default .)")
    one.add_argument("--out", metavar="FILE", required=True)
    one = _job(
        jobs, "history", "ISO 230-2 figures over months, with a trend", Later("hil.files.records", "run_history")
    )
    one.add_argument("places", metavar="DIRECTORY", nargs="+")
    one.add_argument("--figure", action="append", choices=tuple(FIGURES), help="may be repeated (default A, R and B)")
    one.add_argument("--axis", metavar="NAME", help="only this axis")
    one.add_argument(
        "--pass", dest="passes", metavar="NAME", action="append", help="passes of this name (default: the most usual)"
    )
    one.add_argument("--out", metavar="HISTORY.html", help="also write an HTML page with the plot")
    one.add_argument("--png", metavar="FILE", help="also write the plot")


def _job(jobs: Any, name: str, what: str, run: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = jobs.add_parser(
        name, help=what, description=what, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser
