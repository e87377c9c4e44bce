"""From what a procedure returned to what a report shows. Imported only when a report is wanted: drawing is slow to load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from hil.app.jobs.identity import identity, uncertainty_of
from hil.app.report.data import NamedCampaign, ReportData, TableInForce
from hil.app.report.document import before_after_image, render_html
from hil.axis.axis_file import AxisConfig
from hil.calibration.calibrate import Calibration
from hil.calibration.verify import Verification
from hil.correction.tables import Band, TableSet
from hil.diagnosis.loop.procedure import Loop, Turn
from hil.diagnosis.pictures import with_plots


def calibration_report(axis: AxisConfig, result: Calibration) -> str:
    """Before, and each proof."""
    campaigns = [NamedCampaign("before", result.before)]
    campaigns += [
        NamedCampaign(f"round {number}", one.records, _outside_note(len(one.outside), axis.correction.band))
        for number, one in enumerate(result.rounds, start=1)
    ]
    return render_html(_of_axis(axis, "Calibration of", campaigns, result.tables))


def verification_report(axis: AxisConfig, tables: TableSet, result: Verification) -> str:
    """One campaign with the correction in force."""
    verified = NamedCampaign("verified", result.records, _outside_note(len(result.outside), axis.correction.band))
    return render_html(_of_axis(axis, "Verification of", [verified], tables))


def loop_report(axis: AxisConfig, loop: Loop, notes: Sequence[str] = ()) -> str:
    """The whole loop, with the diagnosis and what its effects look like over the rows it was made on."""
    turn = loop.turn
    data = replace(
        _of_axis(axis, "Closed loop on", loop_campaigns(loop), turn.extended.tables),
        diagnosis=with_plots(turn.diagnosis.to_json(), turn.diagnosis, turn.diagnosed),
        diagnosed=NamedCampaign("diagnosed", turn.diagnosed.with_column("residual_um", turn.diagnosis.before_um)),
        notes=(*notes, *_in_motion_notes(loop.in_motion)),
    )
    return render_html(data)


def _of_axis(axis: AxisConfig, what: str, campaigns: Sequence[NamedCampaign], tables: TableSet) -> ReportData:
    """What was measured, on which axis and how it stood, the band it is held against, the tables in force, how well it is known."""
    band = axis.correction.band
    return ReportData(
        f"{what} axis {axis.name}",
        tuple(campaigns),
        identity(axis),
        None if band is None else (band.low_um, band.high_um),
        in_force(tables),
        uncertainty=uncertainty_of(axis),
    )


def loop_image(loop: Loop) -> bytes:
    """The picture of the loop: the same axis uncorrected, with its table, explored, and explored with the extended model, as PNG."""
    return before_after_image(loop_campaigns(loop))


def loop_campaigns(loop: Loop) -> tuple[NamedCampaign, ...]:
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
    """What was found in motion, a sentence each."""
    if turn is None:
        return
    if turn.latency is not None:
        yield f"In motion: the instrument's readings were dated by its {turn.latency.describe()}."
    for finding in turn.diagnosis.findings:
        yield f"In motion: {finding.effect} ({finding.confidence:.2f}, {finding.action.value}). {finding.explanation}"
    if turn.diagnosis.unexplained:
        yield "In motion: structure is left that nothing in the catalogue explains."


def in_force(tables: TableSet) -> tuple[TableInForce, ...]:
    what = f"{tables.mode.value}, {len(tables.pitch.position_mm)} positions"
    return (TableInForce("correction tables", tables.digest(), what),)


def _outside_note(outside: int, band: Band | None) -> str:
    if band is None:
        return ""
    return "all sections inside the band" if not outside else f"{outside} sections outside the band"
