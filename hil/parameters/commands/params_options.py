"""Options of `hil params`."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from hil.ui.terminal.options import Subparsers, add_json_option, verb_parser

EXAMPLE = """\
example:
  hil params backup X.toml                                  writes X.params.toml: every parameter that can be put back
  hil params diff X.toml --set X.params.toml                what the drive holds differently
  hil params download X.toml --set new.toml --dry-run       what would be read and written, and how long it takes
  hil params download X.toml --set new.toml --store --audit   also kept by the drive, proven by a restart
  hil params download X.toml Y.toml Z.toml --set new.toml   several drives at once: if one refuses, none is changed
  hil params verify X.toml --set new.toml                   read everything again
  hil params restore X.toml                                 as it was before the last download
  hil params restore X.toml --factory                       the maker's defaults: backed up first, and asked
  hil params resume X.toml                                  finish a download that was cut off; or: rollback

A set is a TOML file, a DCF (.dcf) or a concise DCF (.cdcf). Motion targets, modes and commands, the maker's own too, are never
written; of a DCF they are left out and listed. Parameters are written while the drive is disabled.
Exit status 1: the drive holds something else than asked for; the report says what.
"""


def add_job(
    jobs: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    what: str,
    run: Callable[[argparse.Namespace], int],
    *,
    sets: str | None = None,
) -> argparse.ArgumentParser:
    """Add a job on one or several axis files, with `--json`. sets: help text of `--set`, None for a job without it."""
    parser = jobs.add_parser(
        name, help=what, description=what, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "axes", metavar="AXIS.toml", nargs="+", help="the axis files; drives on one bus are served at once"
    )
    if sets is not None:
        parser.add_argument(
            "--set",
            metavar="FILE",
            action="append",
            default=[],
            dest="sets",
            help=f"{sets}; one for all, or one for each axis",
        )
        parser.add_argument(
            "--without-pdos",
            action="store_true",
            help="leave the PDOs of a DCF out (default: each is written as a whole, in the order of CiA 301)",
        )
        parser.add_argument(
            "--signed", action="store_true", help="refuse a set without the builder's signature beside it (FILE.sig)"
        )
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser


JOBS = {
    "parameters.commands.jobs": {
        "backup": "read every parameter that can be put back, into a file",
        "diff": "what the drive holds differently from a set",
        "verify": "whether the drive holds a set",
        "download": "write a set to the drive: all or nothing, read back",
        "store": "have the drive keep what it was last told",
        "restore": "as before the last download, or as a backup has it",
        "resume": "finish a download that was cut off",
        "rollback": "have everything as it was before a download that was cut off",
    },
    "drive_table.command": {"table": "the correction table that the drive holds itself"},
}
"""Modules in `hil` and the jobs that each adds by `add_jobs(jobs)`. A module is imported when one of its jobs is called: the import
for the table's proof takes longer than a backup."""


class _Job(argparse.ArgumentParser):
    """A job whose arguments are added by its module, which is imported when the job is called. like: class of the real parser."""

    module = ""
    like: type[argparse.ArgumentParser] = argparse.ArgumentParser

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:  # type: ignore[override]
        """Import the module and parse with the job's real parser."""
        parent, _, name = self.prog.rpartition(" ")
        jobs = self.like(prog=parent).add_subparsers(parser_class=self.like)
        import_module(f"hil.{self.module}").add_jobs(jobs)
        return jobs.choices[name].parse_known_args(args, namespace)


def add_parser(subparsers: Subparsers) -> None:
    """Add `hil params`."""
    parser = verb_parser(
        subparsers, "params", "Whole sets of drive parameters, written all or nothing and read back.", EXAMPLE
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True, parser_class=_Job)
    for module, names in JOBS.items():
        for name, text in names.items():
            job = jobs.add_parser(name, help=text, add_help=False)
            job.module, job.like = module, type(parser)
