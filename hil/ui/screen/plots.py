"""Plots that grow point by point: only new points are sent to the browser, which keeps a limited number."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nicegui import ui

from hil.desk.desk import Desk
from hil.desk.live import RATE_HZ, TRACE_S, TracePoint
from hil.ui.screen.view import View

PALETTES = {
    True: ("#56b4e9", "#f08a3c", "#2fc99a", "#e3a0c8", "#f0c542", "#9ad1f2", "#b4b4b4"),
    False: ("#005a8c", "#9a3f00", "#00624a", "#8a3a66", "#6d4a00", "#1b5f8f", "#565656"),
}
"""Colours after Okabe and Ito, distinguishable with colour-blindness; contrast on the dark and the light panel 4.5 or more."""
_DIGITS = 7
_READ_DIGITS = 4
"""Digits after the point of a figure at the pointer: a tenth of a micrometre in mm."""
FONT = "Roboto, 'Hil Signs', 'Noto Sans CJK SC', 'Noto Sans SC', 'Microsoft YaHei', 'PingFang SC', sans-serif"
"""As in the style sheet."""


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
        options["title"] = nothing_drawn(view, "plot.empty")
        self._chart = ui.echart(options)
        self._chart.classes("hil-plot" + (" tall" if tall else ""))
        view.named(self._chart, name)
        self._anew = True
        self._marked: tuple[float | None, str] = (None, "")

    def clear(self) -> None:
        """Remove the drawn points at the next `append`."""
        self._anew = True

    def mark(self, x: float | None, text: str) -> None:
        """Mark a place of the x axis by a line through the plot with a text; None takes it away. Sent when it changes."""
        if self._marked != (x, text):
            self._marked = (x, text)
            place = None if x is None else _short(x)
            self._client.run_javascript(f"hilMarkX({self._chart.id}, {json.dumps(place)}, {json.dumps(text)})")

    def append(self, series: Mapping[str, Sequence[tuple[float, float]]]) -> None:
        """Draw more points of these curves."""
        new = [[name, [[_short(x), _short(y)] for x, y in points]] for name, points in series.items() if points]
        if not new and not self._anew:
            return
        call = f"hilAppend({self._chart.id}, {json.dumps(new)}, {self._keep}, {json.dumps(self._anew)}, {json.dumps(self._dots)})"
        self._anew = False
        self._client.run_javascript(call)


@dataclass(frozen=True)
class Channel:
    """One signal of a live chart. key: of its name; limits: lines, in its unit."""

    key: str
    unit: str
    signal: Callable[[TracePoint], float | None]
    limits: tuple[float, ...] = ()


class LiveChart:
    """Signals of the desk over the last minute, one above the other over one axis of time: seconds ago. The pointer goes through all;
    zoom by wheel or fingers. Targets, stops and faults are marked. Call `refresh` from the page's timer."""

    def __init__(self, view: View, name: str, channels: Sequence[Channel], desk: Desk | None = None) -> None:
        self._view, self._desk, self._channels = view, desk or view.desk, tuple(channels)
        self._chart = view.live(ui.echart({"series": []}), "drive", self._desk)
        self._chart.classes("hil-plot live")
        view.named(self._chart, name)
        self._held = False
        self._seen = 0
        self._anew = True
        self.choose([one.key for one in channels])

    def choose(self, keys: Sequence[str]) -> None:
        """Show the channels with these keys."""
        self._shown = [one for one in self._channels if one.key in keys]
        self._chart.options.clear()
        self._chart.options.update(live_options(self._view, self._shown))
        self._chart.update()
        self._seen, self._anew = 0, True

    def limit(self, key: str, *limits: float) -> None:
        """Draw these limit lines of a channel, from now on."""
        now = next(one for one in self._channels if one.key == key)
        if now.limits != limits:
            shown = [one.key for one in self._shown]
            self._channels = tuple(replace(one, limits=limits) if one is now else one for one in self._channels)
            self.choose(shown)

    def pause(self) -> bool:
        """Hold the picture, or let it go on, and whether it is held now; what comes meanwhile is kept."""
        self._held = not self._held
        self._view.client.run_javascript(f"hilPause({self._chart.id}, {json.dumps(self._held)})")
        return self._held

    def refresh(self) -> None:
        """Send new points."""
        points = self._desk.trace(self._seen)
        if not points:
            return
        if points[0].number != self._seen + 1:
            self._anew = True
        self._seen = points[-1].number
        rows = [
            [round(point.time_s, 3), point.mark, *(_short_or_none(one.signal(point)) for one in self._shown)]
            for point in points
        ]
        call = f"hilLive({self._chart.id}, {json.dumps(rows)}, {_KEEP}, {json.dumps(self._anew)})"
        self._anew = False
        self._view.client.run_javascript(call)


