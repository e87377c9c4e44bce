"""`hil params`: drive parameters as whole sets."""

from __future__ import annotations

import argparse
from importlib import import_module

from hil.cli.params_options import EXAMPLE

JOBS = ("params_files", "params_download", "params_recover", "params_table")
"""Modules of `hil.cli` that bring jobs, in the order of the help; each has `add_jobs(jobs)`."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "params",
        help="drive parameters: back up, compare, download all or nothing, prove, keep",
        description="Whole sets of drive parameters, written all or nothing and read back.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    for module in JOBS:
        import_module(f"hil.cli.{module}").add_jobs(jobs)
