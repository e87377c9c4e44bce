"""The reports of probe measurements, from their results. Imported only when one is written, since plotting loads
slowly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.procedure import BoreCentre, RunOutMeasurement
from hil.probe.report import ProbeReport, render_probe


def run_out_report(
    config: ProbeMachineConfig,
    measured: RunOutMeasurement,
    refusal: str | None,
    history: Sequence[Mapping[str, str]],
) -> str:
    """Report of one measurement and its history as HTML."""
    return render_probe(
        ProbeReport(
            f"Touch probe of {config.name}",
            measured.run_out,
            measured.turns,
            {"closure": config.block.closure_limit_um},
            "stored" if refusal is None else f"Refused: {refusal}",
            identity(config, measured.mode, history[-1]["time"] if history else ""),
            history,
        )
    )


def centre_report(config: ProbeMachineConfig, found: BoreCentre, when: str) -> str:
    """Report of a bore, and of the run-out by which it was corrected, as HTML."""
    centring = found.centring
    return render_probe(
        ProbeReport(
            f"Bore on {config.name}",
            centring.run_out,
            identity=identity(config, config.probe.mode, when),
            centring=centring,
        )
    )


def identity(config: ProbeMachineConfig, mode: str, when: str) -> dict[str, str]:
    """The set-up, as label -> text, as far as it is needed to repeat the measurement."""
    block, probe = config.block, config.probe
    by = "positions latched by the drive" if mode == "latch" else f"pulses of {1000 * probe.pulse_mm:g} µm"
    return {
        "Measured": when,
        "Machine": config.name,
        "Drives": ", ".join(f"{name} {axis.drive.backend}" for name, axis in config.axes.items()),
        "Contacts": f"{by}, {probe.touch_mm_s:g} mm/s",
        "Block": f"face at X {block.face_mm:g} mm, from {block.start_mm:g} mm, {block.turns} turns of the spindle",
        "Pre-travel": f"{1000 * probe.pretravel_mm:g} µm",
    }
