"""`hil lost-motion`: system C, what is lost after a reversal, measured by the axis's instrument and put into force."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import asdict
from datetime import datetime
from typing import Any

from hil.axis import AxisConfig, load_axis
from hil.axis_lost_motion import LostMotionConfig, default_lost_motion
from hil.cli.axis_options import add_axis_arguments, add_password_options, open_store, seed
from hil.cli.effects_input import add_effects_option, read_effects
from hil.cli.output import number, print_facts, print_table, write_json
from hil.cli.progress import terminal_progress
from hil.compensation import Compensation
from hil.files import replace_file
from hil.jobs.identity import drive_in_words
from hil.journal import Campaign
from hil.procedures.lost_motion import (
    LostMotionResult,
    measure_lost_motion,
    proof_steps,
    rms,
    stroke_steps,
    verdict,
)
from hil.store import SealedStore, compensation_in_force
from hil.wiring import connected

EXAMPLE = """\
example:
  hil lost-motion X.toml --dry-run                   what would move, how far, and how long it takes
  hil lost-motion X.toml --report lost-motion.html   measure, fit, prove, and store it beside the axis's tables
  hil lost-motion X.toml --only-measure              store nothing; needs no key
  hil circle X.toml Y.toml --report circle.html      what a circle says of it

The [lost_motion] section of the axis file says where and how far: at_mm, stroke_mm, places, finest_um, runs, proof_moves,
shortest_rise_um. Calibrate first: the tables hold what each direction needs, and the rise says how the command goes from one to the
other after a reversal, so nothing is counted twice. Without tables the axis gets the lost motion alone. A new calibration replaces it.
Exit status 1: the correction did not prove itself in moves of all lengths, or the strokes were too short; nothing was stored.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "lost-motion",
        help="lost motion after a reversal: measure, fit, store, prove",
        description="Measure how the table lags after reversals, fit its rise, put it into force, and prove it by fresh moves.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--only-measure", action="store_true", help="measure, fit and prove, but store nothing")
    parser.add_argument("--resume", action="store_true", help="go on with an interrupted measurement")
    parser.add_argument("--seed", type=seed, default=1, help="chooses the moves of the proof (default 1)")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_password_options(parser, key=True)
    add_effects_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """0: measured, proven and stored; 1: not proven."""
    axis = load_axis(args.axis)
    how = axis.lost_motion or default_lost_motion(axis.path, axis.limits, axis.measurement.targets_mm)
    if args.dry_run:
        _print_plan(axis, how, args)
        return 0
    present, store = _present(args, axis)
    purpose = {**axis.purpose("lost-motion"), "how": asdict(how), "seed": args.seed}
    purpose |= {} if present is None else compensation_in_force(present)
    with connected(axis) as machine, terminal_progress() as listener:
        campaign = Campaign.numbered(axis.store.directory, purpose, resume=args.resume)
        machine.session.prepare()
        result = measure_lost_motion(machine.session, campaign, how, present, listener, seed=args.seed)
        if store is not None and result.good:
            store.save(result.compensation)
    stored = str(store.path) if store is not None and result.good else "nothing"
    facts = _facts(result, present, stored, str(campaign.directory))
    _print(result, facts)
    if args.report:
        _write_report(args.report, axis, how, result, facts)
    if args.json:
        write_json(args.json, _form(axis, how, result, stored=store is not None and result.good))
    return 0 if result.good else 1


def _present(args: argparse.Namespace, axis: AxisConfig) -> tuple[Compensation | None, SealedStore | None]:
    """What is in force, and where the new is to be stored; every password is asked for before anything moves."""
    there = axis.tables_path.exists()
    if args.only_measure:
        readable = there and (args.password_file or os.environ.get("HIL_PASSWORD") or sys.stdin.isatty())
        return (open_store(args, axis, writing=False).load(read_effects(args.effects)) if readable else None), None
    store = open_store(args, axis, writing=True)
    return (store.load(read_effects(args.effects)) if there else None), store


