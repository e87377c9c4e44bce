"""Sheets of paper, filled from top to bottom: words, tables, drawings; a new sheet where there is no more room.

A4, lying, so that a drawing stands in its own size and a table has room. Every sheet has a head and a foot with its number, and a
table that goes over several repeats its head. All lengths are in inches, y from the upper edge down. To be used inside
`svg.drawing_settings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure, SubFigure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from hil.app.report.data import plain
from hil.app.report.svg import LIGHT
from hil.app.report.typeset import Letters, groups, shared, wrapped

WIDTH_IN, HEIGHT_IN = 11.69, 8.27
LEFT_IN, TOP_IN, BOTTOM_IN = 0.75, 0.8, 0.7
ROOM_IN = WIDTH_IN - 2 * LEFT_IN
TEXT_IN = 8.2
"""Longer lines are hard to follow."""
GAP_IN = 0.22
"""Between two columns."""

BODY = Letters(8.5, LIGHT.ink)
STRONG = Letters(8.5, LIGHT.ink, bold=True)
MUTED = Letters(7.5, LIGHT.muted)
SMALL = Letters(7.0, LIGHT.ink)
MONO = Letters(6.6, LIGHT.ink, mono=True)
ACCENT = Letters(8.5, LIGHT.accent, bold=True)
GOOD, BAD, PANEL = "#00785a", "#9a4a00", "#f5f7f9"
"""The page's own, by light."""


@dataclass(frozen=True)
class Column:
    """One column of a table. letters: of its cells; right: set against its right edge"""

    head: str
    letters: Letters = BODY
    right: bool = False


