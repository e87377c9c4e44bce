"""The set-up as a report states it: axis, drive and instrument."""

from __future__ import annotations

from pathlib import Path

from hil.axis.axis_file import AxisConfig, DriveAxis, InstrumentConfig


def bench_machine(axis: DriveAxis) -> str:
    """The simulated machine of the bench."""
    like = axis.drive.like
    return f"machine {axis.drive.machine}" if like is None else f"a likeness of {like.name}, which proves nothing of it"


def drive_in_words(axis: DriveAxis) -> str:
    """The drive as text."""
    if axis.drive.backend == "bench":
        return f"bench, {bench_machine(axis)}, as {axis.drive.face}"
    where = {
        "canopen": f"CANopen node {axis.drive.node_id} on {axis.drive.interface} {axis.drive.channel}",
        "modbus": f"Modbus unit {axis.drive.node_id} on {axis.drive.url}, {axis.drive.register_map}",
    }
    return where[axis.drive.backend] + (", simulated" if axis.drive.simulated else "")


def identity(axis: AxisConfig) -> dict[str, str]:
    """The set-up that a repetition needs, name -> text."""
    simulated = f"simulated CiA-402 drive on a virtual CAN bus, {bench_machine(axis)}, seed {axis.drive.seed}"
    drive = simulated if axis.drive.backend == "bench" else drive_in_words(axis)
    how = axis.measurement
    return {
        "Axis": axis.name,
        "Travel": f"{axis.limits.travel_min_mm:g} to {axis.limits.travel_max_mm:g} mm",
        "Drive": drive,
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
