"""`hil params download`."""

from __future__ import annotations

import argparse

from hil.cli.params_options import add_job, load_axes, sets_of, showing
from hil.cli.params_output import print_reports
from hil.params.download import Target, download
from hil.params_wiring import connected_parameters, journal_of


def add_jobs(jobs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_job(jobs, "download", "write a set to the drive: all or nothing, read back", _download, sets="the set")
    parser.add_argument("--store", action="store_true", help="have the drive keep it, after all of it was proven")
    parser.add_argument("--any-version", action="store_true", help="also a set read with another revision or firmware")


def _download(args: argparse.Namespace) -> int:
    """0: every drive holds its set; 1: they were refused, put back, or are unfinished."""
    axes = load_axes(args)
    sets = sets_of(args, axes)
    with connected_parameters(axes) as drives, showing() as progress:
        targets = [
            Target(drive, contents, journal_of(axis), args.any_version)
            for drive, contents, axis in zip(drives, sets, axes, strict=True)
        ]
        reports = download(targets, store=args.store, progress=progress)
    return print_reports(reports, args.json)
