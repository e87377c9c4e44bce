"""What a page shows of the axis's folder: read beside the server's loop, again after each job and whatever was computed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from nicegui import run, ui

from hil.app.panel.view import View

Found = TypeVar("Found")
LOOK_S = 0.5


class Reading(Generic[Found]):
    """value: what was read last, None before it was read for the first time"""

    def __init__(self, view: View, read: Callable[[], Found]) -> None:
        self._view, self._read = view, read
        self._of: object = None
        self.value: Found | None = None
        ui.timer(LOOK_S, self._look)

    def again(self) -> None:
        """Read it again at the next look."""
        self._of = None

    async def _look(self) -> None:
        desk = self._view.desk
        job, computed = desk.job(), desk.computed
        now = (None if job is None else (job.number, job.phase), computed.number, computed.running)
        if now == self._of:
            return
        self._of = now
        await self._view.attempt(self._read_aside)

    async def _read_aside(self) -> None:
        self.value = await run.io_bound(self._read)