_KEEP = round(TRACE_S * RATE_HZ)


def live_options(view: View, channels: Sequence[Channel]) -> dict[str, Any]:
    """ECharts options of a live chart: a grid for each channel, heights in percent."""
    base = chart_options(view, "", "", legend=False)
    ink, count = base["xAxis"]["axisLabel"]["color"], max(1, len(channels))
    top, bottom, gap = (4.0, 9.0, 5.0) if count > 1 else (9.0, 19.0, 0.0)  # a single one stands on a small card
    height = (100.0 - top - bottom - gap * (count - 1)) / count
    grids, x_axes, y_axes, series = [], [], [], []
    for index, one in enumerate(channels):
        last = index == count - 1
        place = {"top": f"{top + index * (height + gap):.2f}%", "height": f"{height:.2f}%"}
        grids.append({"left": 76, "right": 18, **place, "outerBoundsMode": "none"})
        x_axes.append(
            {
                **base["xAxis"],
                "gridIndex": index,
                "min": -TRACE_S,
                "max": 0,
                "name": view.t("unit.seconds_ago") if last else "",
                "nameGap": 26,
                "axisLabel": {**base["xAxis"]["axisLabel"], "show": last},
            }
        )
        heading = {"color": ink, "fontSize": 14, "align": "left"}
        y_axes.append(
            {
                **base["yAxis"],
                "gridIndex": index,
                "name": _heading(view, one),
                "nameLocation": "end",
                "nameGap": 4,
                "nameTextStyle": heading,
                "splitNumber": 3,
                "axisLine": {"show": True, "onZero": False, "lineStyle": {"color": ink}},
            }
        )
        lines = [{"yAxis": limit} for limit in one.limits]
        limits = {
            "silent": True,
            "symbol": "none",
            "data": lines,
            "lineStyle": {"color": LIMIT[view.browser.dark], "type": "dashed"},
        }
        series.append(
            {
                "id": one.key,
                "name": view.t(one.key),
                "type": "line",
                "showSymbol": False,
                "xAxisIndex": index,
                "yAxisIndex": index,
                "data": [],
                "color": ink,
                "lineStyle": {"width": 1.6},
                "markLine": {**limits, "label": {"show": False}} if lines else {"data": []},
            }
        )
    return {
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "grid": grids,
        "xAxis": x_axes,
        "yAxis": y_axes,
        "series": series,
        "tooltip": base["tooltip"],
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "dataZoom": [{"type": "inside", "xAxisIndex": list(range(count))}],
    }


def _heading(view: View, one: Channel) -> str:
    """Name and unit of a channel, and its limits, as their lines are seen only when the signal comes near."""
    t, name = view.t, f"{view.t(one.key)}, {one.unit}"
    if not one.limits:
        return name
    low, high = min(one.limits), max(one.limits)
    if low == -high:
        return t("plot.limit", name=name, value=t.significant(high))
    return t("plot.limits", name=name, low=t.significant(low), high=t.significant(high))


