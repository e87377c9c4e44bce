"""Options of `hil params`."""

from __future__ import annotations

import argparse

from hil.drive_table.command_options import add_table
from hil.parameters import FORMATS
from hil.ui.terminal.options import Later, Subparsers, add_json_option, verb_parser

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


def _add_job(jobs: Subparsers, name: str, what: str, *, sets: str | None = None) -> argparse.ArgumentParser:
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
    parser.set_defaults(run=Later("hil.parameters.command", name))
    return parser


def add_parser(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers, "params", "Whole sets of drive parameters, written all or nothing and read back.", EXAMPLE
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    _add_reading(jobs)
    _add_writing(jobs)
    _add_recovering(jobs)
    add_table(jobs)


def _add_reading(jobs: Subparsers) -> None:
    backup = _add_job(jobs, "backup", "read every parameter that can be put back, into a file")
    backup.add_argument(
        "--out",
        metavar="FILE",
        action="append",
        default=[],
        help="the file to write; given once for each axis (default: <name>.params.toml)",
    )
    backup.add_argument("--format", choices=FORMATS, help="default: by the file's name, else toml")
    backup.add_argument("--all", action="store_true", dest="everything", help="also the read-only parameters")
    for name, what in (
        ("diff", "what the drive holds differently from a set"),
        ("verify", "whether the drive holds a set"),
    ):
        parser = _add_job(jobs, name, what, sets="the set to compare with")
        parser.add_argument(
            "--any-version", action="store_true", help="also a set read with another revision or firmware"
        )


def _add_writing(jobs: Subparsers) -> None:
    parser = _add_job(jobs, "download", "write a set to the drive: all or nothing, read back", sets="the set")
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="check the set against the drive's file (EDS, map) and predict the time; nothing is sent",
    )
    parser.set_defaults(own_plan=True)
    store = _add_job(
        jobs, "store", "have the drive keep its parameters when it is switched off", sets="what it must hold for that"
    )
    restore = _add_job(
        jobs, "restore", "write back what was there before the last download, or a backup", sets="a backup"
    )
    restore.add_argument(
        "--factory",
        action="store_true",
        help="the maker's defaults instead (1011h), and a restart; backs up and asks first",
    )
    restore.add_argument("--yes", action="store_true", help="with --factory: do not ask")
    for job in (parser, restore):
        job.add_argument("--store", action="store_true", help="have the drive keep it, after all of it was proven")
    for job in (parser, store, restore):
        job.add_argument(
            "--audit", action="store_true", help="after storing, start the drive anew and read all of it again"
        )
        job.add_argument("--any-version", action="store_true", help="also a set read with another revision or firmware")
    for job in (parser, restore):
        job.add_argument(
            "--other-eds", action="store_true", help="also with a maker's file (eds) of another vendor or product"
        )


def _add_recovering(jobs: Subparsers) -> None:
    for name, what in (
        ("resume", "finish a download that was cut off"),
        ("rollback", "take back a download that was cut off: everything as it was before"),
    ):
        parser = _add_job(jobs, name, what)
        parser.set_defaults(run=Later("hil.parameters.command", "recover"), forward=name == "resume")
