"""The set-up as a report states it: axis, drive and instrument."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from hil.axis.axis_file import AxisConfig, DriveAxis, InstrumentConfig


def drive_in_words(axis: DriveAxis) -> str:
    """The drive as text, and what machine it moves where that is simulated."""
    drive = axis.drive
    like = "" if drive.like is None else f", a likeness of {drive.like.name}, which proves nothing of it"
    if drive.backend == "bench":
        return f"simulated, as {drive.face}{like or f', machine {drive.machine}, seed {drive.seed}'}"
    where = {
        "canopen": f"CANopen node {drive.node_id} on {drive.interface} {drive.channel}",
        "modbus": f"Modbus unit {drive.unit} on {drive.url}, {drive.register_map}",
    }
    return where[drive.backend] + (", simulated" if drive.simulated else "") + like


def now_in_words() -> str:
    """Present date and local time, as a report shows it."""
    return datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")


def measured_now(axis: DriveAxis) -> dict[str, str]:
    """Axis, drive and time of a measurement that has just ended, name -> text."""
    return {"Axis": axis.name, "Drive": drive_in_words(axis), "Measured": now_in_words()}


def identity(axis: AxisConfig) -> dict[str, str]:
    """The set-up that a repetition needs, name -> text."""
    how = axis.measurement
    return {
        "Axis": axis.name,
        "Travel": f"{axis.limits.travel_min_mm:g} to {axis.limits.travel_max_mm:g} mm",
        "Drive": drive_in_words(axis),
        **instrument_identity(axis.instrument),
        "Feed between targets": f"{how.velocity_mm_s:g} mm/s",
        "At each target": f"{how.dwell_s:g} s dwell, {how.reading_s:g} s averaged",
    }


def instrument_identity(config: InstrumentConfig) -> dict[str, str]:
    """The instrument and its alignment, name -> text."""
    if config.replay is not None:
        return {"Instrument": f"recording {Path(config.replay.file).name}, column {config.replay.column}"}
    if config.kind == "nd2xx":
        return {"Instrument": f"HEIDENHAIN ND 2xx display on {config.port}"}
    if config.display is not None:
        return {"Instrument": f"display on {config.port}, lines by the pattern {config.display.pattern}"}
    facts = {"Instrument": f"µMD interferometer on {config.port}, λ/{config.wavelength_fraction}"}
    equation = "Ciddor" if config.air_equation == "ciddor" else "modified Edlén"
    facts["Air compensation"] = equation if config.compensate_air else "off"
    if config.dead_path_mm:
        facts["Dead path"] = f"{config.dead_path_mm:g} mm"
    if (beam := config.alignment) is not None:
        facts["Beam against motion"] = (
            f"{beam.angle_mrad:.2f} mrad, reads {beam.short_ppm:.2f} ppm short (at most {beam.short_at_most_ppm:.2f})"
        )
    if config.material is not None:
        facts["Lengths at 20 °C"] = (
            f"{config.material.expansion_ppm_per_k:g} ppm/K by the temperature of {config.material.place}"
        )
    return facts
