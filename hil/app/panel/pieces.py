"""Elements shared by several pages: position and step of the axis, contents of its folder, results, tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from nicegui import run, ui

from hil.app.desk.progress import Progress
from hil.app.panel.view import View


def draw_where(view: View, page: str, job: Callable[[], Progress | None]) -> Callable[[], None]:
    """Draw position and step in the present card; returns its refresh function. page: prefix of the names; job: whose step is
    shown."""
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
    """Contents of the axis's folder for a page: read in a worker thread, again after each job and computation.

    value: the last contents, None before the first reading. They are of what was there when that reading began: while a job runs, and
    for a moment after it, `current` is False.
    """

    def __init__(self, view: View, read: Callable[[], Found]) -> None:
        self._view, self._read = view, read
        self._of: object = None
        self._read_of: object = None
        self.value: Found | None = None
        ui.timer(LOOK_S, self._look)

    def again(self) -> None:
        """Read again at the next check."""
        self._of = None

    @property
    def current(self) -> bool:
        """Whether no job or computation has begun or ended since the contents were read."""
        return self._read_of == self._now()

    def _now(self) -> tuple[object, ...]:
        job, computed = self._view.desk.job(), self._view.desk.computed
        return None if job is None else (job.number, job.phase), computed.number, computed.running

    async def _look(self) -> None:
        now = self._now()
        if now == self._of:
            return
        self._of = now
        await self._view.attempt(self._read_aside)

    async def _read_aside(self) -> None:
        now = self._now()
        self.value = await run.io_bound(self._read)
        self._read_of = now


class Latest:
    """The result shown at one place of a page. Results are compared by identity."""

    def __init__(self) -> None:
        self._shown: object = None

    def is_new(self, result: object) -> bool:
        """Whether the result is not shown yet; it then counts as shown. None is never new."""
        new = result is not None and result is not self._shown
        self._shown = result if new else self._shown
        return new


class Table:
    """A table. columns: keys of the headings; the first `words` columns are text, the others figures, unless `figures` names those.
    tall: with its own scroll bar."""

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
        """Show these rows."""
        self._table.rows = [
            {"row": number, **dict(zip(self._columns, row, strict=True))} for number, row in enumerate(rows)
        ]
        self._table.update()
