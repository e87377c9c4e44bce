"""History report of an axis: its figures against the date, a trend line for each, and a table with the campaign of each point."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from hil.figures.history import Moment, trend
from hil.figures.iso230 import symbol
from hil.ui.report import markup
from hil.ui.report.markup import header, page
from hil.ui.report.svg import LIGHT, PAGE, RC, Theme, file_bytes, inline_svg, label_axes, new_figure

_MARKERS = ("o", "s", "D", "^", "v", "P")


def render_history(title: str, moments: Sequence[Moment], names: Sequence[str]) -> str:
    """The report as an HTML page. names: of the figures, such as "A". The same data give the same text."""
    svg = inline_svg(history_figure(moments, names, PAGE), "history", "Figures of ISO 230-2 against the date")
    head = ["Begun", "Axis", "Campaign", "Pass", *map(symbol, names), "°C"]
    body = [
        header(title, f"{len(moments)} campaigns, {_day(moments[0])} to {_day(moments[-1])}"),
        markup.figure(svg, "Figures of ISO 230-2 against the date, with the straight line through each that has one."),
        "<h2>Trend</h2>"
        + markup.table(["Figure", "change in 30 days, µm", ""], _trends(moments, names), css="numbers meaning"),
        "<h2>Campaigns</h2>" + markup.table(head, _rows(moments, names), css="numbers"),
    ]
    return page(title, body)


def history_image(moments: Sequence[Moment], names: Sequence[str]) -> bytes:
    """The drawing as the contents of a PNG file."""
    return file_bytes(history_figure(moments, names, LIGHT), "png")


def history_figure(moments: Sequence[Moment], names: Sequence[str], theme: Theme) -> Figure:
    """The figures, µm, against the date, each with its own marker; its trend, where it has one, as a dashed line."""
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 4.0)
        ax = figure.subplots()
        days = _days(moments)
        colors = (theme.up, theme.down, theme.accent, theme.band, theme.ink, theme.muted)
        for index, name in enumerate(names):
            values = _values(moments, name)
            color, marker = colors[index % len(colors)], _MARKERS[index % len(_MARKERS)]
            ax.plot(days, values, marker=marker, color=color, lw=0.8, ms=5, label=symbol(name))
            if (line := trend(days, values)) is not None:
                known = np.isfinite(values)
                through = values[known].mean() + line.slope_um / 30.0 * (days - days[known].mean())
                ax.plot(days, through, color=color, lw=1.6, linestyle=(0, (4, 1.6)))
        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        if ax.get_ylim()[0] > 0.0:
            ax.set_ylim(bottom=0.0)
        label_axes(ax, theme, "", "µm")
        ax.margins(x=0.03)
        figure.legend(loc="upper left", ncols=6, labelcolor=theme.ink, bbox_to_anchor=(ax.get_position().x0, 1))
        return figure


def _days(moments: Sequence[Moment]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    numbers = [date2num(moment.at.begun) for moment in moments]  # type: ignore[no-untyped-call]
    return np.array(numbers, dtype=np.float64)


def _values(moments: Sequence[Moment], name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([moment.figures_um[name] for moment in moments], dtype=np.float64)


def _trends(moments: Sequence[Moment], names: Sequence[str]) -> list[list[str]]:
    rows = []
    for name in names:
        line = trend(_days(moments), _values(moments, name))
        if line is None:
            rows.append([symbol(name), "–", "fewer than three over a day"])
            continue
        clear = abs(line.slope_um) > 2.0 * line.std_um
        verdict = "clear of its scatter" if clear else "not more than it scatters"
        rows.append([symbol(name), f"{line.slope_um:+.2f} ± {2 * line.std_um:.2f} (k = 2)", verdict])
    return rows


def _rows(moments: Sequence[Moment], names: Sequence[str]) -> list[list[str]]:
    return [
        [
            moment.at.begun.strftime("%Y-%m-%d %H:%M") + ("" if moment.at.dated else " (file)"),
            moment.campaign.axis,
            moment.campaign.directory.name,
            moment.at.name,
            *(markup.number(moment.figures_um[name]) for name in names),
            "–" if math.isnan(moment.mean_temp_c) else f"{moment.mean_temp_c:.1f}",
        ]
        for moment in moments
    ]


def _day(moment: Moment) -> str:
    return moment.at.begun.strftime("%Y-%m-%d")
