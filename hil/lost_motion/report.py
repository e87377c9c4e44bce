"""The report of lost motion after reversals: the measured rise with every fitted shape, and the moves of the proof."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from hil.effects.history import LONG_STROKE_MM
from hil.figures.error_figures import rms
from hil.lost_motion.estimate import NOT_SEPARATELY_DETERMINED, ReversalFit, determined, separately_determined
from hil.lost_motion.procedure import LostMotionProof, LostMotionResult
from hil.lost_motion.published import BesidePublished
from hil.ui.report import markup
from hil.ui.report.markup import tile
from hil.ui.report.svg import PAGE, RC, Theme, inline_svg, label_axes, new_figure

NAMES = {1: "− → +", -1: "+ → −"}


FOOTER = (
    "<footer>Uncertainties are standard ones, by the scatter of whole strokes: how well these repeat. A shape is fitted"
    " over the load's own travel, and its RMS is that of the load's place at each place of the motor. The data"
    " are inside this file as JSON.</footer>"
)


def sections(result: LostMotionResult, published: BesidePublished) -> list[str]:
    """The reversals with the fitted shapes, both forms, and the moves of the proof, as HTML."""
    found = result.estimate
    rise = inline_svg(rise_plot(found, PAGE), "rise", "Lost motion over the load's travel since the reversal")
    proof = inline_svg(proof_plot(result.proof, PAGE), "proof", "What is left in fresh moves, before and after")
    return [
        "<h2>After a reversal</h2>"
        + markup.figure(
            rise,
            "How far the load has fallen behind the motor since the turning, over its own travel; the place's own error, which is the"
            " same after a long stroke, is taken out. Each point is one reading at rest, and every shape is fitted to all of them.",
        ),
        *(_data(number, found) for number in range(len(found.reversals))),
        _contenders(found),
        _parameters(found),
        _published(published),
        "<h2>Fresh moves of all lengths</h2>"
        + markup.figure(
            proof,
            "What is left of the lost motion at the end of each move, with the sign of the move: above zero is too far. The same"
            " moves, as the machine was before and with the correction in force.",
        ),
        _proof_data(result.proof),
    ]


def rise_plot(estimate: ReversalFit, theme: Theme) -> Figure:
    """Loss over the load's travel: the whole travel in mm, and its beginning in µm."""
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 4.2, top_in=0.75)
        whole, begin = figure.subplots(1, 2, sharey=True, squeeze=False)[0]
        end_mm = max(float(one.by_load().travel_mm.max()) for one in estimate.reversals)
        early_mm = min(end_mm, 0.05)
        for ax, reach_mm, scale in ((whole, end_mm, 1.0), (begin, early_mm, 1000.0)):
            for direction, color, marker in ((1, theme.up, "^"), (-1, theme.down, "v")):
                rows = [one.by_load().rise for one in estimate.reversals if one.direction == direction]
                travel = np.concatenate([t for t, _ in rows]) if rows else np.zeros(0)
                risen = np.concatenate([r for _, r in rows]) if rows else np.zeros(0)
                inside = travel <= reach_mm
                ax.plot(
                    scale * travel[inside],
                    risen[inside],
                    marker,
                    color=color,
                    ms=3.5,
                    mew=0,
                    linestyle="none",
                    label=f"measured, {NAMES[direction]}",
                )
            along = np.linspace(0.0, reach_mm, 600)
            for one in estimate.contenders:
                taken = one.fitted.rise is estimate.rise
                ax.plot(
                    scale * along,
                    one.fitted.rise.along_um(along),
                    color=theme.accent if taken else theme.muted,
                    lw=2.0 if taken else 0.9,
                    linestyle="-" if taken else (0, (4, 2)),
                    label=f"{one.fitted.shape.name}, in force" if taken else "the other shapes",
                )
        label_axes(whole, theme, "Load's travel since the reversal, mm", "Lost motion, µm")
        label_axes(begin, theme, "The beginning: load's travel, µm", "")
        unique = dict(zip(*reversed(whole.get_legend_handles_labels()), strict=True))
        figure.legend(list(unique.values()), list(unique), loc="upper left", ncols=4, labelcolor=theme.ink)
        return figure


