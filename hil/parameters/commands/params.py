"""`hil params`: drive parameters as whole sets."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from hil.parameters.commands.options import EXAMPLE

JOBS = {
    "parameters.commands.files": {
        "backup": "read every parameter that can be put back, into a file",
        "diff": "what the drive holds differently from a set",
        "verify": "whether the drive holds a set",
    },
    "parameters.commands.download": {
        "download": "write a set to the drive: all or nothing, read back",
        "store": "have the drive keep what it was last told",
        "restore": "as before the last download, or as a backup has it",
    },
    "parameters.commands.recover": {
        "resume": "finish a download that was cut off",
        "rollback": "have everything as it was before a download that was cut off",
    },
    "drive_table.command": {"table": "the correction table that the drive holds itself"},
}
"""Modules in `hil` and the jobs that each brings by its `add_jobs(jobs)`. A module is loaded when a job of it is asked for: the
table's proof takes longer to load than a backup takes."""


class _Job(argparse.ArgumentParser):
    """A job that is described by its module, which is loaded when the job is called for. like: the parser that it becomes."""

    module = ""
    like: type[argparse.ArgumentParser] = argparse.ArgumentParser

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:  # type: ignore[override]
        parent, _, name = self.prog.rpartition(" ")
        jobs = self.like(prog=parent).add_subparsers(parser_class=self.like)
        import_module(f"hil.{self.module}").add_jobs(jobs)
        return jobs.choices[name].parse_known_args(args, namespace)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "params",
        description="Whole sets of drive parameters, written all or nothing and read back.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True, parser_class=_Job)
    for module, names in JOBS.items():
        for name, text in names.items():
            job = jobs.add_parser(name, help=text, add_help=False)
            job.module, job.like = module, type(parser)
