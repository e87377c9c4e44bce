"""Parts of the report of lost motion by torque: the mean, and each run with torque over travel and the estimates."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil.backlash.result import NAMES, Reversal, TorqueBacklash
from hil.ui.report import markup
from hil.ui.report.markup import tile
from hil.ui.report.svg import PAGE, RC, Theme, inline_svg, label_axes, new_figure

FOOTER = (
    "<footer>Four-sample: the first step n−1 with |T(n−2)| ≥ |T(n−3)|, |T(n−1)| ≥ |T(n−2)| and |T(n)| &lt; |T(n−1)|, one reading a"
    " step (CN103561904). Fitted: where the rising flank meets the level of sliding. What the guideway gives before it slides"
    " cannot be told from wind-up by torque; the uncertainty has a share for it. The data are inside this file as JSON.</footer>"
)


def torque_plot(reversals: Sequence[Reversal], theme: Theme) -> Figure:
    """Torque less the weight over the motor's travel since the reversal, one panel per reversal, in the sense of the
    new direction.
    """
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 4.0, top_in=0.75)
        panels = figure.subplots(1, max(1, len(reversals)), sharey=True, squeeze=False)[0]
        for ax, one in zip(panels, reversals, strict=False):
            _panel(ax, one, theme)
            label_axes(
                ax, theme, "Motor travel since the reversal, µm", "Torque, % of rated" if ax is panels[0] else ""
            )
        unique: dict[str, Artist] = {}
        for ax in panels:
            for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
                unique.setdefault(name, handle)
        figure.legend(list(unique.values()), list(unique), loc="upper left", ncols=3, labelcolor=theme.ink)
        return figure


def _panel(ax: Axes, one: Reversal, theme: Theme) -> None:
    travel, color = one.trace.travel_um, theme.up if one.trace.direction > 0 else theme.down
    single = one.trace.direction * (one.trace.torque_percent[:, 0] - one.trace.weight_percent)
    ax.axhline(0, color=theme.muted, lw=1)
    ax.plot(travel, single, "o", color=theme.muted, ms=2.2, mew=0, label="first reading of each step")
    ax.plot(
        travel, one.trace.rising_percent, color=color, lw=1.4, label=f"mean of the readings, {NAMES[1]} / {NAMES[-1]}"
    )
    if one.published_um is not None:
        ax.axvline(
            one.published_um, color=theme.muted, lw=1.2, linestyle=(0, (4, 2)), label="peak by the four-sample rule"
        )
    fit = one.fitted
    if fit is not None:
        along = np.linspace(fit.flank_um[0], fit.lost_motion_um, 60)
        ax.plot(along, fit.flank_percent(along), color=theme.accent, lw=2, label="fitted flank and sliding level")
        ax.plot([fit.lost_motion_um, travel[-1]], [fit.level_percent] * 2, color=theme.accent, lw=2)
        reach = 1.96 * fit.u_um
        at = fit.lost_motion_um
        ax.axvspan(at - reach, at + reach, color=theme.accent, alpha=0.15, lw=0)
        ax.plot([at], [fit.level_percent], "D", color=theme.accent, ms=6, label="lost motion ± U95")
        ax.plot(
            [fit.peak_um], [fit.peak_percent], "^", mfc="none", mec=theme.ink, ms=8, label="peak: the table breaks away"
        )
    ax.set_title(f"{NAMES[one.trace.direction]}", color=theme.ink)
    ax.set_title(_found(one), loc="right", color=theme.muted, fontweight="normal")


def _found(one: Reversal) -> str:
    return "no wind-up that ends in sliding" if one.fitted is None else f"{one.fitted.lost_motion_um:.1f} µm"


def tiles(found: TorqueBacklash) -> str:
    """The mean by both estimates, as HTML."""
    fitted, counts = found.fitted, {"fitted": "", "four-sample": ""} | {found.method: "this one counts"}
    mean, spread = (None, None) if fitted is None else (fitted.mean_um, fitted.u95_um)
    shown = [
        tile("Lost motion, fitted", markup.number(mean, 1), "µm", counts["fitted"]),
        tile("± with 95 % confidence", markup.number(spread, 1), "µm"),
        tile("By the four-sample rule", markup.number(found.by_rule_um, 1), "µm", counts["four-sample"]),
        *(tile(NAMES[each], markup.number(value, 1), "µm") for each, value in found.by_direction_um.items()),
    ]
    return '<div class="tiles">' + "".join(shown) + "</div>"


def drawn_run(reversals: Sequence[Reversal], run: int) -> str:
    """The reversals of one run as HTML: plot, and every reading."""
    mine = [one for one in reversals if one.run == run]
    svg = inline_svg(torque_plot(mine, PAGE), f"run{run}", f"Torque over travel through both reversals, run {run}")
    caption = (
        "Torque over the motor's travel since the reversal, with the sign of the new direction. The old wind-up is released,"
        " torque passes zero, the new wind-up builds until the table breaks away, and then it slides."
    )
    tables = [_data(one) for one in mine]
    return f"<h2>Run {run}</h2>" + markup.figure(svg, caption) + "".join(tables)


def _data(one: Reversal) -> str:
    trace = one.trace
    columns = {"position_load_mm": trace.position_load_mm, "travel_um": trace.travel_um}
    columns |= {
        f"torque_{index + 1}_percent": trace.torque_percent[:, index] for index in range(trace.torque_percent.shape[1])
    }
    which = "plus-minus" if trace.direction < 0 else "minus-plus"
    return markup.data_table(f"data-run-{one.run}-{which}", f"{NAMES[trace.direction]}, every reading", columns)
