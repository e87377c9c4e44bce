"""Options of `hil fleet`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from hil.ui.terminal.options import Later, Subparsers, add_json_option, verb_parser

EXAMPLE = """\
example:
  hil fleet index campaigns                                  Parquet of all campaigns below it; again: only what is new
  hil fleet trend campaigns --out trend.html                 what ages, what to look at first
  hil fleet trend campaigns --quantity backlash_um --false-alarms 0.2 --since 2026-01-01
  hil fleet compare campaigns --quantity A_um --json compared.json
  hil fleet diagnose campaigns --axis X --scheduler tcp://scheduler:8786

Exit status 1: index: something could not be read; trend: an alarm stands; compare: an axis is unlike the others.
"""


def add_parser(subparsers: Subparsers) -> None:
    """Adds `hil fleet` with its jobs."""
    parser = verb_parser(
        subparsers,
        "fleet",
        "Many axes over years: index their campaigns, find what ages, compare and diagnose them. Needs the fleet extra."
        " No campaign is changed.",
        EXAMPLE,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    one = _job(
        jobs,
        "index",
        "make the index follow the campaigns; what did not change is not read again",
        Later("hil.fleet.command", "run_index"),
    )
    _add_workers(one)
    one.add_argument("--again", action="store_true", help="read all campaigns again")
    one = _job(
        jobs,
        "trend",
        "what ages: alarms at a stated rate of false ones, ranked",
        Later("hil.fleet.command", "run_trend"),
    )
    _add_quantity(one)
    one.add_argument(
        "--false-alarms",
        metavar="N",
        type=float,
        default=0.5,
        help="false alarms a year in the whole fleet (default 0.5)",
    )
    one.add_argument("--since", metavar="DATE", help="only values from this date on, such as 2026-01-31")
    one.add_argument("--all", action="store_true", help="every series on the terminal, not the first 25")
    _add_page(one)
    one = _job(jobs, "compare", "each axis beside the others", Later("hil.fleet.command", "run_compare"))
    _add_quantity(one)
    _add_page(one)
    one = _job(
        jobs,
        "diagnose",
        "the newest pass of each axis diagnosed, the largest cause first",
        Later("hil.fleet.command", "run_diagnose"),
    )
    one.add_argument("--axis", metavar="NAME", action="append", help="only this axis; may be repeated")
    _add_workers(one)
    _add_page(one)


def _job(jobs: Any, name: str, what: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = jobs.add_parser(
        name, help=what, description=what, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("directory", metavar="DIR", help="directory with the campaigns, at any depth")
    parser.add_argument("--index", metavar="PLACE", help="where the index is (default: DIR/fleet-index)")
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser


def _add_workers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scheduler", metavar="ADDR", help="a Dask scheduler, such as tcp://HOST:8786 (default: local processes)"
    )
    parser.add_argument("--processes", metavar="N", type=int, help="local processes (default: one per core)")


def _add_quantity(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--quantity",
        metavar="NAME",
        action="append",
        help="may be repeated, such as backlash_um (default: all that ages)",
    )


def _add_page(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", metavar="PAGE.html", help="also write an HTML page with plots")
