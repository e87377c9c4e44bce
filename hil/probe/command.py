"""`hil probe`: a touch probe's run-out measured on the machine and corrected (system D)."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from hil.app.terminal.output import add_json_option, print_facts, print_table, write_json
from hil.app.terminal.passwords import KEY, READING, password
from hil.app.terminal.progress import terminal_progress
from hil.machine.events import Listener
from hil.probe import job as probe
from hil.probe.machine_file import MODES, ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import BoreCentre, Correction, RunOutMeasurement, on_schedule
from hil.probe.runout import CorrectionCode, RunOut
from hil.probe.store import RunOutStore
from hil.records.files import replace_file
from sim_backends.plant.touch_probe import Bore
from sim_backends.probe_bench import ProbeBench


def print_measured(measured: RunOutMeasurement, refusal: str | None, path: Path, bench: ProbeBench | None) -> None:
    """Prints the contacts, the run-out and the verdict."""
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
    """The run-out in one line."""
    return f"Δx {1000 * found.x_mm:+.2f} µm, Δy {1000 * found.y_mm:+.2f} µm, tip radius {found.tip_radius_mm:.4f} mm"


def measured_form(config: ProbeMachineConfig, measured: RunOutMeasurement, refusal: str | None) -> dict[str, Any]:
    """A measurement as plain values."""
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
    """Prints the moves and writes of M90."""
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
    """Prints a bore's centre and the correction made."""
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
    """A correction as label -> text."""
    (x_um, y_um), (left_x, left_y) = ([1000 * mm for mm in pair] for pair in (done.driven_mm, done.counter_mm))
    return {
        done.code.value: f"driven by X {x_um:+.2f} µm, Y {y_um:+.2f} µm",
        "counter": f"ends at X {left_x:+.2f} µm, Y {left_y:+.2f} µm",
    }


def correction_form(done: Correction) -> dict[str, Any]:
    """A correction as plain values, mm."""
    return {"code": done.code.value, "driven_mm": list(done.driven_mm), "counter_mm": list(done.counter_mm)}


