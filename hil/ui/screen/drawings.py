"""Charts of a finished result, drawn once for each: points with curves, and deviations around a circle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from hil.ui.screen.pieces import Latest
from hil.ui.screen.plots import PALETTES, chart_options, inks, nothing_drawn, pointed_at
from hil.ui.screen.view import View

Points = Sequence[tuple[float, float]]
Options = dict[str, Any]


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


class RedrawnChart:
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
    return {**base, "tooltip": pointed_at(view, "item"), "series": [_series(curve, view) for curve in drawn]}


def _series(curve: Curve, view: View) -> Options:
    colour = inks(view)[0] if curve.faint else PALETTES[view.browser.dark][curve.colour]
    common = {"name": curve.name, "data": short(curve.points), "itemStyle": {"color": colour}, "color": colour}
    if curve.symbol:
        turn = {"symbolRotate": 180} if curve.turned else {}
        return {**common, **turn, "type": "scatter", "symbol": curve.symbol, "symbolSize": 8, "z": 2}
    line = (
        {"color": colour, "width": 1, "type": "dashed", "opacity": 0.5}
        if curve.faint
        else {"color": colour, "width": 3}
    )
    return {**common, "type": "line", "showSymbol": False, "lineStyle": line, "z": 1 if curve.faint else 3}


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


def short(points: Points) -> list[list[float]]:
    """Points as lists of numbers with six digits."""
    return [[float(f"{x:.6g}"), float(f"{y:.6g}")] for x, y in points]
