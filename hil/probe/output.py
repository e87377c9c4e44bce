"""What `hil probe` prints and what it gives as JSON."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from hil.app.terminal.output import print_facts, print_table
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.procedure import BoreCentre, Correction, RunOutMeasurement
from hil.probe.runout import RunOut
from sim_backends.plant.touch_probe import Bore
from sim_backends.probe_bench import ProbeBench


def print_measured(measured: RunOutMeasurement, refusal: str | None, path: Path, bench: ProbeBench | None) -> None:
    rows = [
        [
            str(number),
            *(f"{feed:.4f}" for feed in (turn.n_0_mm, turn.n_90_mm, turn.n_180_mm, turn.n_270_mm)),
            f"{turn.closure_um:+.2f}",
        ]
        for number, turn in enumerate(measured.turns, start=1)
    ]
    print_table(["turn", "N0, mm", "N90, mm", "N180, mm", "N270, mm", "closure, µm"], rows)
    facts = {
        "run-out": run_out_text(measured.run_out),
        "machine time": f"{measured.seconds:.1f} s, by {measured.mode}",
    }
    if bench is not None:
        stylus = bench.probe.parameters.stylus
        x_um, y_um = (1000 * offset for offset in stylus.offset_mm)
        facts["simulated"] = f"Δx {x_um:+.2f} µm, Δy {y_um:+.2f} µm, tip radius {stylus.radius_mm:.4f} mm"
    facts["verdict"] = f"in force, {path}" if refusal is None else f"refused: {refusal}"
    print_facts(facts)


def run_out_text(found: RunOut) -> str:
    return f"Δx {1000 * found.x_mm:+.2f} µm, Δy {1000 * found.y_mm:+.2f} µm, tip radius {found.tip_radius_mm:.4f} mm"


def measured_form(config: ProbeMachineConfig, measured: RunOutMeasurement, refusal: str | None) -> dict[str, Any]:
    return {
        "machine": config.name,
        "good": refusal is None,
        "refused": refusal,
        "mode": measured.mode,
        "seconds": measured.seconds,
        "run_out": asdict(measured.run_out),
        "turns": [{**asdict(turn), "closure_um": turn.closure_um} for turn in measured.turns],
    }


def print_measure_plan(config: ProbeMachineConfig, mode: str) -> None:
    block, probe = config.block, config.probe
    sign = "+" if block.facing > 0 else "−"
    by = "the drive's touch-probe function" if mode == "latch" else f"pulses of {1000 * probe.pulse_mm:g} µm"
    print(f"machine {config.name} over {config.x.drive.backend}: would enable {', '.join(config.axes)}")
    if block.y_mm is not None:
        print(f"would move y to {block.y_mm:g} mm")
    print(f"would move x to {block.start_mm:g} mm at {probe.position_mm_s:g} mm/s")
    print(
        f"would feed x by up to {block.search_mm:g} mm in {sign} direction at {probe.touch_mm_s:g} mm/s, contact by {by}, and back"
    )
    print(f"would do so {block.turns} times with the spindle at each of 0, 90, 180 and 270°")
    print(f"would write {config.store.directory}")


def print_centre(found: BoreCentre, bench: ProbeBench | None) -> None:
    centring = found.centring
    facts = {
        "half the travel": f"X {centring.middle_mm[0]:.4f} mm, Y {centring.middle_mm[1]:.4f} mm",
        "centre": f"X {centring.centre_mm[0]:.4f} mm, Y {centring.centre_mm[1]:.4f} mm",
        "diameter": f"{centring.diameter_mm:.4f} mm",
    }
    for solid in () if bench is None else bench.probe.parameters.solids:
        if isinstance(solid, Bore):
            facts["simulated"] = f"centre X {solid.point_mm[0]:.4f} mm, Y {solid.point_mm[1]:.4f} mm"
    print_facts({**facts, **correction_facts(found.correction)})


def correction_facts(done: Correction) -> dict[str, str]:
    (x_um, y_um), (left_x, left_y) = ([1000 * mm for mm in pair] for pair in (done.driven_mm, done.counter_mm))
    return {
        done.code.value: f"driven by X {x_um:+.2f} µm, Y {y_um:+.2f} µm",
        "counter": f"ends at X {left_x:+.2f} µm, Y {left_y:+.2f} µm",
    }


def correction_form(done: Correction) -> dict[str, Any]:
    return {"code": done.code.value, "driven_mm": list(done.driven_mm), "counter_mm": list(done.counter_mm)}