def _print_plan(axis: AxisConfig, how: LostMotionConfig, args: argparse.Namespace) -> None:
    rows = len(stroke_steps(how)) + 2 * len(proof_steps(how, args.seed))
    rest_s = axis.measurement.dwell_s + axis.measurement.reading_s
    homing = "home it, " if axis.measurement.home else ""
    print(
        f"axis {axis.name} over {axis.drive.backend}: would enable it, {homing}take the datum at {axis.measurement.reference_mm:g} mm"
    )
    print(
        f"would go to and fro between {how.low_mm:g} and {how.high_mm:g} mm {how.runs} times at {axis.measurement.velocity_mm_s:g}"
        f" mm/s, uncorrected, at rest at {how.places} places from {how.finest_um:g} µm on after each turning"
    )
    print(f"would then make {how.proof_moves} moves of all lengths there twice, without the new correction and with it")
    print(
        f"would capture {rows} positions, {rest_s:g} s at rest each, some {rows * (rest_s + 0.2) / 60.0:.0f} min in all"
    )
    print(f"would write rows below {axis.store.directory}")
    print(
        "would store nothing"
        if args.only_measure
        else f"would store the correction in {axis.tables_path}, if it proves itself"
    )


def _facts(result: LostMotionResult, present: Compensation | None, stored: str, kept: str) -> dict[str, str]:
    found, proof = result.estimate, result.proof
    parameters = {name.replace("_", " "): str(each) for name, each in found.parameters.items()}
    before = (
        "nothing" if present is None else "the tables" if present.rise is None else "the tables and an earlier rise"
    )
    return {
        "lost motion": f"{found.amount_um:.2f} µm, rising as {found.rise.shape.name}",
        **{f"  {name}": text for name, text in parameters.items()},
        "noise of a reading": f"{result.stretch.noise_um:.3f} µm",
        "proof, before": f"{rms(proof.before_um):.2f} µm RMS, {abs(proof.before_um).max():.2f} at worst, with {before} in force",
        "proof, after": f"{rms(proof.after_um):.2f} µm RMS, {abs(proof.after_um).max():.2f} at worst",
        "over-compensated": f"{proof.over_um:.2f} µm at worst, {100.0 * proof.over_um / found.amount_um:.1f} % of the lost motion",
        "stored": stored,
        "rows": kept,
    }


def _print(result: LostMotionResult, facts: dict[str, str]) -> None:
    rows = [
        [
            one.fitted.shape.name,
            number(one.fitted.rise.amount_um),
            number(one.rms_um, 3),
            number(one.held_out_rms_um, 3),
        ]
        for one in result.estimate.contenders
    ]
    print_table(["shape", "amount, µm", "RMS, µm", "RMS on strokes held out, µm"], rows)
    print_facts(facts)
    for sentence in verdict(result):
        print(sentence)


def _write_report(
    path: str, axis: AxisConfig, how: LostMotionConfig, result: LostMotionResult, facts: dict[str, str]
) -> None:
    from hil.report.lost_motion import LostMotionReport, render_lost_motion  # noqa: PLC0415  (plots are slow to import)

    identity = {
        "Axis": axis.name,
        "Drive": drive_in_words(axis),
        "Measured": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "Strokes": f"{how.stroke_mm:g} mm around {how.at_mm:g} mm, {how.runs} to and fro, {how.places} places after each turning",
        "Proof": f"{how.proof_moves} moves of all lengths there, before and after",
    }
    title = f"Lost motion of axis {axis.name} after a reversal"
    report = LostMotionReport(title, result.estimate, result.proof, verdict(result), identity, facts)
    replace_file(path, render_lost_motion(report).encode())


def _form(axis: AxisConfig, how: LostMotionConfig, result: LostMotionResult, *, stored: bool) -> dict[str, Any]:
    proof = result.proof
    return {
        "axis": axis.name,
        "good": result.good,
        "stored": stored,
        **result.estimate.to_json(),
        "noise_um": result.stretch.noise_um,
        "reversals": [
            {"direction": one.direction, "travel_mm": one.travel_mm.tolist(), "error_um": one.error_um.tolist()}
            for one in result.estimate.reversals
        ],
        "proof": {
            "moves": how.proof_moves,
            "before": {"rms_um": rms(proof.before_um), "peak_um": float(abs(proof.before_um).max())},
            "after": {"rms_um": rms(proof.after_um), "peak_um": float(abs(proof.after_um).max())},
            "over_compensation_um": proof.over_um,
        },
        "verdict": list(verdict(result)),
    }
