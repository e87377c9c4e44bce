"""Options of `hil straightness`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import (
    Later,
    add_axis_arguments,
    add_effects_option,
    add_password_options,
    add_zero_options,
    seed,
)

EXAMPLE = """\
example:
  hil straightness X.toml --dry-run     what would move, and how far
  hil straightness X.toml               measure, prove at other targets, store beside the tables of X
  hil verify X.toml                     later: X with its corrections, Y moved for its straightness

The axis file of X names the other axis ([straightness] axis_file, at_mm, sign) and the optics ([instrument] beside). The other axis is
connected too, homed where its own file says so, and stopped with X; its own stored tables are in force. From then on it is moved with
every move and every set-point of X. Calibrate both axes first: a calibration of X replaces this correction.
Exit status 1: the correction leaves no less than before by more than the uncertainty; nothing is stored.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil straightness`."""
    parser = subparsers.add_parser(
        "straightness",
        description="Measure the straightness of an axis by its instrument, and correct it by the axis at right angles.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--seed", type=seed, default=1, help="chooses the other targets of the proof (default 1)")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted measurement")
    add_zero_options(parser)
    add_password_options(parser, key=True)
    add_effects_option(parser)
    parser.set_defaults(run=Later("hil.calibration.commands.straightness"), resumes="straightness")
