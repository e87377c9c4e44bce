"""Options of `hil calibrate`, `hil verify` and `hil straightness`."""

from __future__ import annotations

from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_axis_arguments,
    add_effects_option,
    add_limit_option,
    add_password_options,
    add_recording_options,
    add_zero_options,
    seed,
    verb_parser,
)

# -- hil calibrate -----------------------------------------------------------------------------------------------------
CALIBRATE_EXAMPLE = """\
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


def add_calibrate(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "calibrate",
        "Calibrate an axis by system A: measure every section both ways, compute the tables, prove and store them.",
        CALIBRATE_EXAMPLE,
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


# -- hil verify --------------------------------------------------------------------------------------------------------
VERIFY_EXAMPLE = """\
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


def add_verify(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "verify",
        "Prove a calibration: measure with the stored correction in force, at targets between its own.",
        VERIFY_EXAMPLE,
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


# -- hil straightness --------------------------------------------------------------------------------------------------
STRAIGHTNESS_EXAMPLE = """\
example:
  hil straightness X.toml --dry-run     what would move, and how far
  hil straightness X.toml               measure, prove at other targets, store beside the tables of X
  hil verify X.toml                     later: X with its corrections, Y moved for its straightness

The axis file of X names the other axis ([straightness] axis_file, at_mm, sign) and the optics ([instrument] beside). The other axis is
connected too, homed where its own file says so, and stopped with X; its own stored tables are in force. From then on it is moved with
every move and every set-point of X. Calibrate both axes first: a calibration of X replaces this correction.
Exit status 1: the correction leaves no less than before by more than the uncertainty; nothing is stored.
"""


def add_straightness(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "straightness",
        "Measure the straightness of an axis by its instrument, and correct it by the axis at right angles.",
        STRAIGHTNESS_EXAMPLE,
    )
    add_axis_arguments(parser)
    parser.add_argument("--seed", type=seed, default=1, help="chooses the other targets of the proof (default 1)")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted measurement")
    add_zero_options(parser)
    add_password_options(parser, key=True)
    add_effects_option(parser)
    parser.set_defaults(run=Later("hil.calibration.commands.straightness"), resumes="straightness")
