"""`hil probe`: a touch probe's run-out measured on the machine and corrected (system D)."""

from __future__ import annotations

import argparse
import os
from functools import partial
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from hil.probe import job as probe
from hil.probe.machine_file import ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import BoreCentre, Correction, HandledCode, RunOutMeasurement, on_schedule, ways
from hil.probe.results import BoreResult, FeatureResult, ProbeCorrectionResult, RunOutResult
from hil.probe.runout import CorrectionCode, RunOut, run_out_std_um
from hil.probe.store import RunOutStore
from hil.probe.wiring import before_feature
from hil.ui.terminal.options import KEY, READING
from hil.ui.terminal.output import finish, print_facts, print_table, times, write_json
from hil.ui.terminal.passwords import password
from hil.ui.terminal.progress import terminal_progress
from sim_backends.plant.touch_probe import Bore, Boss, Solid, Wall
from sim_backends.probe_bench import ProbeBench


def print_measured(
    config: ProbeMachineConfig, measured: RunOutMeasurement, refusal: str | None, path: Path, bench: ProbeBench | None
) -> None:
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
        "±": _uncertainty_text(config, measured),
        "z": approach_text(config, config.block.z_mm),
        "machine time": f"{measured.seconds:.1f} s, contacts by {measured.mode}",
    }
    if bench is not None:
        stylus = bench.probe.parameters.stylus
        x_um, y_um = (1000 * offset for offset in stylus.offset_mm)
        facts["simulated"] = f"Δx {x_um:+.2f} µm, Δy {y_um:+.2f} µm, tip radius {stylus.radius_mm:.4f} mm"
    facts["verdict"] = f"stored and in force: {path}" if refusal is None else f"refused: {refusal}"
    print_facts(facts)


def _moment(when: str) -> str:
    """A stored moment (ISO 8601, UTC) to the second."""
    return f"{when[:19].replace('T', ' ')} UTC"


def run_out_text(found: RunOut) -> str:
    return f"Δx {1000 * found.x_mm:+.2f} µm, Δy {1000 * found.y_mm:+.2f} µm, tip radius {found.tip_radius_mm:.4f} mm"


def _uncertainty_text(config: ProbeMachineConfig, measured: RunOutMeasurement) -> str:
    """The uncertainty of a run-out; of one turn, that there is none."""
    std_um = run_out_std_um(measured.turns, config.position_step_mm(measured.mode))
    if std_um is None:
        return "not known from one turn"
    return f"{2.0 * std_um:.2f} µm in Δx and in Δy (k = 2, from the scatter of {len(measured.turns)} turns)"


def print_measure_plan(config: ProbeMachineConfig, mode: str) -> None:
    """Prints the moves and writes of M90."""
    block, probe = config.block, config.probe
    sign = "+" if block.facing > 0 else "−"
    by = "the drive's touch-probe function" if mode == "latch" else f"pulses of {1000 * probe.pulse_mm:g} µm"
    print(f"machine {config.name} over {config.x.drive.backend}: would enable {', '.join(config.axes)}")
    if block.y_mm is not None:
        print(f"would move y to {block.y_mm:g} mm")
    print(f"would move x to {block.start_mm:g} mm at {probe.position_mm_s:g} mm/s")
    print(f"z: {approach_text(config, block.z_mm)}")
    print(
        f"would feed x by up to {block.search_mm:g} mm in {sign} direction at {probe.touch_mm_s:g} mm/s, contact by {by}, and back"
    )
    print(f"would do so {times(block.turns)} with the spindle at each of 0, 90, 180 and 270°")
    print(f"would write to {config.store.directory}")


def approach_text(config: ProbeMachineConfig, z_mm: float | None) -> str:
    """How Z gets to the height of a measurement."""
    heights_mm = config.heights_mm(z_mm)
    if heights_mm is None:
        return "not moved, as [machine] names no z axis: the operator jogs the ball to its height first"
    return f"at {heights_mm[0]:g} mm on the way, lowered to {heights_mm[1]:g} mm to measure"


def print_centre(config: ProbeMachineConfig, found: BoreCentre, bench: ProbeBench | None) -> None:
    """Prints a bore's centre and the correction made."""
    centring = found.centring
    facts = {
        "middle of travel": f"X {centring.middle_mm[0]:.4f} mm, Y {centring.middle_mm[1]:.4f} mm",
        "centre, corrected": f"X {centring.centre_mm[0]:.4f} mm, Y {centring.centre_mm[1]:.4f} mm",
        "diameter": f"{centring.diameter_mm:.4f} mm",
        "z": approach_text(config, config.require_bore().z_mm),
    }
    for solid in () if bench is None else bench.probe.parameters.solids:
        if isinstance(solid, Bore):
            facts["simulated"] = f"centre X {solid.point_mm[0]:.4f} mm, Y {solid.point_mm[1]:.4f} mm"
    print_facts({**facts, **correction_facts(config, found.correction)})


