"""What the jobs of `hil params` share: their arguments, which set belongs to which axis, and their progress."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from drivers.errors import InputError
from hil.app.terminal.output import add_json_option
from hil.app.terminal.progress import terminal_progress
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.machine.events import Event
from hil.parameters.job import load_set
from hil.parameters.set_file import ParameterSet
from hil.parameters.works import Progress

EXAMPLE = """\
example:
  hil params backup X.toml                                  writes X.params.toml: every parameter that can be put back
  hil params diff X.toml --set X.params.toml                what the drive holds differently
  hil params download X.toml --set new.toml --dry-run       what would be looked at, and how long it takes
  hil params download X.toml --set new.toml --store --audit all or nothing, read back, kept, proven by a restart
  hil params download X.toml Y.toml Z.toml --set new.toml   several drives at once: if one refuses, none is changed
  hil params verify X.toml --set new.toml                   read everything again
  hil params restore X.toml                                 as it was before the last download
  hil params resume X.toml                                  finish a download that was cut off; or: rollback

A set is a TOML file, a DCF (.dcf) or a concise DCF (.cdcf). Motion targets, modes and commands are never written. Parameters are
written while the drive is disabled. Exit status 1: the drive holds something else than asked for; the report says what.
"""


def add_job(
    jobs: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    what: str,
    run: Callable[[argparse.Namespace], int],
    *,
    sets: str | None = None,
) -> argparse.ArgumentParser:
    """A job on one or several axis files with `--json`. sets: what `--set` is for, None for a job without one."""
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
            "--signed", action="store_true", help="refuse a set without the builder's signature beside it (FILE.sig)"
        )
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser


def load_axes(args: argparse.Namespace) -> list[DriveAxis]:
    """The axis files of a command line."""
    return [load_drive_axis(path) for path in args.axes]


def sets_of(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> list[ParameterSet]:
    """The set of each axis. Raises InputError where there are neither one nor as many as axes, SealedError for a wrong signature."""
    if not args.sets:
        raise InputError("--set FILE is missing, expected the set to work with")
    if len(args.sets) not in (1, len(axes)):
        raise InputError(f"--set is given {len(args.sets)} times, expected once, or once for each of {len(axes)} axes")
    paths = args.sets * len(axes) if len(args.sets) == 1 else args.sets
    return [load_set(path, axis, signed=args.signed) for path, axis in zip(paths, axes, strict=True)]


def tell_person(what: str) -> None:
    """Ask somebody at the machine for something."""
    print(f"hil: {what}", file=sys.stderr, flush=True)


@contextmanager
def showing() -> Iterator[Progress]:
    """A bar for each stage and drive, on a terminal."""
    with terminal_progress() as listener:

        def show(stage: str, drive: str, done: int, total: int) -> None:
            listener(Event(f"{stage}, {drive}", "", done, total))

        yield show
