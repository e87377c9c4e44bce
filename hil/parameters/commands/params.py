"""`hil params`: its jobs by name, and what they share: arguments, the set of each axis, progress."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from drivers.errors import InputError
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.machine.events import Event
from hil.parameters.job import load_set
from hil.parameters.set_file import ParameterSet
from hil.parameters.tasks import Progress
from hil.ui.terminal.output import times
from hil.ui.terminal.progress import terminal_progress


def load_axes(args: argparse.Namespace) -> list[DriveAxis]:
    """The axis files of a command line."""
    return [load_drive_axis(path) for path in args.axes]


def sets_of(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> list[ParameterSet]:
    """The set of each axis. Raises InputError unless `--set` is given once or once for each axis, SealedError for a wrong
    signature."""
    if not args.sets:
        raise InputError("--set FILE is missing, expected the set to work with")
    if len(args.sets) not in (1, len(axes)):
        raise InputError(f"--set is given {times(len(args.sets))}, expected once, or once for each axis ({len(axes)})")
    paths = args.sets * len(axes) if len(args.sets) == 1 else args.sets
    return [
        load_set(path, axis, signed=args.signed, pdos=not args.without_pdos)
        for path, axis in zip(paths, axes, strict=True)
    ]


def ask_person(what: str) -> None:
    """Ask the person at the machine to do something, on stderr."""
    print(f"hil: {what}", file=sys.stderr, flush=True)


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """A progress bar for each stage and drive, on a terminal."""
    with terminal_progress() as listener:

        def show(stage: str, drive: str, done: int, total: int) -> None:
            listener(Event(f"{stage}, {drive}", "", done, total))

        yield show
