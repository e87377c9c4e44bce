"""`hil campaign`: design a campaign that makes effects visible, and list what a measured one cannot show."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.app.terminal.axis_options import seed
from hil.app.terminal.output import add_json_option, print_facts, print_table, write_json
from hil.app.terminal.records_input import add_effects_option, add_records_argument, read_effects, read_records
from hil.axis.axis_file import AxisConfig, load_axis
from hil.diagnosis.loop.next_run import means_of_measurement
from hil.diagnosis.next.check_campaign import CampaignCheck, check_campaign, repeats_of
from hil.diagnosis.next.design import design, plan_minutes
from hil.diagnosis.next.planned_run import Means, Point
from hil.diagnosis.next.plans import to_plan
from hil.effects.user_effects import attributing_errors, check_on

EXAMPLE = """\
example:
  hil campaign design X.toml --minutes 90 --out plan.csv
  hil close-loop X.toml --plan plan.csv
  hil campaign check records.csv --axis X.toml --json check.json

Exit status 1: check found effects that the campaign cannot show.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil campaign` with its jobs."""
    parser = subparsers.add_parser(
        "campaign",
        description="Plan measurements that make effects visible, or list what a measured campaign cannot show.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    plan = jobs.add_parser(
        "design",
        help="write a plan for an axis",
        description="Targets off the grid and off the pitch, in mixed order, with repeats, turns, feeds, warm-up and what can be set.",
        epilog="example:\n  hil campaign design X.toml --minutes 90 --out plan.csv",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    plan.add_argument("axis", metavar="AXIS.toml", help="the axis file")
    plan.add_argument("--out", metavar="PLAN.csv", required=True, help="the plan; `hil close-loop --plan` measures it")
    plan.add_argument("--minutes", type=_minutes, default=120.0, help="limit of the machine time (default 120)")
    plan.add_argument("--seed", type=seed, default=0, help="determines targets and order (default 0)")
    add_json_option(plan)
    plan.set_defaults(run=run_design)
    check = jobs.add_parser(
        "check",
        help="list what a campaign cannot show",
        description="Too few repeats, targets in step with a pitch, effects that a table holds or that look alike, missing columns.",
        epilog="example:\n  hil campaign check records.csv --axis X.toml",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_records_argument(check)
    check.add_argument("--axis", metavar="AXIS.toml", help="the axis file: its pitch is checked, instead of usual ones")
    add_effects_option(check)
    add_json_option(check)
    check.set_defaults(run=run_check)


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
    effects = read_effects(args.effects)
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


def plan_facts(points: tuple[Point, ...], minutes: float) -> dict[str, float | int]:
    """Figures of a plan: runs, rows, repeats, minutes."""
    target_mm, direction = np.array([(point.target_mm, float(point.direction)) for point in points]).reshape(-1, 2).T
    return {
        "runs": len({point.run for point in points}),
        "rows": len(points),
        "repeats": repeats_of(target_mm, direction),
        "minutes": round(minutes, 1),
    }


def print_check(check: CampaignCheck) -> None:
    """Prints the result of a check."""
    print_facts(
        {
            "rows": f"{check.rows} in {check.runs} runs, {check.repeats} of them repeats",
            "can show": ", ".join(check.visible) or "nothing",
        }
    )
    if check.gaps:
        print_table(["gap", ("what these rows cannot show", "left")], [[gap.kind, gap.what] for gap in check.gaps])


def _minutes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1e5:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected minutes, more than 0")
    return value