class Paper:
    """What is written so far: its sheets, and how far down the last one is filled."""

    def __init__(self) -> None:
        self.sheets: list[Figure] = []
        self._y = HEIGHT_IN

    def room(self, height_in: float) -> None:
        """A new sheet, unless so much is left of this one."""
        if self._y + height_in > HEIGHT_IN - BOTTOM_IN and self._y > TOP_IN:
            self.sheets.append(Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=LIGHT.surface))
            self._y = TOP_IN

    def skip(self, height_in: float) -> None:
        """Room left white; none at the top of a sheet."""
        if self._y > TOP_IN:
            self._y += height_in

    def words(self, text: str, letters: Letters = BODY) -> None:
        """A paragraph."""
        for line in wrapped(text, letters, TEXT_IN):
            self.room(letters.line_in)
            self._line(LEFT_IN, line, letters)
            self._y += letters.line_in

    def heading(self, text: str, letters: Letters, *, keep_in: float, tag: str = "", ruled: bool = False) -> None:
        """A heading that stays with as much of what follows; tag: words that stand out after it."""
        lines = wrapped(text, letters, ROOM_IN)
        self.skip(0.24 if ruled else 0.12)
        self.room(len(lines) * letters.line_in + keep_in)
        if ruled:
            self._rule(LIGHT.grid)
            self._y += 0.08
        for line in lines:
            self._line(LEFT_IN, line, letters)
            self._y += letters.line_in
        if tag:
            self.words(tag, ACCENT)
        self._y += 0.04

    def ground(self, width_in: float, height_in: float) -> SubFigure:
        """A part of the sheet to draw on."""
        self.room(height_in)
        sheet = self.sheets[-1]
        below, right = HEIGHT_IN - self._y - height_in, WIDTH_IN - LEFT_IN - width_in
        grid = GridSpec(
            3, 3, figure=sheet, height_ratios=[self._y, height_in, below], width_ratios=[LEFT_IN, width_in, right]
        )
        self._y += height_in
        return sheet.add_subfigure(grid[1, 1], facecolor="none")

    def table(self, columns: Sequence[Column], rows: Sequence[Sequence[str]], *, wrap: bool = True) -> None:
        """A table; without `wrap`, columns that do not fit beside each other follow below, each time with the first one."""
        if not rows:
            return
        wanted = _wanted(columns, rows)
        for group in [list(range(len(columns)))] if wrap else groups(wanted, ROOM_IN):
            widths = shared([wanted[index] for index in group], ROOM_IN)
            chosen = [columns[index] for index in group]
            self._table(chosen, widths, [[row[index] for index in group] for row in rows])

    def abreast(self, columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> int:
        """How many such tables stand side by side; one at least."""
        return max(1, int(ROOM_IN / sum(_wanted(columns, rows))))

    def _table(self, columns: list[Column], widths: list[float], rows: list[list[str]]) -> None:
        heads = [Column(column.head, _head_letters(column), column.right) for column in columns]
        headed = any(column.head for column in columns)
        for index, row in enumerate(rows):
            lines = _cells(row, columns, widths)
            height = _height(lines, columns)
            head = _cells([column.head for column in columns], heads, widths)
            before = len(self.sheets)
            self.room(height + (_height(head, heads) if headed and index == 0 else 0.0))
            if headed and (index == 0 or len(self.sheets) > before):
                self._row(head, heads, widths)
                self._rule(LIGHT.ink, sum(widths))
            self._row(lines, columns, widths)
            self._rule(LIGHT.grid, sum(widths))
        self._y += 0.1

    def _row(self, lines: list[list[str]], columns: list[Column], widths: list[float]) -> None:
        x = LEFT_IN
        top = self._y
        for cell, column, width in zip(lines, columns, widths, strict=True):
            self._y = top + 0.02
            for line in cell:
                self._line(x + width - GAP_IN if column.right else x, line, column.letters, right=column.right)
                self._y += column.letters.line_in
            x += width
        self._y = top + _height(lines, columns)

    def tiles(self, tiles: Sequence[tuple[str, str, str, str, str]]) -> None:
        """Boxes side by side: name, value with unit, a line below, a word after it, and its colour ("" for none)."""
        height, gap = 0.78, 0.12
        self.room(height)
        width = min((ROOM_IN + gap) / max(len(tiles), 4), 2.6) - gap
        top = self._y
        for index, (name, value, below, verdict, color) in enumerate(tiles):
            x = LEFT_IN + index * (width + gap)
            self._box(x, top, width, height)
            inside = x + 0.1
            value_color = color if color and not verdict else LIGHT.ink
            parts = ((0.07, name, MUTED), (0.24, value, Letters(14.0, value_color, bold=True)), (0.55, below, MUTED))
            for down, text, letters in parts:
                self._y = top + down
                self._line(inside, wrapped(text, letters, width - 0.12)[0], letters)
            if verdict:
                letters = Letters(MUTED.size_pt, color or MUTED.color, bold=True)
                self._line(inside + MUTED.width_in(plain(below)) + 0.08, verdict, letters)
        self._y = top + height + 0.1

    def number(self, left: str, right: str, foot: str) -> None:
        """Heads and feet, when all is written; of `left` and `foot` there is what fits."""
        for index, sheet in enumerate(self.sheets, start=1):
            for y, rule, begin, end in (
                (0.42, 0.62, left, right),
                (HEIGHT_IN - 0.48, HEIGHT_IN - 0.54, foot, f"page {index} of {len(self.sheets)}"),
            ):
                self._y = y
                room = ROOM_IN - MUTED.width_in(plain(end)) - GAP_IN
                self._line(LEFT_IN, wrapped(begin, MUTED, room)[0], MUTED, sheet=sheet)
                self._line(WIDTH_IN - LEFT_IN, end, MUTED, right=True, sheet=sheet)
                self._y = rule
                self._rule(LIGHT.grid, sheet=sheet)

    def _line(
        self, x_in: float, text: str, letters: Letters, *, right: bool = False, sheet: Figure | None = None
    ) -> None:
        if text:
            (sheet or self.sheets[-1]).text(
                x_in / WIDTH_IN,
                1 - (self._y + letters.size_pt / 72.0) / HEIGHT_IN,
                plain(text),
                fontproperties=letters.font,
                color=letters.color,
                ha="right" if right else "left",
                va="baseline",
            )

    def _rule(self, color: str, width_in: float = ROOM_IN, *, sheet: Figure | None = None) -> None:
        y = 1 - self._y / HEIGHT_IN
        ends = [LEFT_IN / WIDTH_IN, (LEFT_IN + width_in) / WIDTH_IN]
        on = sheet or self.sheets[-1]
        on.add_artist(Line2D(ends, [y, y], color=color, linewidth=0.6, transform=on.transFigure))

    def _box(self, x_in: float, y_in: float, width_in: float, height_in: float) -> None:
        sheet = self.sheets[-1]
        corner = (x_in / WIDTH_IN, 1 - (y_in + height_in) / HEIGHT_IN)
        size = (width_in / WIDTH_IN, height_in / HEIGHT_IN)
        sheet.add_artist(
            Rectangle(corner, *size, transform=sheet.transFigure, facecolor=PANEL, edgecolor=LIGHT.grid, linewidth=0.6)
        )


def _head_letters(column: Column) -> Letters:
    return Letters(column.letters.size_pt, LIGHT.ink, bold=True)


def _wanted(columns: Sequence[Column], rows: Sequence[Sequence[str]]) -> list[float]:
    """The width of each column that needs no second line."""
    return [
        GAP_IN
        + max(_head_letters(column).width_in(plain(column.head)), *map(column.letters.width_in, map(plain, cells)))
        for column, cells in zip(columns, zip(*rows, strict=True), strict=True)
    ]


def _cells(row: Sequence[str], columns: Sequence[Column], widths: Sequence[float]) -> list[list[str]]:
    return [
        wrapped(cell, column.letters, width - GAP_IN + 1e-6)
        for cell, column, width in zip(row, columns, widths, strict=True)
    ]


def _height(lines: Sequence[Sequence[str]], columns: Sequence[Column]) -> float:
    return 0.05 + max(len(cell) * column.letters.line_in for cell, column in zip(lines, columns, strict=True))
