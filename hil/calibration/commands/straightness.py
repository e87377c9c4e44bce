"""`hil straightness`: measure how far an axis leaves its line, and move the axis at right angles against it."""

from __future__ import annotations

import argparse

from hil.axis.axis_file import load_axis
from hil.calibration.job import run_straightness, straightness_plan
from hil.effects.user_effects import catalogue_with
from hil.machine.axes_wiring import connected_across
from hil.ui.terminal.axis_options import load_cross, load_stored, open_store, print_plan, tell_zero
from hil.ui.terminal.output import number, print_facts, print_table, write_json
from hil.ui.terminal.progress import terminal_progress


def run(args: argparse.Namespace) -> int:
    """Returns 0: measured, proven and stored. Raises what connecting and `measure_straightness` raise."""
    axis = load_axis(args.axis)
    config = axis.across()
    if args.dry_run:
        print_plan(axis, straightness_plan(axis, args.seed))
        print(f"would enable the axis of {config.axis_file.name}, home it where its file says so, and move it")
        print(f"to {config.at_mm:g} mm and, with the correction, by micrometres from there")
        return 0
    store, own = open_store(args, axis, writing=True), load_cross(args, axis)
    present = load_stored(store, catalogue_with(args.effects)) if store.states() is not None else None
    with connected_across(axis) as machine, terminal_progress() as listener:
        tell_zero(args, machine)
        result = run_straightness(machine, store, present, own, listener, seed=args.seed, resume=args.resume)
    stages = {"measured": result.measured, "other targets, before": result.before, "other targets, after": result.after}
    heads = ["straightness, µm (± k = 2)", "range", "±", "rms", "±", "reversal"]
    print_table(heads, [[name, *(number(value) for value in _row(one.figures()))] for name, one in stages.items()])
    print_facts({"axis moved": result.compensation.moves_axis, "stored": str(store.path)})
    if args.json:
        form = {name: one.figures() for name, one in zip(("measured", "before", "after"), stages.values(), strict=True)}
        moved = {"moves_axis": result.compensation.moves_axis, "tables": result.compensation.tables.to_dict()}
        write_json(args.json, {"axis": axis.name, **form, **moved})
    return 0


def _row(figures: dict[str, float | None]) -> list[float | None]:
    return [figures[name] for name in ("range_um", "range_expanded_um", "rms_um", "rms_expanded_um", "reversal_um")]
