"""`hil params resume` and `rollback`: after a power cut, a pulled cable or a killed process."""

from __future__ import annotations

import argparse
from functools import partial

from hil.cli.output import write_json
from hil.cli.params_options import add_job, load_axes, showing
from hil.cli.params_output import print_reports
from hil.params.recover import Unfinished, recover
from hil.params_wiring import connected_parameters, journal_of


def add_jobs(jobs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    add_job(jobs, "resume", "finish a download that was cut off", partial(_recover, forward=True))
    add_job(
        jobs,
        "rollback",
        "have everything as it was before a download that was cut off",
        partial(_recover, forward=False),
    )


def _recover(args: argparse.Namespace, *, forward: bool) -> int:
    """0: finished, or there was nothing to finish; 1: it is still not finished."""
    axes = [axis for axis in load_axes(args) if journal_of(axis).unfinished() is not None]
    if not axes:
        print("nothing to do: no download was cut off")
        if args.json:
            write_json(args.json, {"good": True, "drives": []})
        return 0
    with connected_parameters(axes) as drives, showing() as progress:
        targets = [Unfinished(drive, journal_of(axis)) for drive, axis in zip(drives, axes, strict=True)]
        reports = recover(targets, forward=forward, progress=progress)
    return print_reports(reports, args.json)
