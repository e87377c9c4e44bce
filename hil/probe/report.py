"""The report of a probe's run-out: position of the ball's centre in the spindle, closure of the contacts, and the
history of both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.procedure import BoreCentre, RunOutMeasurement
from hil.probe.runout import ANGLES_DEG, Centring, FourFeeds, RunOut, mean_feeds
from hil.ui.report import markup
from hil.ui.report.markup import header, page, tile
from hil.ui.report.svg import PAGE, RC, Theme, inline_svg, label_axes, new_figure

TIMES_SHOWN = 200
"""Most measurements that are plotted, the latest."""


@dataclass(frozen=True)
class ProbeReport:
    """The data of one report. verdict: "stored", or the sentence that refused it.

    history: rows as `RunOutStore.history` gives them, the oldest first; centring: of a bore, if any
    """

    title: str
    run_out: RunOut
    turns: Sequence[FourFeeds] = ()
    limits_um: Mapping[str, float] = field(default_factory=dict)
    verdict: str = ""
    identity: Mapping[str, str] = field(default_factory=dict)
    history: Sequence[Mapping[str, str]] = ()
    centring: Centring | None = None


def render_probe(report: ProbeReport) -> str:
    """The whole page as HTML. Same data, same text."""
    parts = [
        header(report.title, report.identity.get("Measured", "")),
        _tiles(report),
        f'<p class="callout">{markup.text(report.verdict)}</p>' if report.verdict not in ("", "stored") else "",
        "<h2>Identity</h2>" + markup.definitions(dict(report.identity)) if report.identity else "",
        "<h2>The ball in the spindle</h2>",
        markup.figure(
            inline_svg(ball_plot(report.run_out, PAGE), "ball", "Place of the ball's centre in the spindle"),
            "Seen along the spindle axis, which is in the middle. The ball's centre runs on the circle as the spindle turns; the"
            " arrow is the run-out at spindle angle 0.",
        ),
        _contacts(report),
        _bore(report.centring) if report.centring is not None else "",
        _history(report.history),
    ]
    return page(report.title, parts)


def _tiles(report: ProbeReport) -> str:
    found = report.run_out
    tiles = [
        tile("Run-out", markup.number(found.size_um), "µm"),
        tile("Δx at 0°", markup.number(1000 * found.x_mm), "µm"),
        tile("Δy at 0°", markup.number(1000 * found.y_mm), "µm"),
        tile("Tip radius", markup.number(found.tip_radius_mm, 4), "mm"),
    ]
    if report.turns:
        limit = report.limits_um.get("closure")
        worst = max((turn.closure_um for turn in report.turns), key=abs)
        inside = limit is None or abs(worst) <= limit
        note = "" if limit is None else f"limit {limit:g} µm"
        tiles.append(tile("Closure", markup.number(worst), "µm", note, css="better" if inside else "worse"))
    return '<div class="tiles">' + "".join(tiles) + "</div>"


def ball_plot(found: RunOut, theme: Theme) -> Figure:
    """The ball's centre about the spindle axis at the four angles, µm."""
    with mpl.rc_context(RC):
        figure = new_figure(4.6, 4.4)
        ax = figure.subplots()
        reach = max(found.size_um, 0.5)
        ax.add_patch(Circle((0, 0), found.size_um, fill=False, edgecolor=theme.muted, lw=1, linestyle=(0, (4, 2))))
        ax.plot([0], [0], "+", color=theme.ink, ms=11, mew=1.2, label="spindle axis")
        places = [(1000 * x, 1000 * y) for x, y in (found.at(angle) for angle in ANGLES_DEG)]
        ax.annotate("", places[0], (0, 0), arrowprops={"arrowstyle": "->", "color": theme.accent, "lw": 1.6})
        for angle, (x, y) in zip(ANGLES_DEG, places, strict=True):
            color = theme.accent if angle == 0 else theme.up
            ax.plot([x], [y], "o", color=color, ms=6, label="ball's centre at 0°" if angle == 0 else "at 90, 180, 270°")
            ax.annotate(f"{angle}°", (x, y), xytext=(6, 5), textcoords="offset points", color=theme.ink)
        ax.set_xlim(-1.35 * reach, 1.35 * reach)
        ax.set_ylim(-1.35 * reach, 1.35 * reach)
        ax.set_aspect("equal")
        label_axes(ax, theme, "x, µm", "y, µm")
        handles, names = ax.get_legend_handles_labels()
        unique = dict(zip(names, handles, strict=True))
        figure.legend(unique.values(), unique.keys(), loc="upper left", ncols=3, labelcolor=theme.ink)
        return figure


