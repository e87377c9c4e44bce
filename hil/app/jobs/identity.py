"""The set-up as a report states it: axis, drive, instrument and uncertainty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hil.axis.axis_file import AxisConfig, DriveAxis, InstrumentConfig
from hil.figures.uncertainty import UncertaintyInputs


def drive_in_words(axis: DriveAxis) -> str:
    """The drive as text."""
    if axis.drive.backend == "bench":
        return f"bench, {axis.drive.machine} machine, as {axis.drive.face}"
    return axis.drive.backend


def identity(axis: AxisConfig) -> dict[str, str]:
    """The set-up that a repetition needs, name -> text."""
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


def uncertainty_of(axis: AxisConfig) -> UncertaintyInputs | None:
    """The axis file's uncertainty inputs, None without. A misalignment that is not stated is taken from the beam's alignment."""
    inputs, beam = axis.uncertainty, axis.instrument.alignment
    if inputs is None or beam is None or inputs.misalignment_mm:
        return inputs
    targets = axis.measurement.targets_mm
    return replace(inputs, misalignment_mm=beam.lateral_mm(targets[-1] - targets[0]))
