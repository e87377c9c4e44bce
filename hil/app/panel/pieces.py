"""Pieces that several pages are made of: the axis's position and step, what is read from its folder, results, and tables of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from nicegui import run, ui

from hil.app.desk.progress import Progress
from hil.app.panel.view import View


def draw_where(view: View, page: str, job: Callable[[], Progress | None]) -> Callable[[], None]:
    """In the card at hand, with names that begin with the page's; returns what refreshes it. job: whose step is shown."""
    position = view.value("overview.position", "mm", name=f"{page}.position")
    remaining = view.value("overview.remaining", "mm", small=True, name=f"{page}.remaining")
    step = view.value(f"{page}.step", small=True)

    def refresh() -> None:
        position.set_text(view.t.number(view.desk.live.position_load_mm))
        remaining.set_text(view.t.number(view.desk.live.remaining_mm))
        step.set_text(view.stage(job()))

    return refresh


Found = TypeVar("Found")
LOOK_S = 0.5


class Reading(Generic[Found]):
    """What a page shows of the axis's folder: read beside the server's loop, again after each job and whatever was computed.

    value: what was read last, None before it was read for the first time"""

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


class Latest:
    """One place on a page where results are shown. Results are told apart as objects, not by what is in them."""

    def __init__(self) -> None:
        self._shown: object = None

    def is_new(self, result: object) -> bool:
        """Whether this one is not shown yet; from now on it is. Nothing to show (None) is never new."""
        new = result is not None and result is not self._shown
        self._shown = result if new else self._shown
        return new


class Table:
    """columns: keys of their headings; the first `words` of them are words and the others figures, unless `figures` names those. tall:
    it scrolls by itself."""

    def __init__(
        self,
        view: View,
        name: str,
        columns: Sequence[str],
        *,
        words: int = 1,
        figures: Sequence[str] | None = None,
        tall: bool = False,
    ) -> None:
        right = columns[words:] if figures is None else figures
        heads = [
            {"name": key, "label": view.t(key), "field": key, "align": "right" if key in right else "left"}
            for key in columns
        ]
        self._columns = tuple(columns)
        self._table = ui.table(columns=heads, rows=[], row_key="row").classes("hil-table")
        self._table.props("flat dense wrap-cells hide-bottom :rows-per-page-options=[0]")
        if tall:
            self._table.props("virtual-scroll").classes("tall")
        view.named(self._table, name)

    def show(self, rows: Sequence[Sequence[str]]) -> None:
        """All its rows from now on."""
        self._table.rows = [
            {"row": number, **dict(zip(self._columns, row, strict=True))} for number, row in enumerate(rows)
        ]
        self._table.update()
