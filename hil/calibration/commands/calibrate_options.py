"""Options of `hil calibrate`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import (
    Later,
    add_axis_arguments,
    add_limit_option,
    add_password_options,
    add_recording_options,
    add_zero_options,
)

EXAMPLE = """\
example:
  hil calibrate X.toml
  hil calibrate X.toml --dense              a dense pass first: proposes the spacing, the verification at the end proves it
  hil calibrate X.toml --resume             continue after an interruption
  hil calibrate X.toml --manual typed.csv   store tables that were typed or computed elsewhere, without measuring
  hil calibrate X.toml --backlash D.csv     pitch measured now, the backlash by other means: position_mm, backlash_um
  hil calibrate X.toml --backlash D.csv --stored   the same beside the pitch that is stored: nothing moves
  hil calibrate X.toml --withdraw           take this axis's tables, effects and lost motion out of force, with the builder's key
  hil calibrate X.toml --new-zero           start again, with a new zero by the drive's homing
  hil calibrate X.toml --record machine.csv drive and instrument, recorded together
  hil calibrate X.toml --replay machine.csv the same again from the recording: nothing is connected, no table is stored

After the tables are stored, the axis is measured at other targets, between the tables' own: the accuracy A there, with its uncertainty
against the limit, is what the calibration is worth.
Exit status 1: A fails the limit or is undecided; sections stayed outside the band, and are named; or the proof contradicts the
tables, and nothing is stored.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil calibrate`."""
    parser = subparsers.add_parser(
        "calibrate",
        description="Calibrate an axis by system A: measure every section both ways, compute the tables, prove and store them.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--resume", action="store_true", help="continue an interrupted calibration")
    parser.add_argument("--manual", metavar="TABLE.csv", help="store these tables instead of measured ones")
    parser.add_argument(
        "--straightness", metavar="TABLE.csv", help="store a straightness correction too: position_mm, deviation_um"
    )
    parser.add_argument(
        "--backlash",
        metavar="TABLE.csv",
        help="a backlash measured by other means, on its own positions: position_mm, backlash_um",
    )
    parser.add_argument(
        "--stored", action="store_true", help="with --backlash: beside the stored pitch, without measuring"
    )
    parser.add_argument(
        "--withdraw",
        action="store_true",
        help="take what is stored for this axis out of force; other axes in the same file keep theirs",
    )
    parser.add_argument(
        "--dense",
        action="store_true",
        help="first one dense pass: says what accuracy between the targets to expect, and how many sections would do",
    )
    parser.add_argument(
        "--without-proof",
        action="store_true",
        help="do not measure at other targets afterwards; `hil verify` does it later",
    )
    add_limit_option(parser)
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser, anew=True)
    add_recording_options(parser)
    add_password_options(parser, key=True)
    parser.set_defaults(run=Later("hil.calibration.commands.calibrate"), resumes="calibrate")
