"""Tables of a result: the same columns on the page from the beginning, rows when there are some."""

from __future__ import annotations

from collections.abc import Sequence

from nicegui import ui

from hil.app.panel.view import View


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