RAISED = {True: "#2b2f33", False: "#f4f5f5"}
"""Ground of the figures at the pointer, as of what is selected in the style sheet."""
LIMIT = {True: "#ff7c76", False: "#a81318"}
"""Colour of limit lines on the dark and on the light panel."""


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
        self._measurement = view.t.measurement
        self._kinds = (kind,) if isinstance(kind, str) else tuple(kind)
        self._plot = Plot(view, name, x, y, keep=2000, tall=True, legend=True, dots=dots)
        self.mark = self._plot.mark
        self._number = 0  # of the job that is drawn
        self._seen = 0

    def _named(self, series: str, kind: str) -> str:
        """A curve in the page's language: a measurement by its name, with its direction. kind: of the job."""
        name, comma, way = series.rpartition(", ")
        measured = self._measurement(name, kind)
        return self._said(series) if not comma or measured == name else f"{measured}{comma}{way}"

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
                shown.setdefault(self._named(self._as_one(name), job.kind), []).extend(points)
            self._plot.append(shown)


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _short_or_none(value: float | None) -> float | None:
    return None if value is None else _short(value)


def chart_options(view: View, x: str, y: str, *, legend: bool) -> dict[str, Any]:
    """ECharts options of a chart without curves, in the browser's colours. x, y: axis titles."""
    ink, grid = inks(view)
    read = number_format(view, _READ_DIGITS)
    axis = {
        "type": "value",
        "scale": True,
        "nameLocation": "middle",
        "nameTextStyle": {"color": ink, "fontSize": 16},
        "axisLabel": {"color": ink, "fontSize": 14, ":formatter": number_format(view)},
        "axisPointer": {"label": {":formatter": f"at => ({read})(at.value)"}},
        "splitLine": {"lineStyle": {"color": grid}},
    }
    return {
        "color": list(PALETTES[view.browser.dark]),
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "grid": {"left": 80, "right": 20, "top": 40 if legend else 20, "bottom": 50},
        "legend": {**one_line_legend(ink), "show": legend},
        "tooltip": pointed_at(view, "axis"),
        "xAxis": {**axis, "name": x, "nameGap": 30},
        "yAxis": {**axis, "name": y, "nameGap": 60},
        "series": [],
    }


def one_line_legend(ink: str) -> dict[str, Any]:
    """The names of the curves above a chart. What does not fit in the line is turned to, so that it never covers the curves."""
    turned = {"pageIconColor": ink, "pageIconSize": 20, "pageTextStyle": {"color": ink}}
    looks = {"itemWidth": 18, "itemHeight": 12, "itemGap": 10, "textStyle": {"color": ink, "fontSize": 14}}
    return {"show": True, "type": "scroll", "top": 0, "left": 0, "right": 0, **looks, **turned}


def nothing_drawn(view: View, key: str) -> dict[str, Any]:
    """The title of a chart without curves: a sentence in its middle."""
    quiet = "#aeb4ba" if view.browser.dark else "#474d53"
    look = {"color": quiet, "fontSize": 16, "fontWeight": "normal", "fontFamily": FONT}
    return {"text": view.t(key), "left": "center", "top": "middle", "textStyle": look}


def pointed_at(view: View, trigger: str) -> dict[str, Any]:
    """The figures at the pointer, in the page's numbers, colours and font.

    trigger: "axis" for all curves at a place, "item" for a point
    """
    ink, grid = inks(view)
    return {
        "trigger": trigger,
        "className": "hil-pointed",
        "backgroundColor": RAISED[view.browser.dark],
        "borderColor": grid,
        "textStyle": {"color": ink, "fontSize": 14, "fontFamily": FONT},
        ":valueFormatter": f"value => [value].flat().map({number_format(view, _READ_DIGITS)}).join('; ')",
    }


def number_format(view: View, digits: int = 6) -> str:
    """A function in JavaScript that writes a number as the page's language does, a dash for none.

    digits: most of them after the point
    """
    how = f"{{useGrouping: false, maximumFractionDigits: {digits}}}"
    written = f"new Intl.NumberFormat('{view.t.language}', {how}).format(value).replace('-', '−')"
    return f"value => (value ?? null) === null ? '–' : {written}"


def inks(view: View) -> tuple[str, str]:
    """The colours of text and of grid lines."""
    return ("#eceeef", "#33383d") if view.browser.dark else ("#15181b", "#c3c7cb")
