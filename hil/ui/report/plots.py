"""The drawings of a report, one function each, as matplotlib figures. No files, no HTML.

Direction + is always a solid line with upright triangles, direction - a dashed one with inverted triangles, so that they differ not
only in colour. Errors are in µm, positions in mm.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import MaxNLocator

from hil.correction.tables import Band
from hil.figures.iso230 import Iso230
from hil.records.rows import Floats, Records
from hil.ui.report.data import NamedCampaign, history
from hil.ui.report.markup import plain
from hil.ui.report.svg import RC, Ground, Theme, figure_on, fresh, label_axes

MANY_POINTS = 4000
"""Number of points above which they are embedded as a bitmap, as vectors would make the page large."""
MANY_TARGETS = 100
"""Number of targets above which the mean is drawn without markers, for lack of room."""

MOST_ACROSS = 3
"""Largest number of campaigns side by side; more are in two rows."""
MANY_WIGGLES = 12
"""Total variation of a curve, over its range, above which it is drawn as rings: the eye cannot follow such a curve."""

_STYLE: dict[int, dict[str, Any]] = {
    1: {"linestyle": "-", "marker": "^"},
    -1: {"linestyle": (0, (4, 1.6)), "marker": "v"},
}
_SIGN = {1: "+", -1: "−"}


def error_plot(campaign: NamedCampaign, theme: Theme, band: Band | None = None, ground: Ground = fresh) -> FigureBase:
    """Error against position: each run as a thin line, the mean as a bold one, mean ± 2s shaded, the accuracy A as a bracket."""
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 4.0, right_in=0.95)
        ax = figure.subplots()
        figures = campaign.figures()
        _errors(ax, theme, campaign.records, figures, band)
        _label(ax, theme, "Target position, mm", "Error, µm")
        if isinstance(figures, Iso230):
            _accuracy_bracket(ax, theme, figures)
        _legend(figure, ax, theme)
        return figure


def before_after_plot(
    campaigns: Sequence[NamedCampaign], theme: Theme, band: Band | None = None, ground: Ground = fresh
) -> FigureBase:
    """Error against position of the campaigns, side by side on one scale."""
    with mpl.rc_context(RC):
        across = len(campaigns) if len(campaigns) <= MOST_ACROSS else -(-len(campaigns) // 2)
        down = -(-len(campaigns) // across)
        figure = figure_on(ground, 9.6, 3.9 if down == 1 else 6.6, top_in=0.75)
        grid = figure.subplots(down, across, sharey=True, sharex=True, squeeze=False)
        if down > 1:
            figure.subplots_adjust(hspace=0.42)
        axes = list(grid.ravel())
        for empty in axes[len(campaigns) :]:
            empty.set_visible(False)
        for ax, campaign in zip(axes, campaigns, strict=False):
            figures = campaign.figures()
            _errors(ax, theme, campaign.records, figures, band)
            _label(ax, theme, "Target position, mm", "Error, µm" if ax in grid[:, 0] else "")
            known = isinstance(figures, Iso230) and figures.A is not None
            told = (
                f"A = {figures.A:.2f} µm" if isinstance(figures, Iso230) and known else f"{len(campaign.records)} rows"
            )
            label = textwrap.shorten(plain(campaign.label), 100 // across, placeholder="…")
            ax.set_title(f"{label}\n{told}", color=theme.ink)
        _legend(figure, axes[0], theme)
        return figure


def history_plot(campaign: NamedCampaign, theme: Theme, ground: Ground = fresh) -> FigureBase:
    """Deviation from the mean of the same target and direction along time, the means of the runs, and temperatures if recorded."""
    records = campaign.records
    along = history(records)
    temperatures = [n for n in records.columns if (n.startswith("temp_") and n.endswith("_c")) or n == "air_temp_c"]
    temperatures = [name for name in temperatures if np.any(np.isfinite(records[name]))]
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 4.4 if temperatures else 3.0, left_in=0.82)
        ratios = [3, 1.3] if temperatures else [1]
        axes = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        ax = axes[0]
        _zero(ax, theme)
        for sign, color in ((1, theme.up), (-1, theme.down)):
            here = records.direction == sign
            if np.any(here):
                _cloud(
                    ax,
                    along.x[here],
                    along.deviation_um[here],
                    color=color,
                    label=f"direction {_SIGN[sign]}",
                    marker=_STYLE[sign]["marker"],
                )
        for run in records.runs:
            here = records.run == run
            span = [float(along.x[here].min()), float(along.x[here].max())]
            ax.plot(
                span, [along.deviation_um[here].mean()] * 2, color=theme.ink, lw=2.2, label="mean of the run", zorder=4
            )
        _label(ax, theme, "", "Deviation from the\nmean of its target, µm")
        if temperatures:
            for index, name in enumerate(temperatures):
                color = (theme.accent, theme.band, theme.muted)[index % 3]
                dash = ("-", (0, (4, 1.6)), (0, (1, 1)))[index // 3 % 3]
                label = "air" if name == "air_temp_c" else plain(name[5:-2]).replace("_", " ")
                axes[1].plot(along.x, records[name], color=color, linestyle=dash, lw=1.2, label=label)
            _label(axes[1], theme, "", "Temperature, °C")
            _corner_legend(axes[1], theme)
        axes[-1].set_xlabel(f"Time, {along.unit}" if along.timed else "Row (the records hold no time)", color=theme.ink)
        _legend(figure, ax, theme)
        return figure


def residual_plot(
    x: Floats,
    residual_um: Floats,
    over_um: Floats,
    direction: Floats,
    theme: Theme,
    *,
    x_label: str,
    over: str,
    ground: Ground = fresh,
) -> FigureBase:
    """Residual against one column, with a curve over it.

    x, residual_um, over_um, direction: shape (n,); over_um: the curve, drawn per direction where the directions differ; x_label: of
    the x axis, with its unit; over: name of the curve
    """
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 3.0)
        ax = figure.subplots()
        _zero(ax, theme)
        for sign, color in ((1, theme.up), (-1, theme.down)):
            here = direction == sign
            if np.any(here):
                _cloud(
                    ax,
                    x[here],
                    residual_um[here],
                    color=color,
                    label=f"residual, direction {_SIGN[sign]}",
                    marker=_STYLE[sign]["marker"],
                )
        _overlay(ax, x, over_um, direction, theme, label=over)
        _label(ax, theme, x_label, "Residual, µm")
        _legend(figure, ax, theme)
        return figure


def _errors(ax: Axes, theme: Theme, records: Records, figures: Iso230 | str, band: Band | None) -> None:
    if band is not None:
        _band(ax, theme, records, band)
    _zero(ax, theme)
    for sign, color in ((1, theme.up), (-1, theme.down)):
        for run in records.runs:
            here = (records.direction == sign) & (records.run == run)
            order = np.argsort(records.target_mm[here], kind="stable")
            ax.plot(
                records.target_mm[here][order],
                records.error_um[here][order],
                color=color,
                alpha=0.45,
                lw=0.7,
                linestyle=_STYLE[sign]["linestyle"],
                rasterized=len(records) > MANY_POINTS,
            )
        if not isinstance(figures, Iso230):
            ax.plot(
                [],
                [],
                color=color,
                lw=1,
                linestyle=_STYLE[sign]["linestyle"],
                label=f"direction {_SIGN[sign]}, each run",
            )
            continue
        mean, s = (figures.mean_up, figures.s_up) if sign == 1 else (figures.mean_down, figures.s_down)
        if mean is None:
            continue
        if s is not None:
            ax.fill_between(figures.target_mm, mean - 2 * s, mean + 2 * s, color=color, alpha=0.18, lw=0)
        label = f"direction {_SIGN[sign]}: mean" + (" ± 2s, each run thin" if s is not None else "")
        sparse = figures.m <= MANY_TARGETS
        width, mark = (2, 4.5) if sparse else (0.8, 0)
        ax.plot(
            figures.target_mm,
            mean,
            color=color,
            lw=width,
            ms=mark,
            label=label,
            zorder=3,
            rasterized=not sparse,
            **_STYLE[sign],
        )


def _band(ax: Axes, theme: Theme, records: Records, band: Band) -> None:
    """The specified band behind the errors; where its sign differs by direction, in the colour and line of each direction."""
    if not band.signs:
        ax.axhspan(band.low_um, band.high_um, color=theme.band, alpha=0.16, lw=0)
        for edge in (band.low_um, band.high_um):
            ax.axhline(edge, color=theme.band, lw=0.9, label=f"specified {band.low_um:g} to {band.high_um:g} µm")
        return
    size = f"specified ±({band.low_um:g} to {band.high_um:g}) µm"
    ax.plot([], [], color=theme.band, lw=0.9, label=size)
    for start, end, plus, minus in band.stretches(float(records.target_mm.min()), float(records.target_mm.max())):
        for sign, one in ((1, plus), (-1, minus)):
            if plus == minus:
                color, line, label = theme.band, "-", size
            else:
                color, line = (theme.up, theme.down)[sign < 0], _STYLE[sign]["linestyle"]
                label = f"specified, direction {_SIGN[sign]}"
            if plus != minus or sign > 0:
                ax.fill_between([start, end], one.low_um, one.high_um, color=color, alpha=0.16, lw=0)
                for edge in (one.low_um, one.high_um):
                    ax.plot([start, end], [edge, edge], color=color, linestyle=line, lw=0.9, label=label)


def _accuracy_bracket(ax: Axes, theme: Theme, figures: Iso230) -> None:
    pairs = [(figures.mean_up, figures.s_up), (figures.mean_down, figures.s_down)]
    known = [(mean, s) for mean, s in pairs if mean is not None and s is not None]
    accuracy = figures.A if len(known) == 2 else None
    if accuracy is None:
        return
    high = max(float(np.max(mean + 2 * s)) for mean, s in known)
    low = min(float(np.min(mean - 2 * s)) for mean, s in known)
    where = ax.get_yaxis_transform()
    for level in (low, high):
        ax.axhline(level, color=theme.muted, lw=0.8, linestyle=(0, (1.5, 2)))
    ax.annotate(
        "",
        (1.012, low),
        (1.012, high),
        xycoords=where,
        textcoords=where,
        arrowprops={"arrowstyle": "<->", "color": theme.ink, "lw": 1, "shrinkA": 0, "shrinkB": 0},
        annotation_clip=False,
    )
    ax.text(
        1.024,
        (low + high) / 2,
        f"A\n{accuracy:.2f} µm",
        transform=where,
        va="center",
        ha="left",
        color=theme.ink,
        fontsize=8.5,
    )


def _overlay(ax: Axes, x: Floats, over_um: Floats, direction: Floats, theme: Theme, *, label: str) -> None:
    """A line, or one per direction, where over_um is a function of x; rings where it is not."""
    whole = np.lexsort((over_um, x))
    if _is_curve(x[whole], over_um[whole]):
        ax.plot(x[whole], over_um[whole], color=theme.accent, lw=2, label=label, zorder=4)
        return
    groups = {sign: np.flatnonzero(direction == sign) for sign in (1, -1) if np.any(direction == sign)}
    groups = {sign: here[np.lexsort((over_um[here], x[here]))] for sign, here in groups.items()}
    if all(_is_curve(x[group], over_um[group]) for group in groups.values()):
        for sign, group in groups.items():
            name = f"{label}, direction {_SIGN[sign]}"
            dash = _STYLE[sign]["linestyle"]
            ax.plot(x[group], over_um[group], color=theme.accent, lw=2, linestyle=dash, label=name, zorder=4)
    else:
        ax.plot(x, over_um, "o", mfc="none", mec=theme.accent, mew=0.6, ms=4.5, label=label, zorder=4)


def _is_curve(x: Floats, y: Floats) -> bool:
    """Whether y, sorted by x, is drawn as one line: one value at each x, and a total variation within `MANY_WIGGLES`."""
    span = float(np.ptp(y))
    step = np.abs(np.diff(y))
    return bool(np.all(step[np.diff(x) < 1e-9] <= 0.02 * span) and float(np.sum(step)) <= MANY_WIGGLES * span)


def _cloud(ax: Axes, x: Floats, y: Floats, *, color: str, label: str, marker: str) -> None:
    size = 4 if len(x) < 500 else 2
    ax.plot(x, y, marker, color=color, ms=size, mew=0, alpha=0.75, label=label, rasterized=len(x) > MANY_POINTS)


def _zero(ax: Axes, theme: Theme) -> None:
    ax.axhline(0, color=theme.muted, lw=1)


def _label(ax: Axes, theme: Theme, x: str, y: str) -> None:
    label_axes(ax, theme, x, y)
    ax.margins(x=0.02)
    ax.xaxis.set_major_locator(MaxNLocator(9, steps=[1, 2, 2.5, 5, 10]))


def _unique(ax: Axes) -> tuple[list[Any], list[Any]]:
    handles, labels = ax.get_legend_handles_labels()
    first = {label: handle for handle, label in zip(reversed(handles), reversed(labels), strict=True)}
    names = list(dict.fromkeys(labels))
    return [first[name] for name in names], names


def _legend(figure: FigureBase, ax: Axes, theme: Theme) -> None:
    handles, names = _unique(ax)
    at = (ax.get_position().x0, 1)
    figure.legend(
        handles,
        names,
        loc="upper left",
        bbox_to_anchor=at,
        borderaxespad=0.1,
        borderpad=0.2,
        ncols=4,
        labelcolor=theme.ink,
    )


def _corner_legend(ax: Axes, theme: Theme) -> None:
    handles, names = _unique(ax)
    ax.legend(handles, names, loc="upper left", ncols=4, labelcolor=theme.ink, borderpad=0.1)
