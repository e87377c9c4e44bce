"""The report of a circle test: the deviation around the circle, magnified, and unrolled over the angle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from hil.lost_motion.circle.figures import AFTER_DEG, BEFORE_DEG, QUADRANTS_DEG, Trace, ring_of
from hil.ui.report import markup
from hil.ui.report.markup import header, page, tile
from hil.ui.report.svg import PAGE, RC, Theme, inline_svg, label_axes, new_figure

_SHARE = 0.35
"""Share of the plotted radius that the largest deviation takes."""


@dataclass(frozen=True)
class CircleReport:
    """traces: by name, the uncorrected first; names: of both axes; sense: +1 counter-clockwise; verdict: a sentence, or
    empty.
    """

    title: str
    traces: Mapping[str, Trace]
    names: tuple[str, str]
    sense: int = 1
    verdict: str = ""
    identity: Mapping[str, str] = field(default_factory=dict)


def render_circle(report: CircleReport) -> str:
    """The whole page as HTML. Same data, same text."""
    polar = inline_svg(polar_plot(report, PAGE), "polar", "Deviation around the circle, magnified")
    unrolled = inline_svg(unrolled_plot(report, PAGE), "unrolled", "Deviation over the angle")
    ring_um = ring_of(report.traces.values())
    parts = [
        header(report.title, report.identity.get("Measured", "")),
        _tiles(report),
        f'<p class="callout">{markup.text(report.verdict)}</p>' if report.verdict else "",
        "<h2>Identity</h2>" + markup.definitions(dict(report.identity)) if report.identity else "",
        "<h2>Around the circle</h2>"
        + markup.figure(
            polar,
            f"Radius driven less radius commanded, magnified: one ring is {ring_um:g} µm, outside the bold circle is too far out. At"
            " the quadrants one of the axes turns around.",
        ),
        "<h2>Over the angle</h2>"
        + markup.figure(unrolled, "The same, unrolled in the direction of motion; the quadrants are marked."),
        _bumps(report),
        *(
            markup.data_table(
                f"data-{number}",
                f"{name}, every sample",
                {"angle_deg": trace.angle_deg, "deviation_um": trace.deviation_um},
            )
            for number, (name, trace) in enumerate(report.traces.items(), start=1)
        ),
        _footer(),
    ]
    return page(report.title, parts)


def polar_plot(report: CircleReport, theme: Theme) -> Figure:
    """The circle with its deviations magnified, all traces on one scale."""
    ring_um = ring_of(report.traces.values())
    per_um = _SHARE / (4.0 * ring_um)
    with mpl.rc_context(RC):
        figure = new_figure(6.4, 6.6, top_in=0.6)
        ax = figure.subplots()
        around = np.linspace(0.0, 2.0 * np.pi, 721)
        for ring in range(-4, 5):
            at = 1.0 + per_um * ring * ring_um
            bold = ring == 0
            ax.plot(
                at * np.cos(around),
                at * np.sin(around),
                color=theme.muted if bold else theme.grid,
                lw=1.2 if bold else 0.6,
            )
        reach = 1.0 + _SHARE
        ax.plot([-reach, reach], [0, 0], color=theme.grid, lw=0.8)
        ax.plot([0, 0], [-reach, reach], color=theme.grid, lw=0.8)
        for (name, trace), (color, style) in zip(report.traces.items(), _styles(theme), strict=False):
            angle = np.radians(trace.angle_deg) * report.sense
            radius = 1.0 + per_um * trace.deviation_um
            ax.plot(radius * np.cos(angle), radius * np.sin(angle), color=color, lw=1.6, linestyle=style, label=name)
        ax.text(0.03, 0.06, f"ring: {ring_um:g} µm", color=theme.muted)
        ax.set_aspect("equal")
        ax.set_xlim(-reach - 0.05, reach + 0.05)
        ax.set_ylim(-reach - 0.05, reach + 0.05)
        label_axes(ax, theme, f"{report.names[0]}, magnified", f"{report.names[1]}, magnified")
        ax.grid(False)
        ax.set_xticks([])
        ax.set_yticks([])
        figure.legend(loc="upper left", ncols=len(report.traces), labelcolor=theme.ink)
        return figure


def unrolled_plot(report: CircleReport, theme: Theme) -> Figure:
    """Deviation over the angle, µm."""
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 3.4, top_in=0.6)
        ax = figure.subplots()
        for at in QUADRANTS_DEG:
            ax.axvline(at, color=theme.muted, lw=0.8, linestyle=(0, (4, 2)))
        ax.axhline(0, color=theme.muted, lw=1)
        for (name, trace), (color, style) in zip(report.traces.items(), _styles(theme), strict=False):
            ax.plot(trace.angle_deg, trace.deviation_um, color=color, lw=1.3, linestyle=style, label=name)
        ax.set_xticks(list(QUADRANTS_DEG))
        label_axes(ax, theme, "Angle in the direction of motion, °", "Deviation, µm")
        figure.legend(loc="upper left", ncols=len(report.traces), labelcolor=theme.ink)
        return figure


def _styles(theme: Theme) -> list[tuple[str, Any]]:
    return [(theme.down, (0, (4, 1.2))), (theme.up, "-"), (theme.accent, "-")]


def _tiles(report: CircleReport) -> str:
    tiles = [
        tile(f"Bump, {name}", markup.number(trace.bump_mean_um), "µm", f"mean of four, floor {trace.floor_um:.2f}")
        for name, trace in report.traces.items()
    ]
    means = [trace.bump_mean_um for trace in report.traces.values()]
    if len(means) > 1:
        tiles.append(
            tile(f"Fallen by, {list(report.traces)[-1]}", markup.number(100.0 * (1.0 - means[-1] / means[0]), 1), "%")
        )
    return '<div class="tiles">' + "".join(tiles) + "</div>"


def _bumps(report: CircleReport) -> str:
    rows = [
        [
            name,
            *(markup.number(bump) for bump in trace.bumps_um),
            markup.number(trace.bump_mean_um),
            markup.number(trace.floor_um),
            markup.number(trace.roundness_um),
        ]
        for name, trace in report.traces.items()
    ]
    head = ["bump, µm, after", *(f"{at:g}°" for at in QUADRANTS_DEG), "mean", "floor, µm", "roundness, µm"]
    return "<h2>Bumps after the quadrants</h2>" + markup.table(head, rows, css="numbers")


def _footer() -> str:
    return (
        f"<footer>Bump: the largest distance of the deviation, within {AFTER_DEG:g}° after a quadrant, from the straight line through"
        f" the {BEFORE_DEG:g}° before it, which no reversal has touched. Floor: the same figure half-way between the quadrants, where"
        " no axis turns around: noise, and what the screws' own errors do to it. Roundness: the largest deviation less the smallest."
        " The centre is fitted. The data are inside this file as JSON.</footer>"
    )
