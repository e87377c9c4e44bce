"""Options of `hil campaign`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_effects_option, add_json_option, add_records_argument, seed

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
    plan.set_defaults(run=Later("hil.diagnosis.commands.campaign", "run_design"))
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
    check.set_defaults(run=Later("hil.diagnosis.commands.campaign", "run_check"))


def _minutes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1e5:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected minutes, more than 0")
    return value
