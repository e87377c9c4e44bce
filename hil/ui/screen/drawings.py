"""Charts of a finished result, drawn once for each: points with curves, and deviations around a circle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from hil.lost_motion.page_data import CircleCurves
from hil.ui.screen.pieces import Latest
from hil.ui.screen.plots import (
    FONT,
    PALETTES,
    chart_options,
    inks,
    nothing_drawn,
    number_format,
    one_line_legend,
    pointed_at,
)
from hil.ui.screen.view import View

Points = Sequence[tuple[float, float]]
Options = dict[str, Any]
RINGS = 4
"""Number of rings on each side of the commanded circle."""
_INSIDE = 8
"""Distance from the centre to the innermost ring, in widths of a ring."""


@dataclass(frozen=True)
class Curve:
    """One curve. colour: of PALETTES; symbol: of points that stand alone ("triangle", "circle" …), "" for a line; faint: a thin
    dashed line"""

    name: str
    points: Points
    colour: int
    symbol: str = ""
    faint: bool = False
    turned: bool = False  # the symbol upside down


class Drawing:
    """A chart that is redrawn for each new result. looks: class of the style sheet, "tall" or "round"; empty: key of what it says
    before the first."""

    def __init__(self, view: View, name: str, looks: str = "tall", empty: str = "plot.empty") -> None:
        self._nothing = {"series": [], "title": nothing_drawn(view, empty)}
        self._chart = ui.echart(dict(self._nothing))
        self._chart.classes(f"hil-plot {looks}")
        view.named(self._chart, name)
        self._latest = Latest()

    def show(self, result: object, options: Callable[[], Options]) -> None:
        """Draw a result, unless it is the one that is drawn already."""
        if self._latest.is_new(result):
            self._draw(options())

    def clear(self) -> None:
        """Say that there is nothing."""
        self._latest = Latest()
        self._draw(self._nothing)

    def _draw(self, options: Options) -> None:
        self._chart.options.clear()
        self._chart.options.update(options)
        self._chart.update()


def curves(view: View, x: str, y: str, drawn: Sequence[Curve]) -> Options:
    """Points and lines over straight axes."""
    base = chart_options(view, x, y, legend=True)
    return {
        **base,
        "tooltip": pointed_at(view, "item"),
        "series": [_series(curve, view) for curve in drawn],
    }


def _series(curve: Curve, view: View) -> Options:
    colour = inks(view)[0] if curve.faint else PALETTES[view.browser.dark][curve.colour]
    common = {"name": curve.name, "data": _short(curve.points), "itemStyle": {"color": colour}, "color": colour}
    if curve.symbol:
        turn = {"symbolRotate": 180} if curve.turned else {}
        return {**common, **turn, "type": "scatter", "symbol": curve.symbol, "symbolSize": 8, "z": 2}
    line = (
        {"color": colour, "width": 1, "type": "dashed", "opacity": 0.5}
        if curve.faint
        else {"color": colour, "width": 3}
    )
    return {**common, "type": "line", "showSymbol": False, "lineStyle": line, "z": 1 if curve.faint else 3}


def around_a_circle(view: View, shown: CircleCurves, names: Sequence[str], commanded: str) -> Options:
    """Deviations around the circle, magnified; names: of its curves, in their order."""
    ink, grid = inks(view)
    palette = PALETTES[view.browser.dark]
    ring, reach = shown.ring_um, RINGS * shown.ring_um
    shown_every = f"Math.abs(value) < {reach * 1.01} && Math.round(value / {ring}) % 2 === 0"
    label = f"value => {shown_every} ? ({number_format(view)})(Number(value.toPrecision(6))) : ''"
    looks = [
        (1, {"width": 2, "type": "dashed"}),
        (3, {"width": 2, "type": "dotted"}),
        (5, {"width": 3, "type": "solid"}),
    ]
    if len(shown.traces) < len(looks):
        del looks[1]  # of tables alone, beside the lost motion
    zero = {
        "name": commanded,
        "type": "line",
        "coordinateSystem": "polar",
        "showSymbol": False,
        "silent": True,
        "data": [[0, angle] for angle in range(0, 361, 3)],
        "lineStyle": {"color": ink, "width": 2},
        "itemStyle": {"color": ink},
    }
    traces = [
        {
            "name": name,
            "type": "line",
            "coordinateSystem": "polar",
            "showSymbol": False,
            "connectNulls": False,
            "data": [[None, None] if point is None else list(_short([point])[0]) for point in shown.traces[key]],
            "lineStyle": {"color": palette[colour], **width},
            "itemStyle": {"color": palette[colour]},
        }
        for key, name, (colour, width) in zip(shown.traces, names, looks, strict=False)
    ]
    return {
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "legend": one_line_legend(ink),
        "polar": {"center": ["50%", "54%"], "radius": "78%"},
        "angleAxis": angle_axis(ink, grid),
        "radiusAxis": {
            "type": "value",
            "min": -(RINGS + _INSIDE) * ring,
            "max": reach,
            "interval": ring,
            "axisLabel": {"color": ink, "fontSize": 13, "margin": 4, ":formatter": label},
            "axisTick": {"show": False},
            "axisLine": {"show": False},
            "splitLine": {"lineStyle": {"color": grid}},
        },
        "series": [zero, *traces],
    }


def angle_axis(ink: str, grid: str) -> Options:
    """Degrees, counter-clockwise from the right."""
    return {
        "type": "value",
        "min": 0,
        "max": 360,
        "interval": 45,
        "startAngle": 0,
        "clockwise": False,
        "axisLabel": {"color": ink, "fontSize": 14, ":formatter": "value => value + '°'"},
        "axisLine": {"lineStyle": {"color": grid}},
        "splitLine": {"lineStyle": {"color": grid}},
    }


def _short(points: Points) -> list[list[float]]:
    return [[float(f"{x:.6g}"), float(f"{y:.6g}")] for x, y in points]
