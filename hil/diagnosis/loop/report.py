"""The report and the figure of a loop. Imported only when one is written, since plotting loads slowly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from hil.axis.axis_file import AxisConfig
from hil.calibration.job import Verification
from hil.calibration.report import of_axis, verified_campaign
from hil.diagnosis.loop.jobs.stored import STAGE_LABELS
from hil.diagnosis.loop.procedure import Loop, Turn
from hil.diagnosis.pictures import with_plots
from hil.diagnosis.report.diagnosis import opening, section
from hil.ui.report.data import NamedCampaign
from hil.ui.report.document import render_html

BEFORE, AFTER = STAGE_LABELS["table, explored"], STAGE_LABELS["extended, explored"]
"""The pair that says what the loop reached: terminal, report and picture show it under these names."""


def loop_report(axis: AxisConfig, loop: Loop, proof: Verification | None = None) -> str:
    """The whole loop as HTML, with the diagnosis and plots of its effects over the diagnosed rows. proof: made after it."""
    turn, proven = loop.turn, () if proof is None else (verified_campaign(axis, proof),)
    campaigns = loop_campaigns(loop)
    found = with_plots(turn.diagnosis.to_json(), turn.diagnosis, turn.diagnosed)
    before, after = (next(one for one in campaigns if one.label == label) for label in (BEFORE, AFTER))
    data = replace(
        of_axis(axis, "Closed loop on", (*campaigns, *proven), turn.extended.tables),
        opening=opening(found, before, after),
        causes=section(found, NamedCampaign("diagnosed", turn.diagnosed)),
        notes=tuple(_in_motion_notes(loop.in_motion)),
    )
    return render_html(data)


def loop_campaigns(loop: Loop) -> tuple[NamedCampaign, ...]:
    """The measured stages of a loop, named."""
    campaigns = [
        NamedCampaign("uncorrected", loop.calibration.before, "cold, no correction in force"),
        NamedCampaign("tables at the calibrated targets", loop.calibration.rounds[-1].records, "cold", corrected=True),
        NamedCampaign(BEFORE, loop.turn.before, "rows anywhere, warming and resting between runs", corrected=True),
        NamedCampaign(AFTER, loop.turn.after, "the same kind of campaign anew, with what was found", corrected=True),
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
