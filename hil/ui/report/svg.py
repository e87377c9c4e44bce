"""A matplotlib figure as bytes: SVG for a page, SVG or PNG as a file. The same figure gives the same bytes.

Within a page the colours are CSS variables, so that one drawing is used on a light and on a dark page: figures are drawn with the
placeholder colours of `PAGE`, which `inline_svg` replaces. The result loads nothing from elsewhere.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure, FigureBase

from hil.ui.report.markup import text as text_of


@dataclass(frozen=True)
class Theme:
    """Colours by their use. up, down: directions + and -; accent: curves over the data; band: a specified band."""

    ink: str
    muted: str
    grid: str
    up: str
    down: str
    accent: str
    band: str
    surface: str


LIGHT = Theme(
    ink="#1b2430",
    muted="#5b6673",
    grid="#d9dee4",
    up="#0072b2",
    down="#d55e00",
    accent="#7a3b8f",
    band="#009e73",
    surface="#ffffff",
)
"""Theme of separate files. Directions and band have colours by Okabe and Ito, which differ for people with any colour vision."""

PAGE = Theme(
    ink="#0a0001",
    muted="#0a0002",
    grid="#0a0003",
    up="#0a0004",
    down="#0a0005",
    accent="#0a0006",
    band="#0a0007",
    surface="#0a0008",
)
"""Placeholder colours that `inline_svg` replaces by the page's variables --plot-ink, --plot-muted, …"""

RC: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.id": None,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.linewidth": 0.6,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "path.simplify": True,
    "text.parse_math": False,
}
"""matplotlib settings, in force only while a figure is made or written."""


AnyFigure = TypeVar("AnyFigure", bound=FigureBase)
Ground = Callable[[float, float], FigureBase]
"""Makes the empty figure to draw on; width and height in inches."""


def fresh(width_in: float, height_in: float) -> Figure:
    """A new, transparent figure; width and height in inches."""
    return Figure(figsize=(width_in, height_in), facecolor="none")


def new_figure(width_in: float, height_in: float, *, top_in: float = 0.4, left_in: float = 0.68) -> Figure:
    """A new, transparent figure with margins for labels on the left and below, and for a legend above; lengths in inches."""
    return figure_on(fresh, width_in, height_in, top_in=top_in, left_in=left_in)


def figure_on(
    ground: Callable[[float, float], AnyFigure],
    width_in: float,
    height_in: float,
    *,
    right_in: float = 0.12,
    top_in: float = 0.4,
    left_in: float = 0.68,
) -> AnyFigure:
    """As `new_figure`, on the figure that `ground` makes, such as a part of a sheet.

    The margins are fixed: a layout engine would draw everything twice to find them.
    """
    figure = ground(width_in, height_in)
    figure.subplots_adjust(
        left=left_in / width_in,
        right=1 - right_in / width_in,
        bottom=0.5 / height_in,
        top=1 - top_in / height_in,
        wspace=0.06,
        hspace=0.08,
    )
    return figure


def label_axes(ax: Axes, theme: Theme, x: str, y: str) -> None:
    """Set the names of both axes, and draw grid and frame in the colours of the theme."""
    ax.set_xlabel(x, color=theme.ink)
    ax.set_ylabel(y, color=theme.ink)
    ax.grid(True, color=theme.grid)
    ax.set_axisbelow(True)
    ax.set_facecolor("none")
    ax.tick_params(colors=theme.muted, length=3)
    for spine in ax.spines.values():
        spine.set_color(theme.muted)


def inline_svg(figure: FigureBase, name: str, description: str) -> str:
    """The figure as an <svg> element for an HTML page. name: prefix of its ids, unique on the page; description: alternative text."""
    text = _svg(figure, name)
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r'\sid="([^"]+)"', lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    for job, color in asdict(PAGE).items():
        text = text.replace(color, f"var(--plot-{job})")
    text = text.replace("font: ", "font-family: inherit; font: ").replace(
        "'DejaVu Sans', sans-serif", "var(--plot-font)"
    )
    text = text.replace("'DejaVu Sans'", "var(--plot-font)")
    text = re.sub(r'(<svg[^>]*?)\swidth="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?)\sheight="[^"]*"', r"\1", text, count=1)
    return text.replace("<svg", f'<svg role="img" aria-label="{text_of(description)}"', 1).strip()


PNG_DPI = 160


def file_bytes(figure: FigureBase, kind: str) -> bytes:
    """The figure as the contents of a file, on a white ground. kind: "png" or "svg"."""
    figure.set_facecolor(LIGHT.surface)
    if kind == "svg":
        return _svg(figure, "hil").encode("utf-8")
    out = io.BytesIO()
    with drawing_settings():
        canvas: Any = FigureCanvasAgg(_whole(figure))
        _whole(figure).set_dpi(PNG_DPI)
        canvas.print_png(out, metadata={"Software": None})
    return out.getvalue()


def _svg(figure: FigureBase, salt: str) -> str:
    out = io.StringIO()
    with drawing_settings({"svg.hashsalt": salt}):
        canvas: Any = FigureCanvasSVG(_whole(figure))
        canvas.print_svg(out, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return out.getvalue()


def _whole(figure: FigureBase) -> Figure:
    """The figure as one that can be written. Raises TypeError for a part of another figure."""
    if not isinstance(figure, Figure):
        raise TypeError("a part of a figure cannot be written by itself")
    return figure


@contextmanager
def drawing_settings(extra: Mapping[Any, Any] | None = None) -> Iterator[None]:
    """Inside, the settings of `RC` and `extra` are in force, and no warning is given for letters that the font lacks.

    Browsers have these letters; a PNG shows a box.
    """
    with mpl.rc_context({**RC, **(extra or {})}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        yield
