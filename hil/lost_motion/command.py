"""`hil lost-motion`: lost motion after a reversal (system C), measured by the axis's instrument and put into force."""

from __future__ import annotations

import argparse
import os
import sys

from drivers.errors import InputError
from drivers.files import replace_file
from hil.app.terminal.axis_options import (
    add_axis_arguments,
    add_password_options,
    add_zero_options,
    load_stored,
    open_store,
    seed,
    tell_zero,
)
from hil.app.terminal.measuring_options import machine_of
from hil.app.terminal.output import number, print_facts, print_table, times, write_json
from hil.app.terminal.progress import terminal_progress
from hil.app.terminal.records_input import add_effects_option, read_effects
from hil.axis.axis_file import AxisConfig, load_axis
from hil.axis.lost_motion import LostMotionConfig
from hil.correction.compensation import Compensation
from hil.correction.published_rise import TwoTanh
from hil.correction.rise import RUNNABLE, Rise, rise_of
from hil.correction.store import SealedStore, bound_tables
from hil.lost_motion.job import (
    MeasuredLostMotion,
    facts,
    form,
    lost_motion_config,
    measuring_plan,
    report_html,
    run_lost_motion,
    sentences,
)
from hil.lost_motion.procedure import NoLostMotionError

EXAMPLE = """\
example:
  hil lost-motion X.toml --dry-run                   what would move, how far, and how long it takes
  hil lost-motion X.toml --report lost-motion.html   measure, fit, prove, and store it beside the axis's tables
  hil lost-motion X.toml --shape two-tanh            with the published two terms, whichever shape fits best
  hil lost-motion X.toml --typed 4,3,0.02,0.4,0.1    the published terms as typed: Pc1, Pc2 µm, a1, a2, b2 mm of the load's travel
  hil lost-motion X.toml --only-measure              store nothing; needs no key
  hil circle X.toml Y.toml --report circle.html      the circle test with it

The [lost_motion] section of the axis file says where and how far: at_mm, stroke_mm, places, finest_um, runs, proof_moves,
shortest_rise_um. Calibrate first: the tables hold the correction of each direction, the rise is the transition from one to the
other after a reversal. Without tables the axis gets the lost motion alone. A new calibration replaces it.
Stored is what leaves less than before in fresh moves of all lengths, by more than the uncertainty of the difference (k = 2).
Exit status 0 also where nothing was to be corrected; 1: the proof failed, or the strokes were too short; nothing was stored.
"""