def contact_plot(turns: Sequence[FourFeeds], theme: Theme) -> Figure:
    """Feed to contact over the spindle's angle, less the mean, with the sine of a pure run-out; µm."""
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 3.2, left_in=0.82)
        ax = figure.subplots()
        mean = mean_feeds(turns)
        values = np.array([mean.n_0_mm, mean.n_90_mm, mean.n_180_mm, mean.n_270_mm])
        middle = float(values.mean())
        angle = np.linspace(0.0, 360.0, 181)
        cosine, sine = (values[0] - values[2]) / 2, (values[1] - values[3]) / 2
        curve = 1000 * (cosine * np.cos(np.radians(angle)) + sine * np.sin(np.radians(angle)))
        ax.axhline(0, color=theme.muted, lw=1)
        ax.plot(angle, curve, color=theme.accent, lw=1.6, label="a pure run-out")
        for number, turn in enumerate(turns):
            feeds = 1000 * (np.array([turn.n_0_mm, turn.n_90_mm, turn.n_180_mm, turn.n_270_mm]) - middle)
            ax.plot(ANGLES_DEG, feeds, "o^sDvP"[number % 6], color=theme.up, ms=5.5, mew=0, label=f"turn {number + 1}")
        label_axes(ax, theme, "Spindle angle, °", "Feed to contact\nless the mean, µm")
        ax.set_xticks([0, 90, 180, 270, 360])
        figure.legend(loc="upper left", ncols=5, labelcolor=theme.ink)
        return figure


def _contacts(report: ProbeReport) -> str:
    if not report.turns:
        return ""
    svg = inline_svg(contact_plot(report.turns, PAGE), "contacts", "Feed to contact at each angle of the spindle")
    rows = [
        [
            str(number),
            *(f"{feed:.4f}" for feed in (turn.n_0_mm, turn.n_90_mm, turn.n_180_mm, turn.n_270_mm)),
            f"{turn.n_0_mm + turn.n_180_mm:.4f}",
            f"{turn.n_90_mm + turn.n_270_mm:.4f}",
            f"{turn.closure_um:+.2f}",
        ]
        for number, turn in enumerate(report.turns, start=1)
    ]
    head = ["turn", "N0, mm", "N90, mm", "N180, mm", "N270, mm", "N0 + N180", "N90 + N270", "closure, µm"]
    names = ("n_0_mm", "n_90_mm", "n_180_mm", "n_270_mm", "closure_um")
    columns = {name: np.array([float(getattr(turn, name)) for turn in report.turns]) for name in names}
    return (
        "<h2>Contacts</h2>"
        + markup.figure(svg, "The points lie on the curve where the ball keeps its place and the face is clean.")
        + markup.table(head, rows, css="numbers")
        + markup.embedded("data-contacts", markup.columns_form(columns))
    )


def _bore(centring: Centring) -> str:
    facts = {
        "Half the travel": f"X {centring.middle_mm[0]:.4f} mm, Y {centring.middle_mm[1]:.4f} mm",
        "Centre of the bore": f"X {centring.centre_mm[0]:.4f} mm, Y {centring.centre_mm[1]:.4f} mm",
        "Diameter": f"{centring.diameter_mm:.4f} mm",
        "Spindle angle": f"{centring.spindle_deg:.2f}°",
    }
    return "<h2>Bore</h2>" + markup.definitions(facts)


