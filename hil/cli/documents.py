"""From what a procedure returned to what a report shows. Imported only when a report is wanted: drawing is slow to load."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.axis import AxisConfig
from hil.cli.instrument_identity import instrument_identity, uncertainty_of
from hil.diagnosis import Diagnosis
from hil.procedures.calibrate import Calibration
from hil.procedures.close_loop import Loop, Turn
from hil.procedures.verify import Verification
from hil.records import Records
from hil.report.data import NamedCampaign, ReportData, TableInForce
from hil.report.document import before_after_image, render_html
from hil.tables import Band, TableSet


def calibration_report(axis: AxisConfig, result: Calibration) -> str:
    """Before, and each proof."""
    campaigns = [NamedCampaign("before", result.before)]
    campaigns += [
        NamedCampaign(f"round {number}", one.records, _outside_note(len(one.outside), axis.correction.band))
        for number, one in enumerate(result.rounds, start=1)
    ]
    return render_html(
        ReportData(
            f"Calibration of axis {axis.name}",
            tuple(campaigns),
            identity(axis),
            _limits(axis.correction.band),
            in_force(result.tables),
            uncertainty=uncertainty_of(axis),
        )
    )


def verification_report(axis: AxisConfig, tables: TableSet, result: Verification) -> str:
    """One campaign with the correction in force."""
    note = _outside_note(len(result.outside), axis.correction.band)
    campaigns = (NamedCampaign("verified", result.records, note),)
    return render_html(
        ReportData(
            f"Verification of axis {axis.name}",
            campaigns,
            identity(axis),
            _limits(axis.correction.band),
            in_force(tables),
            uncertainty=uncertainty_of(axis),
        )
    )


def loop_report(axis: AxisConfig, loop: Loop, notes: Sequence[str] = ()) -> str:
    """The whole loop, with the diagnosis and what its effects look like over the rows it was made on."""
    turn = loop.turn
    return render_html(
        ReportData(
            f"Closed loop on axis {axis.name}",
            loop_campaigns(loop),
            identity(axis),
            _limits(axis.correction.band),
            in_force(turn.extended.tables),
            diagnosis_with_plots(turn.diagnosis, turn.diagnosed),
            NamedCampaign("diagnosed", turn.diagnosed.with_column("residual_um", turn.diagnosis.before_um)),
            (*notes, *_in_motion_notes(loop.in_motion)),
            uncertainty=uncertainty_of(axis),
        )
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
    for finding in turn.diagnosis.findings:
        yield f"In motion: {finding.effect} ({finding.confidence:.2f}, {finding.action.value}). {finding.explanation}"
    if turn.diagnosis.unexplained:
        yield "In motion: structure is left that nothing in the catalogue explains."


def diagnosis_with_plots(diagnosis: Diagnosis, records: Records) -> Mapping[str, Any]:
    """The contract's JSON, each finding with the residual and the effect over the column it follows."""
    form = diagnosis.to_json()
    for finding, plain in zip(diagnosis.findings, form["findings"], strict=True):
        effect_um = finding.term.error_um(records.columns)
        column = _plot_column(finding.term.needs, records)
        plain["plot"] = {
            "column": column,
            "unit": _unit(column),
            "x": records[column].tolist(),
            "residual_um": (diagnosis.residual_um + effect_um - np.mean(effect_um)).tolist(),
            "effect_um": (effect_um - np.mean(effect_um)).tolist(),
        }
    return form


def _plot_column(needs: Sequence[str], records: Records) -> str:
    """The column that tells most: the first the effect reads beyond position and direction, else the position."""
    for name in needs:
        if name not in ("target_mm", "direction") and name in records:
            return name
    return "target_mm"


def _unit(column: str) -> str:
    for ending, unit in (("_mm_s", "mm/s"), ("_mm", "mm"), ("_c", "°C"), ("_s", "s"), ("_kg", "kg"), ("_percent", "%")):
        if column.endswith(ending):
            return unit
    return ""


def identity(axis: AxisConfig) -> dict[str, str]:
    """What a reader must know of the set-up to repeat it."""
    drive = {
        "bench": f"simulated CiA-402 drive on a virtual CAN bus, machine {axis.drive.machine}, seed {axis.drive.seed}",
        "canopen": f"CANopen node {axis.drive.node_id} on {axis.drive.interface} {axis.drive.channel}",
        "modbus": f"Modbus unit {axis.drive.node_id} on {axis.drive.url}, {axis.drive.register_map}",
    }[axis.drive.backend]
    how = axis.measurement
    return {
        "Axis": axis.name,
        "Travel": f"{axis.limits.travel_min_mm:g} to {axis.limits.travel_max_mm:g} mm",
        "Drive": drive,
        **instrument_identity(axis.instrument),
        "Feed between targets": f"{how.velocity_mm_s:g} mm/s",
        "At each target": f"{how.dwell_s:g} s dwell, {how.reading_s:g} s averaged",
    }


def in_force(tables: TableSet) -> tuple[TableInForce, ...]:
    what = f"{tables.mode.value}, {len(tables.pitch.position_mm)} positions"
    return (TableInForce("correction tables", tables.digest(), what),)


def _limits(band: Band | None) -> tuple[float, float] | None:
    return None if band is None else (band.low_um, band.high_um)


def _outside_note(outside: int, band: Band | None) -> str:
    if band is None:
        return ""
    return "all sections inside the band" if not outside else f"{outside} sections outside the band"