def correction_facts(config: ProbeMachineConfig, done: Correction) -> dict[str, str]:
    """A correction as label -> text."""
    (x_um, y_um), (left_x, left_y) = ([1000 * mm for mm in pair] for pair in (done.driven_mm, done.counter_mm))
    return {
        config.codes.name(done.code): f"moved X by {x_um:+.2f} µm, Y by {y_um:+.2f} µm",
        "left over": f"X {left_x:+.2f} µm, Y {left_y:+.2f} µm",
    }


SECONDS_PER_MINUTE = 60.0


# -- what all jobs need --------------------------------------------------------------------------------------------------
def _open_store(args: argparse.Namespace, config: ProbeMachineConfig, *, writing: bool) -> RunOutStore:
    """The store; its passwords are asked for before any motion."""

    def reading() -> str:
        return password(args.password_file, READING, "reading password", os.environ)

    def key() -> str:
        return password(args.key_password_file, KEY, "builder key's password", os.environ)

    return probe.opened_store(config, reading, key if writing else None)


# -- measure -------------------------------------------------------------------------------------------------------------
def run_measure(args: argparse.Namespace) -> int:
    """Returns 0: measured and stored; 1: refused (of a schedule: at least once)."""
    if args.times is not None and args.every is None:
        raise InputError("--times needs --every, expected an interval in minutes")
    config = load_probe_machine(args.machine)
    if args.dry_run:
        print_measure_plan(config, args.mode or config.probe.mode)
        return 0
    store = _open_store(args, config, writing=True)
    with terminal_progress() as listener, probe.at_machine(config, store, in_bore=False, listener=listener) as place:
        once = partial(_measure_once, args, place)
        if args.every is None:
            return 0 if once() is None else 1
        schedule = on_schedule(once, place.clock, SECONDS_PER_MINUTE * args.every, args.times, listener)
    print(f"measurements: {schedule.done}, of them refused: {schedule.refused}; history in {place.store.history_path}")
    return 0 if not schedule.refused else 1


def _measure_once(args: argparse.Namespace, place: probe.ProbePlace) -> str | None:
    found = probe.measure(place, args.mode)
    config, refusal = place.config, found.refusal
    print_measured(config, found.measurement, refusal, place.store.path, place.bench)
    history = place.store.history() if args.report else ()
    finish(args, RunOutResult(config.x, None, config, found.measurement, refusal, history))
    return refusal


# -- other measurements --------------------------------------------------------------------------------------------------
def run_other(args: argparse.Namespace) -> int:
    config, name = load_probe_machine(args.machine), args.feature
    feature = config.require_feature(name)
    store = _open_store(args, config, writing=False)
    known, when = store.load()
    height = approach_text(config, feature.z_mm)
    if args.dry_run:
        x_mm, y_mm = before_feature(feature)
        print(f"machine {config.name}: would move x to {x_mm:g} mm and y to {y_mm:g} mm")
        print(f"z: {height}")
        print(f"would feed by up to {feature.search_mm:g} mm, {times(len(ways(feature)))}, until contact")
        return 0
    with terminal_progress() as listener, probe.at_machine(config, store, feature=name, listener=listener) as place:
        found = probe.measure_other(place, known, name, args.mode, spindle_deg=args.spindle)
    rows = [
        [_heading(key), _shown(key, value), _shown(key, found.uncorrected[key])]
        for key, value in found.corrected.items()
    ]
    print_table([name, "corrected", "not corrected"], rows)
    facts = {
        "spindle": f"{found.spindle_deg:.2f}°",
        "run-out": f"{run_out_text(known)}, measured {_moment(when)}",
        "z": height,
    }
    if place.bench is not None:
        facts["simulated"] = "; ".join(map(_solid_text, place.bench.probe.parameters.solids))
    print_facts(facts)
    return finish(args, FeatureResult(config.x, None, config, found, when))


def _solid_text(solid: Solid) -> str:
    """What the simulated probe touched."""
    if isinstance(solid, Wall):
        tilt_deg = (solid.bearing_deg + 45.0) % 90.0 - 45.0
        return f"face through X {solid.point_mm[0]:.4f} mm, Y {solid.point_mm[1]:.4f} mm at {tilt_deg:.5f}°"
    if isinstance(solid, Boss):
        x_mm, y_mm, _ = solid.point_mm
        return f"middle X {x_mm:.4f} mm, Y {y_mm:.4f} mm, diameter {2.0 * solid.radius_mm:.4f} mm"
    return str(solid)


