"""Plots that grow point by point: only new points are sent to the browser, which keeps a limited number."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nicegui import ui

from hil.app.desk.desk import Desk
from hil.app.desk.live import RATE_HZ, TRACE_S, TracePoint
from hil.app.panel.view import View

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999")
"""Colours of Okabe and Ito, distinguishable with colour-blindness."""
_DIGITS = 7


class Plot:
    """A chart of curves. x, y: axis titles with units; keep: points kept per curve; dots: points without lines."""

    def __init__(
        self,
        view: View,
        name: str,
        x: str,
        y: str,
        *,
        keep: int,
        tall: bool = False,
        legend: bool = False,
        dots: bool = False,
    ):
        self._client = view.client
        self._dots = dots
        self._keep = keep
        options = chart_options(view, x, y, legend=legend)
        if dots:
            options["legend"] |= {"itemWidth": 14, "itemHeight": 12}
        self._chart = ui.echart(options)
        self._chart.classes("hil-plot" + (" tall" if tall else ""))
        view.named(self._chart, name)
        self._anew = True

    def clear(self) -> None:
        """Remove the drawn points at the next `append`."""
        self._anew = True

    def append(self, series: Mapping[str, Sequence[tuple[float, float]]]) -> None:
        """Draw more points of these curves."""
        new = [[name, [[_short(x), _short(y)] for x, y in points]] for name, points in series.items() if points]
        if not new and not self._anew:
            return
        call = f"hilAppend({self._chart.id}, {json.dumps(new)}, {self._keep}, {json.dumps(self._anew)}, {json.dumps(self._dots)})"
        self._anew = False
        self._client.run_javascript(call)


class LivePlot:
    """One signal of the desk over the last minute. Call `refresh` from the page's timer."""

    def __init__(
        self, view: View, key: str, unit: str, signal: Callable[[TracePoint], float | None], desk: Desk | None = None
    ):
        self._desk = desk or view.desk
        self._signal = signal
        self._name = view.t(key)
        self._plot = Plot(view, f"plot.{key}", view.t("unit.seconds"), f"{self._name}, {unit}", keep=_KEEP)
        self._seen = 0

    def refresh(self) -> None:
        """Draw new points."""
        points = self._desk.trace(self._seen)
        if not points:
            return
        if points[0].number != self._seen + 1:
            self._plot.clear()
        self._seen = points[-1].number
        pairs = [(point.time_s, value) for point in points if (value := self._signal(point)) is not None]
        self._plot.append({self._name: pairs})


_KEEP = round(TRACE_S * RATE_HZ)


class JobPlot:
    """The curves of the last job of a kind, or of some kinds. Call `refresh` from the page's timer.

    as_one: series that it gives the same name are drawn as one
    """

    def __init__(
        self,
        view: View,
        kind: str | Sequence[str],
        x: str,
        y: str,
        *,
        name: str,
        dots: bool = False,
        as_one: Callable[[str], str] = str,
    ):
        self._desk, self._said, self._as_one = view.desk, view.t.said, as_one
        self._kinds = (kind,) if isinstance(kind, str) else tuple(kind)
        self._plot = Plot(view, name, x, y, keep=2000, tall=True, legend=True, dots=dots)
        self._number = 0  # of the job that is drawn
        self._seen = 0

    def refresh(self) -> None:
        """Draw new points; a new job starts with an empty plot."""
        job = self._desk.last_of(self._kinds)
        if job is None:
            return
        if job.number != self._number:
            self._number, self._seen = job.number, 0
            self._plot.clear()
        graph = self._desk.graph(job.kind, self._seen)
        if graph.points != self._seen or self._seen == 0:
            self._seen = graph.points
            shown: dict[str, list[tuple[float, float]]] = {}
            for name, points in graph.series.items():
                shown.setdefault(self._said(self._as_one(name)), []).extend(points)
            self._plot.append(shown)


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def chart_options(view: View, x: str, y: str, *, legend: bool) -> dict[str, Any]:
    """ECharts options of a chart without curves, in the browser's colours. x, y: axis titles."""
    ink = "#f2f2ee" if view.browser.dark else "#14181c"
    grid = "#39424a" if view.browser.dark else "#c3c8cc"
    axis = {
        "type": "value",
        "scale": True,
        "nameLocation": "middle",
        "nameTextStyle": {"color": ink, "fontSize": 16},
        "axisLabel": {"color": ink, "fontSize": 14},
        "splitLine": {"lineStyle": {"color": grid}},
    }
    return {
        "color": list(COLOURS),
        "animation": False,
        "grid": {"left": 80, "right": 20, "top": 40 if legend else 20, "bottom": 50},
        "legend": {"type": "scroll", "show": legend, "top": 0, "textStyle": {"color": ink, "fontSize": 14}},
        "tooltip": {"trigger": "axis"},
        "xAxis": {**axis, "name": x, "nameGap": 30},
        "yAxis": {**axis, "name": y, "nameGap": 60},
        "series": [],
    }
