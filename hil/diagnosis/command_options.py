"""Options of `hil diagnose`, `hil fit`, `hil apply`, `hil campaign` and `hil close-loop`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_axis_arguments,
    add_effects_option,
    add_in_motion_options,
    add_json_option,
    add_limit_option,
    add_password_options,
    add_recording_options,
    add_records_argument,
    add_zero_options,
    feeds,
    number_type,
    seed,
    verb_parser,
)

# -- hil diagnose ------------------------------------------------------------------------------------------------------
DIAGNOSE_EXAMPLE = """\
example:
  hil diagnose records.csv --json diagnosis.json --out extended.json
  hil diagnose check.csv --model model.json --json diagnosis.json --out extended.json
  hil diagnose records.csv --effects coolant_level.py
  hil diagnose records.csv --out extended.json --non-parametric     corrects the unexplained part too

Without --model the declared model (a table per direction) is fitted from the records themselves. Exit 0: the residual is
explained or within the noise; 1: structure remains that no effect of the catalogue explains.
"""


def add_diagnose(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "diagnose",
        "Find the effect that the declared model lacks, name what it could be confused with, and extend the model.",
        DIAGNOSE_EXAMPLE,
    )
    add_records_argument(parser)
    parser.add_argument(
        "--model", metavar="MODEL", help="the declared model (`hil fit`); default: fitted from the records"
    )
    parser.add_argument("--out", metavar="EXTENDED", help="write the extended model; `hil apply` uses it")
    parser.add_argument(
        "--axis", metavar="AXIS.toml", help="the axis file: its pitch is used in planning the next measurement"
    )
    parser.add_argument(
        "--non-parametric",
        action="store_true",
        help="where something is unexplained: put a smooth function of the columns that carry it into the extended model, though its"
        " cause is unknown; refused where it does not help on runs left out, or a column is not known when a command is issued",
    )
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.diagnosis.commands.diagnose"))


# -- hil fit -----------------------------------------------------------------------------------------------------------
FIT_EXAMPLE = """\
example:
  hil fit records.csv --out model.json
  hil fit records.csv --runs 1-3 --out model.json
  hil fit records.csv --with velocity_lag --out model.json
  hil fit records.csv --with coolant_level --effects coolant_level.py --out model.json

The model is a table of the error per direction of arrival, smoothed as far as the repeats allow, and the effects named by --with.
`hil apply` uses it; `hil diagnose` determines which effects there are.
"""


def add_fit(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "fit",
        "Fit the bidirectional error table of an axis to measurement records.",
        FIT_EXAMPLE,
    )
    add_records_argument(parser)
    parser.add_argument("--out", metavar="MODEL", required=True, help="the model file to write")
    parser.add_argument(
        "--with",
        dest="wanted",
        metavar="EFFECT",
        action="append",
        default=[],
        help="id of an effect to be fitted beside the table; may be repeated",
    )
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.diagnosis.commands.model", "run_fit"))


# -- hil apply ---------------------------------------------------------------------------------------------------------
APPLY_EXAMPLE = """\
example:
  hil apply --model model.json records.csv --out corrected.csv

OUT.csv holds the rows with two columns more: correction_um, what the model adds to the command of that row from what is
known when the row is commanded; residual_um, the error of the uncorrected machine (measured - command) plus that correction.
"""


def add_apply(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "apply",
        "Apply a model of `hil fit` or `hil diagnose` to records.",
        APPLY_EXAMPLE,
    )
    parser.add_argument(
        "--model", metavar="MODEL", required=True, help="model file of `hil fit` or `hil diagnose --out`"
    )
    add_records_argument(parser)
    parser.add_argument("--out", metavar="OUT.csv", required=True, help="the records with two columns added")
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.diagnosis.commands.model", "run_apply"))


# -- hil campaign ------------------------------------------------------------------------------------------------------
CAMPAIGN_EXAMPLE = """\
example:
  hil campaign design X.toml --minutes 90 --out plan.csv
  hil close-loop X.toml --plan plan.csv
  hil campaign check records.csv --axis X.toml --json check.json

Exit status 1: check found effects that the campaign cannot show.
"""


def add_campaign(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "campaign",
        "Plan measurements that make effects visible, or list what a measured campaign cannot show.",
        CAMPAIGN_EXAMPLE,
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
    plan.add_argument(
        "--minutes",
        type=number_type("minutes, more than 0", lambda value: 0.0 < value <= 1e5),
        default=120.0,
        help="limit of the machine time (default 120)",
    )
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


# -- hil close-loop ----------------------------------------------------------------------------------------------------
CLOSE_LOOP_EXAMPLE = """\
example:
  hil close-loop X.toml --report loop.html
  hil close-loop X.toml --resume
  hil close-loop X.toml --plan plan.csv --person none
  hil close-loop X.toml --record machine.csv      drive and instrument, recorded together; --replay plays them again
  hil close-loop X.toml --feeds 20,60,110 --stretch 60

Where two causes fit the residual, the measurement that separates them best for its time is made next: automatically
where the axis can, after asking where a person has to help. With --feeds, a second turn is made in motion, for effects that cannot
be seen at rest; the drive must take set-points in its cycle. Where the axis file does not state the instrument's latency
(latency_s), it is measured before. Exit status 1: structure remains that no effect of the
catalogue explains, a measurement waits for a person, the axis did not improve, or the accuracy A at other targets, measured last,
fails its limit or is undecided.
"""


def add_close_loop(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "close-loop",
        "Trace the residual error of a calibration to an effect, add that effect, and prove it on the machine.",
        CLOSE_LOOP_EXAMPLE,
    )
    add_axis_arguments(parser)
    parser.add_argument("--resume", action="store_true", help="continue an interrupted loop")
    parser.add_argument("--runs", type=int, default=8, help="runs of each exploring campaign (default 8)")
    parser.add_argument("--rows", type=int, default=42, help="positions of each run (default 42)")
    parser.add_argument(
        "--warm-up", metavar="S", type=float, default=240.0, help="mean seconds of strokes, or rest, between runs"
    )
    parser.add_argument(
        "--without-proof",
        action="store_true",
        help="do not measure A of ISO 230-2 afterwards; `hil verify` does it later",
    )
    add_limit_option(parser)
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    parser.add_argument(
        "--plan", metavar="PLAN.csv", help="explore by this plan (`hil campaign design`) instead of --runs and --rows"
    )
    parser.add_argument(
        "--person",
        choices=("ask", "none"),
        help="whether to ask a person at the machine for measurements that need one; default: ask on a terminal",
    )
    parser.add_argument("--feeds", metavar="MM_S", type=feeds, help="then passes at these feeds, e.g. 20,60,110 (mm/s)")
    add_in_motion_options(parser)
    add_zero_options(parser)
    add_recording_options(parser)
    add_effects_option(parser)
    add_password_options(parser, key=True)
    parser.set_defaults(run=Later("hil.diagnosis.loop.command"), resumes="close-loop")
