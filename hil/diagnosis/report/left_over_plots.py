"""The drawings of what a model leaves: small ones side by side, one for each column, and the spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from hil.app.report.data import plain
from hil.app.report.svg import RC, Ground, Theme, figure_on, fresh, label_axes
from hil.diagnosis.report.mean_curves import Curve
from hil.diagnosis.report.spectrum import Spectrum
from hil.records.rows import Floats

ACROSS = 3
ROW_IN, WIDTH_IN = 2.2, 9.6
MOST_DOTS = 300
"""Of one drawing: more of them only cover each other, and make the page heavy."""
REACH = 0.995
"""Share of the rows that the drawings reach to; single rows beyond are not drawn."""


@dataclass(frozen=True)
class Panel:
    """One small drawing: what is left of rows against x, each (n,), and the mean curves of their groups."""

    label: str
    x: Floats
    left_um: Floats
    direction: Floats
    curves: tuple[Curve, ...]


def panels_plot(panels: Sequence[Panel], theme: Theme, ground: Ground = fresh) -> FigureBase:
    """All of them on one scale."""
    down = -(-len(panels) // ACROSS)
    with mpl.rc_context(RC):
        figure = figure_on(ground, WIDTH_IN, ROW_IN * down, top_in=0.25)
        figure.subplots_adjust(hspace=0.48, wspace=0.08)
        axes = figure.subplots(down, ACROSS, sharey=True, squeeze=False).ravel()
        for index, (ax, panel) in enumerate(zip(axes, panels, strict=False)):
            _draw(ax, panel, theme)
            label_axes(ax, theme, plain(panel.label), "What is left, µm" if index % ACROSS == 0 else "")
            ax.margins(x=0.03)
            ax.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
            if panel.label == "Direction":
                ax.set_xticks([-1, 1], ["−", "+"])
                ax.margins(x=0.5)
        for ax in axes[len(panels) :]:
            ax.set_axis_off()
        if panels:
            reach = float(np.quantile(np.abs(panels[0].left_um), REACH))
            axes[0].set_ylim(-1.1 * reach, 1.1 * reach)
        return figure


def _draw(ax: Axes, panel: Panel, theme: Theme) -> None:
    ax.axhline(0, color=theme.muted, lw=1)
    shown = np.arange(0, len(panel.x), -(-len(panel.x) // MOST_DOTS))
    for sign, color, marker in ((1, theme.up, "^"), (-1, theme.down, "v")):
        here = shown[panel.direction[shown] == sign]
        ax.plot(panel.x[here], panel.left_um[here], marker, color=color, ms=2, mew=0, alpha=0.45)
    lines = ((theme.ink, "-"), (theme.accent, (0, (4, 1.6))))
    for curve, (color, dash) in zip(panel.curves, lines, strict=False):
        if curve.levels:
            spread = np.nan_to_num(np.array([curve.mean_um - curve.low_um, curve.high_um - curve.mean_um]))
            ax.errorbar(curve.at, curve.mean_um, spread, color=color, fmt="o", ms=4, lw=1.4, capsize=3, zorder=4)
            ax.plot(curve.at, curve.mean_um, color=color, lw=0.9, linestyle=dash, label=curve.label, zorder=4)
        else:
            ax.fill_between(curve.at, curve.low_um, curve.high_um, color=color, alpha=0.22, lw=0)
            ax.plot(curve.at, curve.mean_um, color=color, lw=1.8, linestyle=dash, label=curve.label, zorder=4)
    if len(panel.curves) > 1:
        ax.legend(
            loc="lower left", bbox_to_anchor=(0, 1), ncols=2, labelcolor=theme.ink, borderpad=0, fontsize=7, handlelength=1.6,
            columnspacing=0.8, borderaxespad=0.15,
        )  # fmt: skip


def spectrum_plot(spectrum: Spectrum, theme: Theme, ground: Ground = fresh) -> FigureBase:
    """Amplitude against period, the level of noise dashed, the highest line named."""
    period, amplitude = spectrum.highest
    with mpl.rc_context(RC):
        figure = figure_on(ground, WIDTH_IN, 2.8, top_in=0.3)
        ax = figure.subplots()
        ax.plot(spectrum.period_mm, spectrum.amplitude_um, color=theme.ink, lw=1)
        level = f"exceeded by noise alone in 5 of 100 cases: {spectrum.level_um:.3g} µm"
        ax.axhline(spectrum.level_um, color=theme.accent, lw=1.2, linestyle=(0, (4, 1.6)), label=level)
        ax.plot([period], [amplitude], "o", mfc="none", mec=theme.accent, ms=7)
        ax.annotate(
            f"{period:.4g} mm: {amplitude:.3g} µm",
            (period, amplitude),
            (8, 0),
            textcoords="offset points",
            color=theme.ink,
            fontsize=8,
        )
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_ylim(0, 1.15 * max(amplitude, spectrum.level_um))
        label_axes(ax, theme, "Period, mm", "Amplitude, µm")
        ax.legend(loc="lower right", bbox_to_anchor=(1, 1), labelcolor=theme.ink, borderpad=0, borderaxespad=0.2)
        return figure