def _heading(key: str) -> str:
    """A result's name and unit, from its key: "width_x_mm" -> "width x, mm"."""
    name, unit = key.rsplit("_", 1)
    return f"{name.replace('_', ' ')}, {'°' if unit == 'deg' else 'µm' if unit == 'um' else unit}"


def _shown(name: str, value: float) -> str:
    return f"{value:+.2f}" if name.endswith("_um") else f"{value:.5f}" if name.endswith("_deg") else f"{value:.4f}"


# -- codes ---------------------------------------------------------------------------------------------------------------
def run_codes(args: argparse.Namespace) -> int:
    config = load_probe_machine(args.machine)
    config.require_codes()
    if args.dry_run:
        print_codes(config)
        return 0
    store = _open_store(args, config, writing=True)
    forms: list[dict[str, Any]] = []

    def keep(handled: HandledCode) -> None:
        did = handled.did
        if isinstance(did, Correction):
            said = correction_facts(config, did)[handled.name]
            done = ProbeCorrectionResult(config.x, None, config, did, "").form()
            forms.append({name: done[name] for name in ("code", "driven_mm", "counter_mm")})
        else:
            said = f"run-out {run_out_text(did.run_out)}, stored and in force"
            forms.append({"code": handled.name, **RunOutResult(config.x, None, config, did, None).form()})
        print(f"{handled.name}: {said}; MFIN given", flush=True)
        if args.json:
            write_json(args.json, {"machine": config.name, "handled": forms})

    print_codes(config)
    with terminal_progress() as listener, probe.at_machine(config, store, in_bore=False, listener=listener) as place:
        probe.serve(place, times=args.times, wait_s=args.wait, mode=args.mode, keep=keep)
    return 0


def print_codes(config: ProbeMachineConfig) -> None:
    codes = config.codes
    x, y, both = (codes.name(code) for code in CorrectionCode)
    strobe = "the code's line itself" if codes.strobe_bit is None else f"input {codes.strobe_bit}"
    where = f"{config.axes[config.require_codes()].name}" + (
        "" if codes.station is None else f"'s bus, module {codes.station}"
    )
    print(f"M{codes.measure} measures, {x} corrects X, {y} Y, {both} both")
    bits = ", ".join(map(str, codes.code_bits))
    print(f"wires at {where}: strobe {strobe}, code on inputs {bits} ({codes.coding}), MFIN output {codes.mfin_bit}")


# -- correct and centre --------------------------------------------------------------------------------------------------
def run_correct(args: argparse.Namespace) -> int:
    config = load_probe_machine(args.machine)
    code = config.codes.correction(args.code)
    store = _open_store(args, config, writing=False)
    known, when = store.load()
    if args.dry_run:
        x_um, y_um = (1000 * amount for amount in known.correction_mm(code))
        print(f"run-out {run_out_text(known)}, measured {_moment(when)}")
        print(f"would move x by {x_um:+.2f} µm and y by {y_um:+.2f} µm at spindle angle 0°; at another, turned with it")
        return 0
    with terminal_progress() as listener, probe.at_machine(config, store, listener=listener) as place:
        done = probe.drive_correction(place, known, code)
    print_facts({"run-out": f"{run_out_text(known)}, measured {_moment(when)}", **correction_facts(config, done)})
    return finish(args, ProbeCorrectionResult(config.x, None, config, done, when))


def run_centre(args: argparse.Namespace) -> int:
    config = load_probe_machine(args.machine)
    bore = config.require_bore()
    code = CorrectionCode.M93 if args.code is None else config.codes.correction(args.code)
    store = _open_store(args, config, writing=False)
    known, when = store.load()
    if args.dry_run:
        print(f"machine {config.name}: would move x to {bore.x_mm:g} mm and y to {bore.y_mm:g} mm")
        print(f"z: {approach_text(config, bore.z_mm)}")
        corrected = config.codes.name(code)
        print(
            f"would feed each by up to {bore.reach_mm:g} mm to both sides, and go to the centre, corrected by {corrected}"
        )
        return 0
    with terminal_progress() as listener, probe.at_machine(config, store, listener=listener) as place:
        found = probe.centre(place, known, code, args.mode)
    print_centre(config, found, place.bench)
    return finish(args, BoreResult(config.x, None, config, found, when))
