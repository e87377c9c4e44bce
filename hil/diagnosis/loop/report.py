"""The report and the figure of a loop. Imported only when one is written, since plotting loads slowly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from hil.app.report.data import NamedCampaign
from hil.app.report.document import before_after_image, render_html
from hil.axis.axis_file import AxisConfig
from hil.calibration.report import of_axis
from hil.diagnosis.loop.procedure import Loop, Turn
from hil.diagnosis.pictures import with_plots


def loop_report(axis: AxisConfig, loop: Loop, notes: Sequence[str] = ()) -> str:
    """The whole loop as HTML, with the diagnosis and plots of its effects over the diagnosed rows."""
    turn = loop.turn
    data = replace(
        of_axis(axis, "Closed loop on", loop_campaigns(loop), turn.extended.tables),
        diagnosis=with_plots(turn.diagnosis.to_json(), turn.diagnosis, turn.diagnosed),
        diagnosed=NamedCampaign("diagnosed", turn.diagnosed.with_column("residual_um", turn.diagnosis.before_um)),
        notes=(*notes, *_in_motion_notes(loop.in_motion)),
    )
    return render_html(data)


def loop_image(loop: Loop) -> bytes:
    """The axis uncorrected, with its table, explored, and explored with the extended model, as PNG."""
    return before_after_image(loop_campaigns(loop))


def loop_campaigns(loop: Loop) -> tuple[NamedCampaign, ...]:
    """The measured stages of a loop, named."""
    campaigns = [
        NamedCampaign("uncorrected", loop.calibration.before, "cold, no correction in force"),
        NamedCampaign("table", loop.calibration.rounds[-1].records, "cold, at the table's own targets"),
        NamedCampaign("table, explored", loop.turn.before, "other targets, warming and resting between runs"),
        NamedCampaign("extended, explored", loop.turn.after, "the same kind of campaign anew, with what was found"),
    ]
    if loop.in_motion is not None:
        campaigns += [
            NamedCampaign("in motion", loop.in_motion.before, "passes at feed with what was found at rest"),
            NamedCampaign("in motion, extended", loop.in_motion.after, "passes anew, with what was found in motion"),
        ]
    return tuple(campaigns)


def _in_motion_notes(turn: Turn | None) -> Iterator[str]:
    """The findings in motion, one sentence each."""
    if turn is None:
        return
    if turn.latency is not None:
        yield f"In motion: the instrument's readings were dated by its {turn.latency.describe()}."
    for finding in turn.diagnosis.findings:
        yield f"In motion: {finding.effect} ({finding.confidence:.2f}, {finding.action.value}). {finding.explanation}"
    if turn.diagnosis.unexplained:
        yield "In motion: structure is left that nothing in the catalogue explains."
