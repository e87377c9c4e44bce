"""`hil campaign`: design a campaign that makes effects visible, and list what a measured one cannot show."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, load_axis
from hil.diagnosis.loop.next_run import means_of_measurement
from hil.diagnosis.next.check_campaign import CampaignCheck, check_campaign, repeats_of
from hil.diagnosis.next.design import design, plan_minutes
from hil.diagnosis.next.planned_run import Means, PlannedPoint
from hil.diagnosis.next.plans import to_plan
from hil.effects.user_effects import attributing_errors, catalogue_with, check_on
from hil.ui.terminal.output import print_facts, print_table, write_json
from hil.ui.terminal.records_input import read_records


def run_design(args: argparse.Namespace) -> int:
    """Writes the plan. Returns 0. Raises InputError for a bad axis file or too few minutes."""
    axis = load_axis(args.axis)
    means = means_of_axis(axis)
    points = design(means, args.minutes, args.seed)
    minutes = plan_minutes(points, means)
    facts = plan_facts(points, minutes)
    replace_file(args.out, to_plan(points, f"campaign for axis {axis.name}, about {minutes:.0f} min").encode())
    if args.json:
        write_json(args.json, {"axis": axis.name, "plan": args.out, **facts})
    print_facts({name.replace("_", " "): str(value) for name, value in facts.items()} | {"plan": args.out})
    return 0


def run_check(args: argparse.Namespace) -> int:
    """Prints the gaps. Returns 0: none; 1: some. Raises InputError for bad records."""
    effects = catalogue_with(args.effects)
    pitches = (load_axis(args.axis).scaling.feed_mm_per_shaft_rev,) if args.axis else ()
    with attributing_errors(effects):
        try:
            records = read_records(args.records, args.runs)
            check_on(effects, records.columns)
            check = check_campaign(records, pitches, effects)
        except InputError as error:
            raise error if error.path is not None else InputError(error.what, path=args.records[0]) from error
    if args.json:
        write_json(args.json, check.to_json())
    print_check(check)
    return 1 if check.gaps else 0


def means_of_axis(axis: AxisConfig) -> Means:
    """The measuring abilities of an axis by its axis file."""
    bench = axis.drive.backend == "bench"
    return replace(
        means_of_measurement(axis.measurement),
        levels=axis.conditions.levels,
        by_itself=frozenset(axis.conditions.levels) if bench else frozenset(),
        pitches_mm=(axis.scaling.feed_mm_per_shaft_rev,),
    )


def plan_facts(points: tuple[PlannedPoint, ...], minutes: float) -> dict[str, float | int]:
    """Figures of a plan: runs, rows, repeats, minutes."""
    target_mm, direction = np.array([(point.target_mm, float(point.direction)) for point in points]).reshape(-1, 2).T
    return {
        "runs": len({point.run for point in points}),
        "rows": len(points),
        "repeats": repeats_of(target_mm, direction),
        "minutes": round(minutes, 1),
    }


def print_check(check: CampaignCheck) -> None:
    print_facts(
        {
            "rows": f"{check.rows} in {check.runs} runs, {check.repeats} of them repeats",
            "can show": ", ".join(check.visible) or "nothing",
        }
    )
    if check.gaps:
        print_table(["gap", ("what these rows cannot show", "left")], [[gap.kind, gap.what] for gap in check.gaps])
