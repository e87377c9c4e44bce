"""Progress of a procedure on a terminal: a bar for each stage, or warnings only where stderr is no terminal; notes of a drive."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.drive import ServoDrive
from hil.machine.events import Event, Listener


@contextmanager
def terminal_progress() -> Iterator[Listener]:
    """A listener that shows one bar per stage on stderr if it is a terminal, and prints warnings in any case."""
    from rich.console import Console  # noqa: PLC0415  (slow to import: an axis is connected before)
    from rich.progress import (  # noqa: PLC0415  (as above)
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _tell_warnings
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console) as progress:
        tasks: dict[str, int] = {}

        def show(event: Event) -> None:
            _tell_warnings(event)
            if event.stage not in tasks:
                tasks[event.stage] = int(progress.add_task(event.stage, total=event.total or None, note=""))
            task = progress.tasks[tasks[event.stage]].id
            if event.total:
                progress.update(task, completed=event.done, total=event.total, note=event.message)
            else:
                progress.update(task, note=event.message)

        yield show


def _tell_warnings(event: Event) -> None:
    if event.warning:
        print(f"hil: {event.message}", file=sys.stderr)


@contextmanager
def telling_notes(drive: ServoDrive) -> Iterator[None]:
    """At its end, on standard error: what was found of the drive inside the block, for an axis without a session."""
    known = len(drive.notes)
    try:
        yield
    finally:
        for note in drive.notes[known:]:
            print(f"hil: {note}", file=sys.stderr)