def history_plot(rows: Sequence[Mapping[str, str]], theme: Theme) -> Figure:
    """Run-out and radius over the measurements; refused ones are crosses."""
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 3.8, left_in=0.82)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
        stored = np.array([row["verdict"] == "stored" for row in rows])
        number = np.arange(1, len(rows) + 1)
        for ax, name, color, label in (
            (upper, "x_um", theme.up, "Δx"),
            (upper, "y_um", theme.down, "Δy"),
            (lower, "tip_radius_mm", theme.accent, "tip radius"),
        ):
            values = np.array([_number(row[name]) for row in rows])
            ax.plot(number[stored], values[stored], "o-", color=color, ms=4, lw=1, label=label)
            if np.any(~stored):
                ax.plot(number[~stored], values[~stored], "x", color=color, ms=7, mew=1.6, label=f"{label}, refused")
        label_axes(upper, theme, "", "Run-out at 0°, µm")
        label_axes(lower, theme, "Measurement", "Radius, mm")
        lower.ticklabel_format(axis="y", useOffset=False)
        handles, names = upper.get_legend_handles_labels()
        figure.legend(handles, names, loc="upper left", ncols=4, labelcolor=theme.ink)
        return figure


def _history(rows: Sequence[Mapping[str, str]]) -> str:
    measured = [row for row in rows if row.get("turn") == "1"][-TIMES_SHOWN:]
    if len(measured) < 2:
        return ""
    svg = inline_svg(history_plot(measured, PAGE), "history", "Run-out from measurement to measurement")
    table = [
        [row["time"], row["x_um"], row["y_um"], row["tip_radius_mm"], row["verdict"]]
        for row in reversed(measured[-20:])
    ]
    return (
        "<h2>History</h2>"
        + markup.figure(svg, f"The latest {len(measured)} measurements. A refused one was not put into force.")
        + markup.table(["time", "Δx, µm", "Δy, µm", "radius, mm", "verdict"], table, css="numbers meaning")
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def run_out_report(
    config: ProbeMachineConfig, measured: RunOutMeasurement, refusal: str | None, history: Sequence[Mapping[str, str]]
) -> str:
    return render_probe(
        ProbeReport(
            f"Touch probe of {config.name}",
            measured.run_out,
            measured.turns,
            {"closure": config.block.closure_limit_um},
            "stored" if refusal is None else f"Refused: {refusal}",
            identity(config, measured.mode, history[-1]["time"] if history else ""),
            history,
        )
    )


def centre_report(config: ProbeMachineConfig, found: BoreCentre, when: str) -> str:
    """Report of a bore, and of the run-out by which it was corrected, as HTML."""
    centring = found.centring
    return render_probe(
        ProbeReport(
            f"Bore on {config.name}",
            centring.run_out,
            identity=identity(config, config.probe.mode, when),
            centring=centring,
        )
    )


def identity(config: ProbeMachineConfig, mode: str, when: str) -> dict[str, str]:
    """The set-up, as label -> text, as far as it is needed to repeat the measurement."""
    block, probe = config.block, config.probe
    by = "positions latched by the drive" if mode == "latch" else f"pulses of {1000 * probe.pulse_mm:g} µm"
    return {
        "Measured": when,
        "Machine": config.name,
        "Drives": ", ".join(f"{name} {axis.drive.backend}" for name, axis in config.axes.items()),
        "Contacts": f"{by}, {probe.touch_mm_s:g} mm/s",
        "Block": f"face at X {block.face_mm:g} mm, from {block.start_mm:g} mm, {block.turns} turns of the spindle",
        "Pre-travel": f"{1000 * probe.pretravel_mm:g} µm",
    }
