"""A report as one PDF on numbered A4 sheets, with the contents of the page. The same data give the same bytes.

WeasyPrint renders the page's own markup with `paper.css` (reasons and cost: hil/decisions/0021). Two things differ from the page: the
rows behind the drawings stay in the page, whose hash is at the foot of each sheet; and a table that is wider than a sheet is divided
into groups of columns, one below the other.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stdout
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib as mpl

from drivers.errors import InputError
from hil.ui.report import markup
from hil.ui.report.blocks import Block, DataTable, Drawing, Framed, Heading, ReportTable, said
from hil.ui.report.data import ReportData
from hil.ui.report.document import SIGNS, content, html, under_title
from hil.ui.report.svg import LIGHT, file_bytes

MAX_PAPER_ROWS = 240
"""Most rows of a data table on paper; the page has all."""
SHEET_DIGITS = 108
"""Digits that fit side by side on a sheet, in the size and the bold weight that paper.css gives data tables."""
COLUMN_GAP = 2
"""Space between two columns of data, digits."""
FONTS = {
    ("DejaVu Sans", "normal"): "DejaVuSans.ttf",
    ("DejaVu Sans", "bold"): "DejaVuSans-Bold.ttf",
    ("DejaVu Sans Mono", "normal"): "DejaVuSansMono.ttf",
}
"""Fonts that matplotlib brings, (family, weight) -> file, so that a report does not depend on the computer's fonts."""


def renderer() -> Any:
    """The module weasyprint. Raises InputError with the remedy where it, or the library Pango that it needs, is missing."""
    try:
        with redirect_stdout(io.StringIO()):  # it prints advice to stdout, where a verb or a worker writes its answer
            return import_module("weasyprint")
    except ImportError:
        raise InputError("a PDF needs the extra report-pdf: pip install 'hil[report-pdf]'") from None
    except OSError as error:
        libraries = "libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0"
        raise InputError(f"a PDF needs Pango, on Debian: apt-get install {libraries} ({error})") from None


def render_pdf(data: ReportData, page_sha256: str = "") -> bytes:
    """A report as the contents of a PDF. page_sha256: of its HTML page, printed on each sheet. Raises InputError as `renderer`."""
    foot = f"the same report as a page: SHA-256 {page_sha256}" if page_sha256 else ""
    return write([*on_paper(content(data)), said(SIGNS, "muted")], data.title, under_title(data), foot)


def write(blocks: Iterable[Block], title: str, under: str = "", foot: str = "") -> bytes:
    """Blocks as the contents of a PDF with a title and a line under it. foot: text at the foot of each sheet. Raises as `renderer`."""
    weasyprint = renderer()
    fetcher = weasyprint.urls.URLFetcher(allowed_protocols=("data", "file"))  # nothing is loaded from elsewhere
    page = (
        f'<!DOCTYPE html>\n<html lang="en"><head><title>{markup.text(title)}</title></head><body>\n'
        f'<div class="foot">{markup.text(foot)}</div>{markup.header(title, under)}\n{html(blocks, _image)}\n</body></html>\n'
    )
    style = _fonts() + _resource("style.css") + _resource("paper.css")
    sheet = weasyprint.CSS(string=style, url_fetcher=fetcher)
    written: bytes = weasyprint.HTML(string=page, url_fetcher=fetcher).write_pdf(stylesheets=[sheet])
    return written


def on_paper(blocks: Sequence[Block]) -> list[Block]:
    """The blocks in their order. Data tables that the page shows folded are left to it; the last line names them."""
    folded: list[tuple[str, DataTable]] = []
    kept = list(_kept(blocks, [""], folded))
    if folded:
        shown = "; ".join(
            f"{part}: {table.title[0].lower()}{table.title[1:]}, {len(table)} rows" for part, table in folded
        )
        kept += [
            Heading("Data"),
            said(f"In the page, and in the record files that are named with their hashes: {shown}.", "muted"),
        ]
    return kept


def _kept(blocks: Sequence[Block], under: list[str], folded: list[tuple[str, DataTable]]) -> Iterator[Block]:
    """The blocks that stay in place. folded: filled with the other data tables and their headings; under: text of the last heading."""
    for block in blocks:
        match block:
            case Heading():
                under[0] = block.text
                yield block
            case Framed():
                yield Framed(tuple(_kept(block.blocks, under, folded)))
            case DataTable() if block.unfolded:
                yield from _pieces(block)
            case DataTable():
                folded.append((under[0], block))
            case _:
                yield block


def _pieces(table: DataTable) -> Iterator[ReportTable]:
    """The first `MAX_PAPER_ROWS` rows, as one table per group of columns; the first column is the row number."""
    shown = min(len(table), MAX_PAPER_ROWS)
    cut = f": the first {shown}, the page holds all" if shown < len(table) else ""
    caption = f"{table.title}, {len(table)} rows{cut}"
    cells = {
        name: [markup.cell(name, value) for value in table.columns[name][:shown].tolist()] for name in table.columns
    }
    columns = [(table.heads.get(name, name), *values) for name, values in cells.items()]
    numbers = ("row", *map(str, range(1, shown + 1)))
    for group in groups(numbers, columns):
        head, *rows = zip(*group, strict=True)
        yield ReportTable(head, tuple(rows), "numbers small", caption)


def groups(first: Sequence[str], columns: Sequence[Sequence[str]]) -> list[list[Sequence[str]]]:
    """Columns of cells in groups that fit on a sheet, in their order; each group is `first` and at least one more column."""
    widths = [max(map(len, column)) + COLUMN_GAP for column in (first, *columns)]
    found: list[list[Sequence[str]]] = []
    left = 0
    for column, width in zip(columns, widths[1:], strict=True):
        if not found or width > left:
            found.append([first])
            left = SHEET_DIGITS - widths[0]
        found[-1].append(column)
        left -= width
    return found


def _image(drawing: Drawing) -> str:
    """An img element with the drawing, in the colours for paper and its own size."""
    svg = base64.b64encode(file_bytes(drawing.figure(LIGHT), "svg")).decode()
    return f'<img alt="{markup.text(drawing.description)}" src="data:image/svg+xml;base64,{svg}">'


def _fonts() -> str:
    folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
    return "".join(
        f'@font-face {{ font-family: "{family}"; font-weight: {weight}; src: url("{(folder / name).as_uri()}"); }}\n'
        for (family, weight), name in FONTS.items()
    )


def _resource(name: str) -> str:
    return (files("hil.ui.report") / name).read_text(encoding="utf-8")
