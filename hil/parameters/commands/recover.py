"""`hil params resume` and `rollback`: after a power cut, a pulled cable or a killed process."""

from __future__ import annotations

import argparse
from functools import partial

from hil.app.terminal.output import write_json
from hil.parameters.commands.options import add_job, load_axes, showing
from hil.parameters.commands.output import print_reports
from hil.parameters.job import recover_axes


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
    with showing() as progress:
        reports = recover_axes(load_axes(args), forward=forward, progress=progress)
    if not reports:
        print("nothing to do: no download was cut off")
        if args.json:
            write_json(args.json, {"good": True, "drives": []})
        return 0
    return print_reports(reports, args.json)
