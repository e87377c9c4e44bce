"""Options of `hil close-loop`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import (
    Later,
    add_axis_arguments,
    add_effects_option,
    add_in_motion_options,
    add_limit_option,
    add_password_options,
    add_recording_options,
    add_zero_options,
    feeds,
)

EXAMPLE = """\
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


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil close-loop`."""
    parser = subparsers.add_parser(
        "close-loop",
        description="Trace the residual error of a calibration to an effect, add that effect, and prove it on the machine.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
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
    _add_in_motion(parser)
    add_zero_options(parser)
    add_recording_options(parser)
    add_effects_option(parser)
    add_password_options(parser, key=True)
    parser.set_defaults(run=Later("hil.diagnosis.loop.command"), resumes="close-loop")


def _add_in_motion(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--feeds", metavar="MM_S", type=feeds, help="then passes at these feeds, e.g. 20,60,110 (mm/s)")
    add_in_motion_options(parser)
