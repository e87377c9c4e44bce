"""A report on paper: everything the page says, on sheets with numbers, as one PDF. Same data, same bytes.

What a page folds away, the data behind its drawings, stands at the end, so many rows of each as anyone would look up on paper.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import SubFigure

from hil.app.report import markup, paper
from hil.app.report.blocks import (
    Block,
    Bullets,
    DataTable,
    Drawing,
    Facts,
    Heading,
    Paragraph,
    Table,
    Tile,
    Tiles,
    said,
    walk,
)
from hil.app.report.data import ReportData, plain
from hil.app.report.document import SIGNS, content, under_title
from hil.app.report.paper import Column, Paper
from hil.app.report.svg import LIGHT, drawing_settings
from hil.app.report.typeset import Letters

MAX_PAPER_ROWS = 240
"""Rows of a table of data on paper; the page holds all."""
ROWS_OF_A_SHEET = 36
LEAST_ROWS = 12
"""Of a stack: fewer are not worth another beside it."""

TITLE = Letters(17.0, LIGHT.ink, bold=True)
PART = Letters(12.0, LIGHT.ink, bold=True)
SUBPART = Letters(9.5, LIGHT.ink, bold=True)
KEEP_IN, KEEP_DRAWING_IN, KEEP_TABLE_IN = 1.2, 4.9, 4.0
"""What stays on the sheet of its heading: of anything, a drawing, and at most of a table."""


def render_pdf(data: ReportData, page_sha256: str = "") -> bytes:
    """The whole file. page_sha256: the hash of the same report as a page, named on every sheet."""
    out = io.BytesIO()
    metadata = {"Title": plain(data.title), "CreationDate": None, "Producer": None, "Creator": None}
    with drawing_settings({"pdf.fonttype": 42, "savefig.dpi": 200}), PdfPages(out, metadata=metadata) as pages:
        for sheet in sheets(data, page_sha256).sheets:
            pages.savefig(sheet)
    return out.getvalue()


def sheets(data: ReportData, page_sha256: str = "") -> Paper:
    """The sheets before they are a file. To be called inside `drawing_settings`."""
    written = Paper()
    written.room(1.0)
    written.heading(data.title, TITLE, keep_in=1.0)
    _write(written, [said(under_title(data), "muted"), *content(data), said(SIGNS, "muted")])
    foot = f"the same report as a page: SHA-256 {page_sha256}" if page_sha256 else ""
    written.number(data.title, under_title(data), foot)
    return written


def _write(written: Paper, blocks: Sequence[Block]) -> None:
    """All blocks in their order, then the data that are not part of the report itself."""
    flat = list(walk(blocks))
    folded: list[tuple[str, DataTable]] = []
    under = ""
    for index, block in enumerate(flat):
        if isinstance(block, Heading):
            under = block.text
            follows = next((one for one in flat[index + 1 :] if not isinstance(one, Paragraph)), None)
            _heading(written, block, _kept_in(follows))
        elif isinstance(block, DataTable) and not block.unfolded:
            folded.append((under, block))
        else:
            _block(written, block)
    if folded:
        _heading(written, Heading("Data"), KEEP_IN)
    for part, table in folded:
        _heading(written, Heading(f"{part}: {table.title[0].lower()}{table.title[1:]}", 3), KEEP_IN)
        _data_table(written, table)


def _kept_in(block: Block | None) -> float:
    match block:
        case Drawing():
            return KEEP_DRAWING_IN
        case Table():
            return min(KEEP_TABLE_IN, (len(block.rows) + 3) * 1.4 * paper.BODY.line_in)
    return KEEP_IN


def _heading(written: Paper, block: Heading, keep_in: float) -> None:
    letters = PART if block.level <= 2 else SUBPART
    written.heading(block.text, letters, keep_in=keep_in, tag=block.tag, ruled=block.level <= 2)


def _block(written: Paper, block: Block) -> None:
    match block:
        case Paragraph():
            letters = {"muted": paper.MUTED, "callout": paper.STRONG}.get(block.style, paper.BODY)
            if block.text:
                written.words(block.text, letters)
                written.skip(0.06)
        case Bullets():
            for item in block.items:
                written.words(f"– {item}", paper.MUTED if block.style else paper.BODY)
            written.skip(0.06)
        case Tiles():
            written.tiles([_tile(tile) for tile in block.tiles])
        case Facts():
            rows = [(name, value) for name, value in block.facts.items()]
            written.table([Column("", paper.MUTED), Column("")], rows)
        case Table():
            written.room(_kept_in(block))
            if block.caption:
                written.words(block.caption, paper.MUTED)
            written.table(_columns(block), block.rows)
        case DataTable():
            _data_table(written, block)
        case Drawing():
            written.skip(0.05)
            block.draw(LIGHT, lambda width_in, height_in: _ground(written, width_in, height_in))
            written.words(block.caption, paper.MUTED)
            written.skip(0.1)


def _ground(written: Paper, width_in: float, height_in: float) -> SubFigure:
    written.room(height_in + 2 * paper.MUTED.line_in)  # with its caption
    return written.ground(width_in, height_in)


def _tile(tile: Tile) -> tuple[str, str, str, str, str]:
    color = {True: paper.GOOD, False: paper.BAD, None: ""}[tile.good]
    return tile.name, f"{tile.value} {tile.unit}".strip(), tile.below, tile.verdict, color


def _columns(block: Table) -> list[Column]:
    numbers = block.style in ("numbers", "meaning")
    columns = [Column(block.head[0])]
    columns += [Column(head, paper.MONO if block.style == "hash" else paper.BODY, numbers) for head in block.head[1:]]
    if block.style == "meaning":
        columns[-1] = Column(block.head[-1], paper.MUTED)
    return columns


def _data_table(written: Paper, block: DataTable) -> None:
    """Its rows, in as many stacks side by side as there is room for."""
    shown = min(len(block), MAX_PAPER_ROWS)
    cut = f": the first {shown}, the page holds all" if shown < len(block) else ""
    written.words(f"{block.title}, {len(block)} rows{cut}", paper.MUTED)
    cells = [[str(row + 1) for row in range(shown)]]
    cells += [[markup.cell(name, value) for value in values[:shown].tolist()] for name, values in block.columns.items()]
    columns = [Column("row", paper.SMALL, right=True)]
    columns += [Column(block.heads.get(name, name), paper.SMALL, right=True) for name in block.columns]
    rows = list(zip(*cells, strict=True))
    stacks = 1 if block.unfolded else min(written.abreast(columns, rows), -(-shown // LEAST_ROWS))
    at_once = shown if stacks == 1 else stacks * ROWS_OF_A_SHEET
    for start in range(0, shown, at_once):
        part = rows[start : start + at_once]
        height = -(-len(part) // stacks)
        beside = [part[first : first + height] for first in range(0, height * stacks, height)]
        empty = ("",) * len(columns)
        joined = [sum((stack[row] if row < len(stack) else empty for stack in beside), ()) for row in range(height)]
        written.table(columns * stacks, joined, wrap=False)
