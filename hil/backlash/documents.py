"""The result of a measurement of lost motion by torque: sentences, report, and plain values."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from hil.axis.axis_file import DriveAxis
from hil.axis.identity import drive_in_words
from hil.backlash.job import MeasuredBacklash
from hil.backlash.neutral_settings import BacklashSettings
from hil.backlash.procedure import TorqueBacklash
from hil.backlash.result import NAMES, fitted_lost_motion, mean_um, reversal_json
from hil.backlash.settings import NoSetting


def facts(settings: BacklashSettings, result: TorqueBacklash) -> dict[str, str]:
    """The drive's parameters before and now, as label -> text."""
    before = result.found.values
    if isinstance(settings.amount, NoSetting):
        lines = {"drive's own compensation": "none"}
    else:
        lines = {f"{name} held before": _held(settings, name, value) for name, value in before.items()}
    if result.written is None:
        lines["now"] = "as before, nothing was written"
    elif isinstance(settings.amount, NoSetting):
        lines["now"] = f"{result.written:g} µm in the sealed tables, beside their pitch; not yet proven (hil verify)"
    else:
        held = _held(settings, settings.amount.name, result.written)
        lines[f"{settings.amount.name} holds now"] = f"{held}, written and read back"
    if settings.scale != 1.0 and result.lost_motion_um is not None:
        scaled_um = settings.scale * result.lost_motion_um
        lines["amount to write"] = (
            f"{scaled_um:.2f} µm: {result.lost_motion_um:.2f} × {settings.scale:g} ([backlash] scale)"
        )
    if result.found.from_note:
        lines["note"] = "an earlier measurement had not put these back; this one has"
    return lines


def _held(settings: BacklashSettings, name: str, value: float) -> str:
    """What a setting of the drive holds; the amount also in µm, where its unit is another."""
    if name != settings.amount.name:
        return f"{value:g}"
    return f"{value * settings.amount_um:g} µm" + (
        "" if settings.amount_um == 1.0 else f" ({value:g} in the drive's unit)"
    )


def verdict(result: TorqueBacklash) -> str:
    """The sentence for a measurement without a value, empty for one with a value."""
    exceeded = result.exceeded
    if exceeded is None:
        return ""
    reach_um = float(exceeded.trace.travel_um[-1])
    seen = exceeded.published_um
    hint = (
        ""
        if seen is None
        else f"; the four-sample rule has a peak at {seen:.1f} µm, finer steps may show a wind-up there"
    )
    return (
        f"detection limit exceeded: {NAMES[exceeded.trace.direction]} shows no break-away within {reach_um:.0f} µm"
        f" ({len(exceeded.trace.position_load_mm) - 1} steps); everything is as it was, nothing was written{hint}"
    )


def report_html(axis: DriveAxis, measured: MeasuredBacklash) -> str:
    """The report as an HTML page."""
    from hil.backlash.report import BacklashReport, render_backlash  # noqa: PLC0415  (plots are slow to import)

    how, result = measured.how, measured.result
    identity = {
        "Axis": axis.name,
        "Drive": drive_in_words(axis),
        "Measured": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "Reversals": ", ".join(f"{NAMES[each]} at {how.turning_mm(each):g} mm" for each in how.directions),
        "Feed": how.feed if how.feed == "steps" else f"creep at {how.creep_um_s:g} µm/s, averaged over steps",
        "Steps": f"{how.step_um:g} µm at {how.velocity_mm_s:g} mm/s, {how.readings} readings after {how.settle_s:g} s at rest",
    }
    title = f"Lost motion of axis {axis.name} by torque"
    parameters = facts(measured.settings, result)
    said = (title, result.reversals, how.method, verdict(result), identity, parameters, result.directions)
    return render_backlash(BacklashReport(*said))


def form(axis: DriveAxis, measured: MeasuredBacklash) -> dict[str, Any]:
    """The machine-readable result; lengths in µm."""
    result, method = measured.result, measured.how.method
    found = fitted_lost_motion(result.reversals, result.directions)
    return {
        "axis": axis.name,
        "good": result.lost_motion_um is not None,
        "detection_limit_exceeded": result.exceeded is not None,
        "method": method,
        "feed": measured.how.feed,
        "lost_motion_um": result.lost_motion_um,
        "scale": measured.how.scale,
        "fitted": None if found is None else {"mean_um": found.mean_um, "u95_um": found.u95_um},
        "four_sample": {"mean_um": mean_um(result.reversals, "four-sample", result.directions)},
        "by_direction_um": {NAMES[each]: mean_um(result.reversals, method, [each]) for each in result.directions},
        "reversals": [reversal_json(one) for one in result.reversals],
        "parameters": {
            "before": result.found.values,
            "amount": measured.settings.amount.name,
            "amount_um": measured.settings.amount_um,
            "written": result.written,
        },
    }
