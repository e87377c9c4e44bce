"""The reports of a calibration and of a verification. Imported only when one is written, since plotting loads
slowly.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.axis.axis_file import AxisConfig, uncertainty_of
from hil.axis.identity import identity
from hil.calibration.calibrate import Calibration
from hil.calibration.job import Verification
from hil.correction.tables import Band, TableSet
from hil.ui.report.data import NamedCampaign, ReportData, TableInForce
from hil.ui.report.document import render_html


def calibration_report(axis: AxisConfig, result: Calibration, proof: Verification | None = None) -> str:
    """Report of a calibration as HTML: before, each round, and the proof at other targets where it was made."""
    campaigns = [NamedCampaign("before", result.before)]
    campaigns += [
        NamedCampaign(
            f"round {number}", one.records, _outside_note(len(one.outside), axis.correction.band), corrected=True
        )
        for number, one in enumerate(result.rounds, start=1)
    ]
    if proof is not None:
        campaigns.append(verified_campaign(axis, proof))
    return render_html(of_axis(axis, "Calibration of", campaigns, result.tables))


def verification_report(axis: AxisConfig, tables: TableSet, result: Verification) -> str:
    """Report of a verification as HTML: one campaign with the correction in force."""
    return render_html(of_axis(axis, "Verification of", [verified_campaign(axis, result)], tables))


def verified_campaign(axis: AxisConfig, result: Verification) -> NamedCampaign:
    note = _outside_note(len(result.outside), axis.correction.band)
    if result.not_judged:
        note += f"; not judged, with the reason: {'; '.join(map(str, result.not_judged))}"
    return NamedCampaign("verified", result.records, note, corrected=True)


def of_axis(axis: AxisConfig, what: str, campaigns: Sequence[NamedCampaign], tables: TableSet) -> ReportData:
    """The report's data: campaigns, identity of the axis, band, tables in force, and uncertainty."""
    return ReportData(
        f"{what} axis {axis.name}",
        tuple(campaigns),
        identity(axis),
        axis.correction.band,
        in_force(tables),
        band_targets_mm=axis.measurement.targets_mm,
        uncertainty=uncertainty_of(axis),
        limit_um=axis.correction.accuracy_limit_um,
    )


def in_force(tables: TableSet) -> tuple[TableInForce, ...]:
    """The tables in force, as a report names them."""
    what = f"{tables.mode.value}, {len(tables.pitch.position_mm)} positions"
    return (TableInForce("correction tables", tables.digest(), what),)


def _outside_note(outside: int, band: Band | None) -> str:
    if band is None:
        return ""
    return f"all sections inside {band}" if not outside else f"{outside} sections outside the band"
