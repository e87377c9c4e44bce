"""Pages of a fleet: what to look at first, the courses of what alarms, axes beside each other, causes over all axes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import FigureBase
from matplotlib.ticker import MaxNLocator

from hil.fleet.ageing import Aged, ComparedAxes, FleetTrend
from hil.fleet.causes import Cause, counted
from hil.fleet.values import QUANTITIES
from hil.fleet.words import (
    MEMORY,
    TREND_HEAD,
    causes_head,
    causes_row,
    compare_head,
    compare_row,
    compare_rule,
    trend_row,
)
from hil.ui.report.blocks import Block, Bullets, Drawing, Facts, Heading, Paragraph, ReportTable, TextSpan, said
from hil.ui.report.document import html
from hil.ui.report.markup import header, page, significant
from hil.ui.report.svg import RC, Ground, Theme, figure_on, label_axes

MOST_DRAWN = 12
"""Most series that are drawn on a page of trends."""
MOST_ROWS = 500
"""Most lines of a table on a page; the JSON has all."""


def _page(title: str, under: str, blocks: Sequence[Block]) -> str:
    return page(title, [header(title, under), html(blocks)])


def render_trend(found: FleetTrend, under: str, unread: Sequence[str]) -> str:
    """The page of `hil fleet trend`. unread: campaigns that could not be read, with the reason."""
    alarms = found.alarms
    lead = f"{len(alarms)} of {len(found.aged)} series alarm." if alarms else f"No alarm in {len(found.aged)} series."
    blocks: list[Block] = [
        Paragraph((TextSpan(lead, "strong"),), "callout" if alarms else ""),
        said(f"{found.stated()}.", "muted"),
    ]
    if found.remembers:
        blocks.append(said(MEMORY.format(found.memory, 2.0 * found.memory_std), "callout"))
    drawn = found.aged[: max(len(alarms), 1)][:MOST_DRAWN]
    blocks.append(Heading("What to look at first"))
    blocks.append(ReportTable(TREND_HEAD, tuple(map(trend_row, found.aged[:MOST_ROWS])), "words"))
    if len(found.aged) > MOST_ROWS:
        blocks.append(said(f"{len(found.aged) - MOST_ROWS} more are in the JSON.", "muted"))
    for at, one in enumerate(drawn, 1):
        name = f"{one.series.about.title} of axis {one.series.axis}"
        caption = (
            f"{name} ({one.series.what}): values with k = 2 by their own repeats; below, the CUSUM of their scores and its threshold."
            " Dashed: where the change began and where it was found."
        )
        blocks += [Heading(name, 3), Drawing(f"series{at}", f"series-{at}", partial(series_figure, one), name, caption)]
    return _page(
        "What ages in the fleet",
        under,
        [*blocks, *_left_out(unread, [f"axis {one.axis}, {one.about.title}" for one in found.short])],
    )


def _left_out(unread: Sequence[str], short: Sequence[str]) -> list[Block]:
    blocks: list[Block] = []
    if unread:
        blocks += [Heading("Not read"), Bullets(tuple(unread[:MOST_ROWS]), "remarks")]
    if short:
        blocks += [Heading("Too few values to watch"), Bullets(tuple(short[:MOST_ROWS]), "remarks")]
    return blocks


def series_figure(one: Aged, theme: Theme, ground: Ground) -> FigureBase:
    """Values against the date, and below them the CUSUM against its threshold."""
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 4.6)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        series, watched = one.series, one.watched
        when = np.array([date2num(each) for each in series.begun])  # type: ignore[no-untyped-call]
        known = np.isfinite(series.std)
        above.errorbar(
            when, series.value, 2.0 * np.where(known, series.std, 0.0), color=theme.up, marker="o", ms=3.5, lw=0.8
        )
        if one.growth is not None and (alarm := one.alarm) is not None:
            here = slice(alarm.onset, None)
            through = series.value[here].mean() + one.growth.slope_um / 30.0 * (when[here] - when[here].mean())
            above.plot(when[here], through, color=theme.accent, lw=1.8)
        below.plot(when, watched.up, color=theme.up, marker=".", lw=0.9, label="rising")
        if series.about.either or watched.begun:
            below.plot(
                when, watched.down, color=theme.down, marker=".", lw=0.9, linestyle=(0, (4, 1.6)), label="falling"
            )
        below.axhline(watched.threshold, color=theme.band, lw=1.4, label="threshold")
        for ax in (above, below):
            for alarm in watched.alarms:
                ax.axvline(when[alarm.onset], color=theme.muted, lw=0.9, linestyle=(0, (4, 3)))
                ax.axvline(when[alarm.at], color=theme.accent, lw=0.9, linestyle=(0, (4, 3)))
        label_axes(above, theme, "", f"{series.about.title}, {series.about.unit}")
        label_axes(below, theme, "", "CUSUM, σ")
        _dates(below)
        figure.legend(loc="upper left", ncols=4, labelcolor=theme.ink, bbox_to_anchor=(above.get_position().x0, 1))
        return figure


def _dates(ax: Axes) -> None:
    locator = AutoDateLocator()  # type: ignore[no-untyped-call]
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


def render_compare(found: Sequence[ComparedAxes], under: str, unread: Sequence[str]) -> str:
    """The page of `hil fleet compare`."""
    blocks: list[Block] = []
    for one in found:
        about = QUANTITIES[one.quantity]
        facts = {
            "Axes": str(len(one.axes)),
            "Median": f"{significant(one.median)} {about.unit}",
            "Spread (1.48 × median absolute deviation)": f"{significant(one.spread, 3)} {about.unit}",
        }
        drawing = Drawing(
            one.quantity,
            one.quantity,
            partial(compare_figure, one),
            f"{about.title} of all axes",
            f"{about.title} of each axis, the mean of its last values, in order; lines: median, and the limit on either side.",
        )
        rows = tuple(compare_row(each, one) for each in one.axes[:MOST_ROWS])
        blocks += [
            Heading(about.title),
            Facts(facts),
            said(compare_rule(one), "muted"),
            drawing,
            ReportTable(compare_head(one), rows, "words"),
        ]
    return _page("Axes beside each other", under, [*blocks, *_left_out(unread, ())])


def compare_figure(one: ComparedAxes, theme: Theme, ground: Ground) -> FigureBase:
    """The levels of all axes in order of size."""
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 3.2)
        ax = figure.subplots()
        axes = sorted(one.axes, key=lambda each: each.level)
        at = np.arange(1, len(axes) + 1)
        levels = np.array([each.level for each in axes])
        unlike = np.array([each.unlike for each in axes])
        ax.axhline(one.median, color=theme.muted, lw=1.0)
        if np.isfinite(one.limit):
            for side in (-1.0, 1.0) if QUANTITIES[one.quantity].either else (1.0,):
                ax.axhline(one.median + side * one.limit * one.spread, color=theme.band, lw=1.4)
        ax.plot(at[~unlike], levels[~unlike], "o", color=theme.up, ms=4)
        ax.plot(at[unlike], levels[unlike], "D", color=theme.down, ms=6)
        for place, each in zip(at.tolist(), axes, strict=True):
            if each.unlike:
                ax.annotate(
                    each.series.axis[:30], (place, each.level), (4, 4), textcoords="offset points", color=theme.ink
                )
        label_axes(ax, theme, "Axes in order", f"{QUANTITIES[one.quantity].title}, {QUANTITIES[one.quantity].unit}")
        return figure


def render_causes(causes: Sequence[Cause], under: str, unread: Sequence[str]) -> str:
    """The page of `hil fleet diagnose`."""
    number = counted(causes)
    blocks: list[Block] = []
    if number:
        caption = "On how many axes each cause was found."
        draw = partial(causes_figure, number)
        blocks += [
            Heading("Causes over the fleet"),
            Drawing("causes", "causes", draw, "Causes over the fleet", caption),
        ]
    rows = tuple(map(causes_row, causes[:MOST_ROWS]))
    blocks += [Heading("Axis by axis"), ReportTable(causes_head(), rows, "words")]
    said_of = tuple(f"{one.task.axis}: {one.explanation}" for one in causes[:MOST_ROWS] if one.explanation)
    blocks += [Heading("In words"), Bullets(said_of, "remarks")] if said_of else []
    return _page("Causes over the fleet", under, [*blocks, *_left_out(unread, ())])


def causes_figure(number: dict[str, int], theme: Theme, ground: Ground) -> FigureBase:
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 0.9 + 0.3 * len(number), left_in=1.6)
        ax = figure.subplots()
        names = list(reversed(number))
        ax.barh(names, [number[name] for name in names], color=theme.up, height=0.6)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        label_axes(ax, theme, "Axes", "")
        return figure
