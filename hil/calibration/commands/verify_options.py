"""Options of `hil verify`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import (
    Later,
    add_axis_arguments,
    add_effects_option,
    add_limit_option,
    add_password_options,
    add_recording_options,
    add_zero_options,
    seed,
)

EXAMPLE = """\
example:
  hil verify X.toml
  hil verify X.toml --report verified.html --seed 3
  hil verify X.toml --record machine.csv          drive and instrument, recorded together
  hil verify X.toml --replay machine.csv          the same again from the recording: nothing is connected

  hil verify X.toml --limit 8                     A against 8 µm, in place of the axis file's accuracy_limit_um

The verdict: the accuracy A of ISO 230-2 at these targets with its uncertainty U (k = 2) against the limit, by ISO 14253-1.
The bench (backend "bench") starts anew with each command: cold, and with its own parameters.
Exit status 1: A fails the limit or is undecided; or sections lie outside the band of the axis file, and are named.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil verify`."""
    parser = subparsers.add_parser(
        "verify",
        description="Prove a calibration: measure with the stored correction in force, at targets between its own.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--seed", type=seed, default=1, help="chooses the other targets (default 1)")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted verification")
    add_limit_option(parser)
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser)
    add_recording_options(parser)
    add_password_options(parser, key=False)
    add_effects_option(parser)
    parser.set_defaults(run=Later("hil.calibration.commands.verify"), resumes="verify")
