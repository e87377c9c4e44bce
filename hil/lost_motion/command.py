"""`hil lost-motion`: lost motion after a reversal (system C), measured by the axis's instrument and put into force."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.axis.lost_motion import LostMotionConfig
from hil.correction.compensation import Compensation
from hil.correction.rise import RUNNABLE, Rise, RiseShape, rise_of
from hil.correction.store import SealedStore, bound_tables
from hil.effects.user_effects import catalogue_with
from hil.lost_motion.command_options import SHAPES
from hil.lost_motion.job import lost_motion_config, measuring_plan, run_lost_motion
from hil.lost_motion.measured import ReversalResult
from hil.lost_motion.procedure import NoLostMotionError
from hil.ui.terminal.axis_options import load_stored, open_store, tell_zero
from hil.ui.terminal.measuring_options import machine_of
from hil.ui.terminal.output import finish, number, print_facts, print_table, times, write_json
from hil.ui.terminal.progress import terminal_progress


def run(args: argparse.Namespace) -> int:
    """Returns 0: measured, proven and stored, or nothing to improve; 1: not proven. Raises what `measure_lost_motion` raises."""
    axis = load_axis(args.axis)
    how = lost_motion_config(axis)
    if args.shape and args.typed:
        raise InputError("--shape and --typed exclude one another: typed values are of two tanh terms")
    asked: Rise | RiseShape | None = None if args.typed is None else rise_of(args.typed)
    if args.shape:
        asked = next(shape for shape in RUNNABLE if shape.name == SHAPES[args.shape])
    if args.dry_run:
        _print_plan(axis, how, args)
        return 0
    present, store = _present(args, axis)
    moves_axis = "" if present is None else present.moves_axis
    with machine_of(args, axis, moves_axis=moves_axis) as machine, terminal_progress() as listener:
        tell_zero(args, machine)
        try:
            found = run_lost_motion(machine, how, present, listener, seed=args.seed, asked=asked, resume=args.resume)
        except NoLostMotionError as error:
            return _nothing_to_correct(args, axis, str(error))
        if store is not None and found.raw.good:
            store.save(found.raw.compensation)
            found = replace(found, stored=True)
    _print(found)
    return finish(args, found)


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
            load_stored(open_store(args, axis, writing=False), catalogue_with(args.effects)) if readable else None
        ), None
    store = open_store(args, axis, writing=True)
    return (load_stored(store, catalogue_with(args.effects)) if there else None), store


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


def _print(found: ReversalResult) -> None:
    rows = [
        [
            one.fitted.shape.name,
            number(one.fitted.rise.amount_um),
            number(one.rms_um, 3),
            number(one.held_out_rms_um, 3),
        ]
        for one in found.raw.estimate.contenders
    ]
    print_table(["shape", "amount, µm", "RMS, µm", "RMS on strokes held out, µm"], rows)
    print_facts(found.facts())
    for sentence in found.verdict:
        print(sentence)