EXAMPLE = """\
example:
  hil probe measure mill.toml --dry-run              what would move, and how far
  hil probe measure mill.toml --report probe.html    M90: run-out and tip radius, put into force if it closes
  hil probe measure mill.toml --mode step            by pulses, where the drive latches no positions
  hil probe measure mill.toml --every 30             again every 30 minutes, until interrupted
  hil probe correct mill.toml --code M91             move X by the run-out in force (M92: Y, M93: both)
  hil probe centre mill.toml                         touch a bore on both sides in X and Y, go to its centre

Jog the probe in front of the block (or into the bore) first: Z is not moved. hil/examples/probe_machine.toml shows a machine file.
Exit status 1: the measurement was refused, as the contacts do not close, do not repeat, or give another radius; nothing was stored.
"""
CODES = tuple(code.value for code in CorrectionCode)
SECONDS_PER_MINUTE = 60.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil probe` with its jobs."""
    parser = subparsers.add_parser(
        "probe",
        description="Measure the run-out of a touch probe on a reference block, and correct measurements by it.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    measure = _add_job(jobs, "measure", "M90: run-out and tip radius, from contacts at 0, 90, 180 and 270°", _measure)
    measure.add_argument("--every", metavar="MINUTES", type=_minutes, help="again at this interval, until interrupted")
    measure.add_argument("--times", metavar="N", type=_count, help="with --every: number of measurements")
    measure.add_argument("--report", metavar="FILE.html", help="also write a report")
    correct_ = _add_job(jobs, "correct", "M91, M92, M93: drive the axes by the run-out in force", _correct)
    correct_.add_argument("--code", choices=CODES, required=True, help="M91: X, M92: Y, M93: both")
    centre = _add_job(jobs, "centre", "find a bore's centre, corrected by the run-out in force, and go there", _centre)
    centre.add_argument("--code", choices=CODES, default="M93", help="M91: correct X, M92: Y, M93: both (default M93)")
    centre.add_argument("--report", metavar="FILE.html", help="also write a report")
    for touching in (measure, centre):
        touching.add_argument(
            "--mode", choices=MODES, help="contacts by latch or by steps (default: the machine file's)"
        )


def _add_job(
    jobs: argparse._SubParsersAction[argparse.ArgumentParser], name: str, what: str, run: Callable[..., int]
) -> argparse.ArgumentParser:
    parser = jobs.add_parser(
        name, help=what, description=what, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("machine", metavar="MACHINE.toml", help="the machine file")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    parser.add_argument(
        "--password-file",
        metavar="F",
        help=f"of a sealed store: file with the reading password (else ${READING}, else asked)",
    )
    parser.add_argument(
        "--key-password-file",
        metavar="F",
        help=f"of a sealed store: file with the builder key's password (else ${KEY}, else asked)",
    )
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser


def _minutes(text: str) -> float:
    try:
        minutes = float(text)
    except ValueError:
        minutes = math.nan
    if not 0 < minutes <= 1e6:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected minutes > 0")
    return minutes


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a whole number > 0")
    return int(text)


# -- what all jobs need --------------------------------------------------------------------------------------------------
def _open_store(args: argparse.Namespace, config: ProbeMachineConfig, *, writing: bool) -> RunOutStore:
    """The store; its passwords are asked for before any motion."""

    def reading() -> str:
        return password(args.password_file, READING, "reading password", os.environ)

    def key() -> str:
        return password(args.key_password_file, KEY, "builder key's password", os.environ)

    return probe.opened_store(config, reading, key if writing else None)


# -- measure -------------------------------------------------------------------------------------------------------------
def _measure(args: argparse.Namespace) -> int:
    """Returns 0: measured and stored; 1: refused (of a schedule: at least once)."""
    if args.times is not None and args.every is None:
        raise InputError("--times needs --every, expected an interval in minutes")
    config = load_probe_machine(args.machine)
    if args.dry_run:
        print_measure_plan(config, args.mode or config.probe.mode)
        return 0
    store = _open_store(args, config, writing=True)
    with probe.at_machine(config, store, in_bore=False) as place, terminal_progress() as listener:

        def once() -> str | None:
            return _measure_once(args, place, listener)

        if args.every is None:
            return 0 if once() is None else 1
        schedule = on_schedule(once, place.clock, SECONDS_PER_MINUTE * args.every, args.times, listener)
    print(f"{schedule.done} measured, {schedule.refused} refused; history in {place.store.history_path}")
    return 0 if not schedule.refused else 1


def _measure_once(args: argparse.Namespace, place: probe.ProbePlace, listener: Listener) -> str | None:
    found = probe.measure(place, args.mode, listener)
    measured, refusal = found.measurement, found.refusal
    print_measured(measured, refusal, place.store.path, place.bench)
    if args.report:
        from hil.probe.documents import run_out_report  # noqa: PLC0415  (plots are slow to import)

        history = place.store.history()
        text = run_out_report(place.config, measured, refusal, history)
        replace_file(args.report, text.encode())
    if args.json:
        write_json(args.json, measured_form(place.config, measured, refusal))
    return refusal


# -- correct and centre --------------------------------------------------------------------------------------------------
def _correct(args: argparse.Namespace) -> int:
    config = load_probe_machine(args.machine)
    code = CorrectionCode(args.code)
    store = _open_store(args, config, writing=False)
    known, when = store.load()
    if args.dry_run:
        x_um, y_um = (1000 * amount for amount in known.correction_mm(code))
        print(f"run-out of {when}: {run_out_text(known)}")
        print(
            f"would drive x by {x_um:+.2f} µm and y by {y_um:+.2f} µm at spindle angle 0 (turned with the angle found)"
        )
        return 0
    with probe.at_machine(config, store) as place, terminal_progress() as listener:
        done = probe.drive_correction(place, known, code, listener)
    print_facts({"run-out": f"{run_out_text(known)}, measured {when}", **correction_facts(done)})
    if args.json:
        write_json(args.json, {"machine": config.name, "measured": when, **correction_form(done)})
    return 0


def _centre(args: argparse.Namespace) -> int:
    config = load_probe_machine(args.machine)
    bore = config.require_bore()
    store = _open_store(args, config, writing=False)
    known, when = store.load()
    if args.dry_run:
        print(f"machine {config.name}: would move x to {bore.x_mm:g} mm and y to {bore.y_mm:g} mm")
        print(
            f"would feed each by up to {bore.reach_mm:g} mm to both sides, and go to the middle, corrected by {args.code}"
        )
        return 0
    with probe.at_machine(config, store) as place, terminal_progress() as listener:
        found = probe.centre(place, known, CorrectionCode(args.code), mode=args.mode, listener=listener)
    print_centre(found, place.bench)
    if args.report:
        from hil.probe.documents import centre_report  # noqa: PLC0415

        replace_file(args.report, centre_report(config, found, when).encode())
    if args.json:
        centring = found.centring
        form = {
            "machine": config.name,
            "measured": when,
            "middle_mm": list(centring.middle_mm),
            "centre_mm": list(centring.centre_mm),
            "diameter_mm": centring.diameter_mm,
        }
        write_json(args.json, {**form, **correction_form(found.correction)})
    return 0
