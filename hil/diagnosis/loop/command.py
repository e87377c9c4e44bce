"""`hil close-loop`: calibrate, explore, diagnose, add the missing effect, measure again."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, accuracy_of, load_axis
from hil.calibration.explore import Exploration, ExploringRun
from hil.calibration.job import Verification, run_proof
from hil.desk.plan import PlannedWrite, measuring_plan
from hil.diagnosis import Diagnosis
from hil.diagnosis.loop.job import loop_is_good, loop_stages, run_loop
from hil.diagnosis.loop.jobs.stored import LABELS_EXPLAINED, STAGE_LABELS
from hil.diagnosis.loop.next_run import runs_of
from hil.diagnosis.loop.procedure import MOST_RUNS, Consent, Loop, Turn, Turning
from hil.diagnosis.next.planned_run import PlannedRun
from hil.diagnosis.next.plans import read_plan
from hil.effects.user_effects import attributing_errors, catalogue_with
from hil.figures.verdict import FITTED_PLUS_MINUS, Accuracy
from hil.machine.conditions import AskedConditions, Conditions
from hil.machine.measure import bidirectional_steps
from hil.ui.terminal.axis_options import open_store, print_plan, tell_zero
from hil.ui.terminal.measuring_options import limited, machine_of, passes_of, recording_name
from hil.ui.terminal.output import write_json
from hil.ui.terminal.progress import terminal_progress
from hil.ui.terminal.summary import print_accuracy, print_stages


def run(args: argparse.Namespace) -> int:
    """Returns 0: the residual is within the noise or explained; 1: not. Raises what `run_loop` raises."""
    axis = limited(load_axis(args.axis), args.limit)
    effects = catalogue_with(args.effects)
    plan = runs_of(read_plan(args.plan, axis.limits)) if args.plan else None
    if args.dry_run:
        return _dry_run(args, axis, plan)
    if args.feeds and (args.record or args.replay):
        raise InputError(
            "--feeds does not go with --record or --replay: a recorded drive takes no set-points in its cycle"
        )
    store = None if args.replay else open_store(args, axis, writing=True)
    how = Exploration(args.runs, args.rows, args.warm_up)
    in_motion = passes_of(args, args.feeds, axis.instrument) if args.feeds else None
    turning = Turning(how, plan, _consent(args.person), effects=effects, in_motion=in_motion)
    with (
        attributing_errors(effects),
        machine_of(args, axis, _asked(axis)) as machine,
        terminal_progress() as listener,
    ):
        tell_zero(args, machine)
        proofs: list[Verification] = []

        def prove() -> None:
            if store is not None and not (args.record or args.without_proof):
                proofs.append(run_proof(machine, listener, resume=args.resume))

        recording = recording_name(args)
        loop = run_loop(machine, store, turning, listener, resume=args.resume, recording=recording, then=prove)
        proof = proofs[0] if proofs else None
    found = None if proof is None else accuracy_of(axis, proof.records, corrected=True)
    if store is None:
        print("nothing is stored: this was a recording")
    _print_loop(args, loop, found)
    if args.report:
        from hil.diagnosis.loop.report import loop_report  # noqa: PLC0415  (plots are slow to import)

        replace_file(args.report, loop_report(axis, loop, proof=proof).encode())
    good = loop_is_good(loop) and (found is None or found.good)
    if args.json:
        write_json(
            args.json,
            {
                "axis": axis.name,
                "accuracy": None if found is None else found.as_json(),
                "stages": loop_stages(loop),
                "diagnosis": loop.turn.follow.to_json(),
                "further": [run.describe() for run in loop.turn.further],
                "withdrawn": [turn is not None and turn.withdrawn for turn in (loop.turn, loop.in_motion)],
                "in_motion": None if loop.in_motion is None else loop.in_motion.diagnosis.to_json(),
                "latency": _measured_latency(loop),
                "good": good,
            },
        )
    return 0 if good else 1


def _dry_run(args: argparse.Namespace, axis: AxisConfig, plan: list[ExploringRun] | None) -> int:
    steps = bidirectional_steps(axis.measurement.targets_mm, axis.measurement.runs)
    writes = [PlannedWrite("", f"rows below {axis.store.directory}"), PlannedWrite("tables", str(axis.tables_path))]
    print_plan(axis, measuring_plan(axis, steps, writes))
    rows = (
        f"the {sum(len(part.steps) for part in plan)} rows of {args.plan}"
        if plan
        else (f"{args.runs} runs of {args.rows} positions anywhere between, with strokes or rest before each")
    )
    late = "" if axis.instrument.latency_s is not None else "passes for the instrument's latency, then "
    passes = f"; then {late}twice passes at {', '.join(f'{feed:g}' for feed in args.feeds)} mm/s" if args.feeds else ""
    print(
        f"then twice {rows}, and up to {MOST_RUNS} measurements more where causes are left that they tell apart{passes}"
    )
    return 0


def _print_loop(args: argparse.Namespace, loop: Loop, found: Accuracy | None) -> None:
    stages = loop_stages(loop)
    if found is not None:
        print_accuracy(found)
    else:
        print(f"verified: not yet (hil verify {args.axis})")
    print_stages({STAGE_LABELS[name]: figures for name, figures in stages.items()})
    print(LABELS_EXPLAINED)
    print_findings(loop.turn.diagnosis)
    print_runs(loop.turn)
    if loop.in_motion is not None:
        print("in motion:")
        if loop.in_motion.latency is not None:
            print(loop.in_motion.latency.describe())
        print_findings(loop.in_motion.diagnosis)


def _measured_latency(loop: Loop) -> dict[str, Any] | None:
    turn = loop.in_motion
    return None if turn is None or turn.latency is None else turn.latency.to_json()


def _asked(axis: AxisConfig) -> Conditions | None:
    """Conditions (loads and the like) that are set by the person at the terminal."""
    levels = axis.conditions.levels
    if axis.drive.backend == "bench":
        return None
    if not sys.stdin.isatty():
        if not levels:
            return None
        raise InputError("[conditions] are asked for on a terminal, and there is none", path=axis.path)

    def ask(name: str, value: float) -> None:
        input(
            f"the axis is without power; please make {name} = {value:g}, then press Enter: it is enabled again and moves "
        )

    return AskedConditions(levels, ask)


def _consent(person: str | None) -> Consent | None:
    """Asks on the terminal whether to make a run that needs a person; None without a person."""
    if person == "none" or (person is None and not sys.stdin.isatty()):
        return None

    def ask(run: PlannedRun) -> bool:
        print(f"next measurement: {run.describe()}", file=sys.stderr)
        try:
            return input("make it now? [y/N] ").strip().lower() in ("y", "yes")
        except EOFError:
            return False

    return ask


def print_runs(turn: Turn) -> None:
    """Prints whether the correction stayed in force, the further measurements of the loop, the undecided rivals, and what would
    decide between them.
    """
    if turn.withdrawn:
        print("the extended correction is withdrawn, since the axis measured worse with it: the one before is in force")
    for run in turn.further:
        print(f"measured to tell causes apart: {run.describe()}")
    follow = turn.follow
    for finding in follow.diagnosis.findings:
        if finding.effect in follow.undecided:
            for rival in finding.rivals:
                print(f"{finding.effect} or {rival.effect} ({rival.confidence:.2f})? {rival.separate_by}")
    if follow.run is not None:
        print(f"next measurement, not made: {follow.run.describe()}")


def print_findings(diagnosis: Diagnosis) -> None:
    for finding in diagnosis.findings:
        verdict = f"confidence {finding.confidence:.2f}, {finding.action.value}"
        print(f"found: {finding.effect} ({verdict}). {finding.explanation}")
    if any("±" in finding.explanation for finding in diagnosis.findings):
        print(f"  {FITTED_PLUS_MINUS}")
    if not diagnosis.findings:
        print("found: nothing that the data support")
    if diagnosis.unexplained:
        print(f"unexplained: {diagnosis.unexplained_sentence}")
