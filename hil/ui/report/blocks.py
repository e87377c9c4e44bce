"""Blocks of a report: headings, paragraphs, tables, drawings. The HTML page and the PDF are made of the same blocks.

Texts are plain, without markup; the layout is that of the output. A drawing is made on request, in the colours of the output.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from matplotlib.figure import FigureBase

from hil.records.rows import Floats
from hil.ui.report.svg import Ground, Theme, fresh


@dataclass(frozen=True)
class Heading:
    """A heading. level: 2 for a section, 3 for a subsection; tag: a highlighted word or two beside it."""

    text: str
    level: int = 2
    tag: str = ""


@dataclass(frozen=True)
class TextSpan:
    """Text within a paragraph. style: "", "strong" or "muted"."""

    text: str
    style: str = ""


@dataclass(frozen=True)
class Paragraph:
    """A paragraph. style: "", "muted", or "callout" for a warning."""

    spans: tuple[TextSpan, ...]
    style: str = ""

    @property
    def text(self) -> str:
        return "".join(span.text for span in self.spans)


def said(text: str, style: str = "") -> Paragraph:
    return Paragraph((TextSpan(text),), style)


@dataclass(frozen=True)
class Bullets:
    """A list of sentences. style: a class of style.css, "" for none."""

    items: tuple[str, ...]
    style: str = ""


@dataclass(frozen=True)
class Tile:
    """One number in large type.

    below: text under it; verdict: text after that; good: whether the verdict, or the value without one, is coloured as good or as bad;
    None: neutral
    """

    name: str
    value: str
    unit: str = ""
    below: str = ""
    verdict: str = ""
    good: bool | None = None


@dataclass(frozen=True)
class Tiles:
    """Large numbers side by side."""

    tiles: tuple[Tile, ...]


@dataclass(frozen=True)
class Facts:
    """A list of names, each with its value."""

    facts: Mapping[str, str]


@dataclass(frozen=True)
class ReportTable:
    """Cells of text; the first column names the row. style: "words" among numbers, "meaning" (the last column is text), "hash"."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    style: str = ""
    caption: str = ""


@dataclass(frozen=True)
class DataTable:
    """Columns of numbers of one length. heads: headings in place of column names; unfolded: whether its rows are shown at once."""

    identifier: str
    title: str
    columns: Mapping[str, Floats]
    heads: Mapping[str, str] = field(default_factory=dict)
    unfolded: bool = False

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


@dataclass(frozen=True)
class Drawing:
    """A drawing. key: prefix of its ids on a page; file: its file name; description: alternative text."""

    key: str
    file: str
    draw: Callable[[Theme, Ground], FigureBase]
    description: str
    caption: str = ""

    def figure(self, theme: Theme) -> FigureBase:
        return self.draw(theme, fresh)


@dataclass(frozen=True)
class Framed:
    """Blocks within one frame."""

    blocks: tuple[Block, ...]


Block = Heading | Paragraph | Bullets | Tiles | Facts | ReportTable | DataTable | Drawing | Framed


def walk(blocks: Iterable[Block]) -> Iterator[Block]:
    """All blocks in order, also those within frames, without the frames."""
    for block in blocks:
        if isinstance(block, Framed):
            yield from walk(block.blocks)
        else:
            yield block