_SHAPES = {shape.name.replace(" ", "-"): shape for shape in RUNNABLE}


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil lost-motion`."""
    parser = subparsers.add_parser(
        "lost-motion",
        description="Measure how the table lags after reversals, fit its rise, put it into force, and prove it by fresh moves.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--only-measure", action="store_true", help="measure, fit and prove, but store nothing")
    parser.add_argument(
        "--shape",
        choices=list(_SHAPES),
        help="of the rise (default: two tanh, unless another leaves less, by more than the noise, and in the proof too)",
    )
    parser.add_argument(
        "--typed",
        type=_two_tanh,
        metavar="PC1,PC2,A1,A2,B2",
        help="two tanh terms with these amounts (µm), rises and onset (mm) in place of fitted ones; strokes and proof as always",
    )
    parser.add_argument("--resume", action="store_true", help="continue an interrupted measurement")
    parser.add_argument("--seed", type=seed, default=1, help="chooses the moves of the proof (default 1)")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser)
    add_password_options(parser, key=True)
    add_effects_option(parser)
    parser.set_defaults(run=run, resumes="lost-motion")


def _two_tanh(text: str) -> Rise:
    try:
        amount_1, amount_2, rise_1, rise_2, onset_2 = (float(value) for value in text.split(","))
        form = TwoTanh(amount_1, amount_2, rise_1, rise_2, onset_2)
    except (ValueError, InputError) as error:
        raise argparse.ArgumentTypeError(
            f"'{text}': expected Pc1,Pc2,a1,a2,b2 as five numbers, amounts ≥ 0 in µm, a1 and a2 > 0 and b2 ≥ 0 in mm ({error})"
        ) from error
    return rise_of(form)


def run(args: argparse.Namespace) -> int:
    """Returns 0: measured, proven and stored, or nothing to improve; 1: not proven. Raises what `measure_lost_motion` raises."""
    axis = load_axis(args.axis)
    how = lost_motion_config(axis)
    if args.shape and args.typed:
        raise InputError("--shape and --typed exclude one another: typed values are of two tanh terms")
    asked = args.typed or (_SHAPES[args.shape] if args.shape else None)
    if args.dry_run:
        _print_plan(axis, how, args)
        return 0
    present, store = _present(args, axis)
    moves_axis = "" if present is None else present.moves_axis
    with machine_of(args, axis, moves_axis=moves_axis) as machine, terminal_progress() as listener:
        tell_zero(args, machine)
        try:
            measured = run_lost_motion(machine, how, present, listener, seed=args.seed, asked=asked, resume=args.resume)
        except NoLostMotionError as error:
            return _nothing_to_correct(args, axis, str(error))
        if store is not None and measured.result.good:
            store.save(measured.result.compensation)
    stored = str(store.path) if store is not None and measured.result.good else "nothing"
    _print(measured, stored)
    if args.report:
        replace_file(args.report, report_html(axis, measured, stored).encode())
    if args.json:
        write_json(args.json, form(axis, measured, stored=stored != "nothing"))
    return 0 if measured.result.good or measured.result.needless else 1


def _nothing_to_correct(args: argparse.Namespace, axis: AxisConfig, sentence: str) -> int:
    print(sentence)
    if args.json:
        write_json(
            args.json, {"axis": axis.name, "good": True, "needless": True, "stored": False, "verdict": [sentence]}
        )
    return 0


def _present(args: argparse.Namespace, axis: AxisConfig) -> tuple[Compensation | None, SealedStore | None]:
    """The compensation in force, and the store for the new one; every password is asked for before any motion."""
    there = bound_tables(axis) is not None
    if args.only_measure:
        readable = there and (args.password_file or os.environ.get("HIL_PASSWORD") or sys.stdin.isatty())
        return (
            load_stored(open_store(args, axis, writing=False), read_effects(args.effects)) if readable else None
        ), None
    store = open_store(args, axis, writing=True)
    return (load_stored(store, read_effects(args.effects)) if there else None), store


def _print_plan(axis: AxisConfig, how: LostMotionConfig, args: argparse.Namespace) -> None:
    plan = measuring_plan(axis, how, args.seed, store=not args.only_measure)
    homing = "home it, " if plan.homes else ""
    minutes = plan.positions * (plan.at_rest_s + 0.2) / 60.0
    print(f"axis {plan.axis} over {plan.backend}: would enable it, {homing}take the datum at {plan.datum_mm:g} mm")
    print(
        f"would go to and fro between {how.low_mm:g} and {how.high_mm:g} mm {times(how.runs)} at {plan.moves[0].velocity_mm_s:g}"
        f" mm/s, uncorrected, at rest at {how.places} places from {how.finest_um:g} µm on after each turning"
    )
    print(f"would then make {how.proof_moves} moves of all lengths there twice, without the new correction and with it")
    print(f"would capture {plan.positions} positions, {plan.at_rest_s:g} s at rest each, some {minutes:.0f} min in all")
    print(f"would write rows below {axis.store.directory}")
    print(
        "would store nothing"
        if args.only_measure
        else f"would store the correction in {axis.tables_path}, if it proves itself"
    )


def _print(measured: MeasuredLostMotion, stored: str) -> None:
    rows = [
        [
            one.fitted.shape.name,
            number(one.fitted.rise.amount_um),
            number(one.rms_um, 3),
            number(one.held_out_rms_um, 3),
        ]
        for one in measured.result.estimate.contenders
    ]
    print_table(["shape", "amount, µm", "RMS, µm", "RMS on strokes held out, µm"], rows)
    print_facts(facts(measured, stored))
    for sentence in sentences(measured):
        print(sentence)