def proof_plot(proof: LostMotionProof, theme: Theme) -> Figure:
    """Remaining lost motion, move by move, before and after, µm."""
    with mpl.rc_context(RC):
        figure = new_figure(9.6, 3.2, top_in=0.6)
        ax = figure.subplots()
        moves = np.arange(len(proof.after_um))
        sign = proof.after.direction
        ax.axhline(0, color=theme.muted, lw=1)
        ax.plot(moves, sign * proof.before_um, "o", color=theme.down, ms=4, mew=0, label="before")
        ax.plot(moves, sign * proof.after_um, "D", color=theme.up, ms=4, mew=0, label="with the correction in force")
        label_axes(ax, theme, "Move", "Left of the lost motion, µm")
        figure.legend(loc="upper left", ncols=2, labelcolor=theme.ink)
        return figure


def tiles(result: LostMotionResult) -> str:
    """The amount and the proof, as HTML."""
    found, proof = result.estimate, result.proof
    amount, before, after = found.parameters["amount_um"], rms(proof.before_um), rms(proof.after_um)
    shown = [
        tile("Lost motion", markup.number(found.amount_um), "µm", f"± {markup.number(2.0 * amount.std, 3)} (k = 2)"),
        tile("Fresh moves, before", markup.number(before), "µm RMS"),
        tile("Fresh moves, after", markup.number(after), "µm RMS"),
        tile("Over-compensated at worst", markup.number(100.0 * proof.over_um / found.amount_um, 1), "%"),
    ]
    return '<div class="tiles">' + "".join(shown) + "</div>"


def _data(number: int, estimate: ReversalFit) -> str:
    one = estimate.reversals[number]
    load = one.by_load()
    travel_mm, risen_um = load.rise
    columns = {"travel_motor_mm": one.travel_mm, "travel_load_mm": travel_mm, "risen_um": risen_um}
    return markup.data_table(f"data-reversal-{number + 1}", f"Reversal {number + 1}, {NAMES[one.direction]}", columns)


def _contenders(estimate: ReversalFit) -> str:
    rows = [
        [
            one.fitted.shape.name + (" (in force)" if one.fitted.rise is estimate.rise else ""),
            markup.number(one.fitted.rise.amount_um),
            markup.number(one.rms_um, 3),
            markup.number(one.held_out_rms_um, 3),
        ]
        for one in estimate.contenders
    ]
    head = ["shape", "amount, µm", "RMS, µm", "RMS on strokes held out, µm"]
    return f"<h2>Shapes in competition</h2><p>{markup.text(estimate.choice)}.</p>" + markup.table(
        head, rows, css="numbers"
    )


def _parameters(estimate: ReversalFit) -> str:
    rows = [
        [name.replace("_", " "), markup.significant(each.value), markup.significant(each.std, 2)]
        for name, each in determined(estimate.published).items()
    ]
    head = ["two tanh terms", "value", "standard uncertainty"]
    singly = separately_determined(estimate.published)
    note = "" if singly else f"<p>The amounts of the single terms are {NOT_SEPARATELY_DETERMINED}.</p>"
    return markup.table(head, rows, css="numbers") + note


def _published(beside: BesidePublished) -> str:
    moves, form = beside.moves, beside.form
    finite = [replace(move, stroke_mm=min(move.stroke_mm, LONG_STROKE_MM)) for move in moves]
    columns = {
        name: np.array([getattr(move, name) for move in finite], dtype=np.float64)
        for name in ("target_mm", "branch", "last_um", "stroke_mm", "published_um")
    }
    columns["running_um"] = np.array(beside.running_um)
    values = (form.amount_1_um, form.amount_2_um, form.rise_1_mm, form.rise_2_mm, form.onset_2_mm)
    units = zip(("Pc1, µm", "Pc2, µm", "a1, mm", "a2, mm", "b2, mm"), values, strict=True)
    return (
        "<h2>The published form beside the running one</h2>"
        + markup.table(["two tanh terms", "value"], [[n, markup.significant(v)] for n, v in units], css="numbers")
        + f"<p>{markup.text(beside.sentence)}. It is the reference; in force is the running form, which has no step"
        " (decision 0010).</p>" + markup.data_table("data-published", "Every move by both forms", columns)
    )


def _proof_data(proof: LostMotionProof) -> str:
    columns = {
        "target_mm": proof.after.target_mm,
        "direction": proof.after.direction,
        "before_um": proof.before_um,
        "after_um": proof.after_um,
    }
    return markup.data_table("data-proof", "Every move", columns)
