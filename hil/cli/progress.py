"""Progress of a procedure on a terminal: its events as a bar, or nothing at all where stderr is no terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from hil.procedures.events import Event, Listener, silent


@contextmanager
def terminal_progress() -> Iterator[Listener]:
    """A listener that shows one bar per stage on stderr."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield silent
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
            if event.stage not in tasks:
                tasks[event.stage] = int(progress.add_task(event.stage, total=event.total or None, note=""))
            task = progress.tasks[tasks[event.stage]].id
            if event.total:
                progress.update(task, completed=event.done, total=event.total, note=event.message)
            else:
                progress.update(task, note=event.message)

        yield show
