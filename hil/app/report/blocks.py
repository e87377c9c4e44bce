"""What a report says, piece by piece, before it is a page or paper: `html` and `pdf` make both of the same pieces.

All words are plain text; how a piece looks is for whoever writes it. A drawing is only made when someone asks for it, on the ground
and in the colours that suit them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from matplotlib.figure import FigureBase

from hil.app.report.svg import Ground, Theme, fresh
from hil.records.rows import Floats


@dataclass(frozen=True)
class Heading:
    """level 2: a part of the report, 3: a part of that; tag: a word or two that stand out beside it"""

    text: str
    level: int = 2
    tag: str = ""


@dataclass(frozen=True)
class Span:
    """Words within a paragraph. style: "", "strong" or "muted" """

    text: str
    style: str = ""


@dataclass(frozen=True)
class Paragraph:
    """style: "", "muted", or "callout" for what must not be missed"""

    spans: tuple[Span, ...]
    style: str = ""

    @property
    def text(self) -> str:
        return "".join(span.text for span in self.spans)


def said(text: str, style: str = "") -> Paragraph:
    """A paragraph of plain words."""
    return Paragraph((Span(text),), style)


@dataclass(frozen=True)
class Bullets:
    """Sentences, one below the other."""

    items: tuple[str, ...]
    style: str = ""


@dataclass(frozen=True)
class Tile:
    """One figure to be seen from afar.

    below: a word under it, verdict: a word after that; good: whether the verdict (the value, without one) is good news, None: neither
    """

    name: str
    value: str
    unit: str = ""
    below: str = ""
    verdict: str = ""
    good: bool | None = None


@dataclass(frozen=True)
class Tiles:
    tiles: tuple[Tile, ...]


@dataclass(frozen=True)
class Facts:
    """Names and what they stand for."""

    facts: Mapping[str, str]


@dataclass(frozen=True)
class Table:
    """Cells of text; the first column names its row. style: words among numbers, meaning (its last column is words), hash"""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    style: str = ""
    caption: str = ""


@dataclass(frozen=True)
class DataTable:
    """Columns of numbers of one length, the data behind something. heads: what stands over a column instead of its name

    unfolded: it is part of the report, not only there for whoever asks
    """

    identifier: str
    title: str
    columns: Mapping[str, Floats]
    heads: Mapping[str, str] = field(default_factory=dict)
    unfolded: bool = False

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


@dataclass(frozen=True)
class Drawing:
    """key: sets its ids apart on a page; file: its name as a file of its own; description: for who cannot see it"""

    key: str
    file: str
    draw: Callable[[Theme, Ground], FigureBase]
    description: str
    caption: str = ""

    def figure(self, theme: Theme) -> FigureBase:
        """On a ground of its own."""
        return self.draw(theme, fresh)


@dataclass(frozen=True)
class Finding:
    """What belongs together in a frame."""

    blocks: tuple[Block, ...]


Block = Heading | Paragraph | Bullets | Tiles | Facts | Table | DataTable | Drawing | Finding


def walk(blocks: Iterable[Block]) -> Iterator[Block]:
    """All pieces in their order, those in frames too."""
    for block in blocks:
        if isinstance(block, Finding):
            yield from walk(block.blocks)
        else:
            yield block
