"""Options of `hil circle`."""

from __future__ import annotations

import argparse
import math

from hil.ui.terminal.options import Later, add_effects_option, add_json_option, add_password_options, add_zero_options

EXAMPLE = """\
example:
  hil circle X.toml Y.toml --dry-run                   what would move, and how far
  hil circle X.toml Y.toml --report circle.html        10 mm at 100 mm/min: uncorrected, by tables, with the lost motion
  hil circle X.toml Y.toml --centre 120 80 --clockwise
  hil iso230-4 ccw.json cw.json                        bi-directional figures of ISO 230-4, from --json of both senses

Driven are three circles where `hil lost-motion` has stored a rise: uncorrected, with the tables alone, and with tables and
lost motion ("corrected" in JSON); two where only tables are stored. Both drives take set-points together: on one CAN bus by
one SYNC, otherwise by this computer's clock. Both instruments measure. An axis
without stored tables drives uncorrected. `hil lost-motion` makes the correction that this test shows. Readings are dated by the
latency_s of each axis file; instruments of different latency show an ellipse unless it is stated there.
Exit status 1: with the correction in force the bumps fell neither to half nor to the floor.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil circle`."""
    parser = subparsers.add_parser(
        "circle",
        description="Drive a circle with two axes, uncorrected and corrected, and read the bumps after the quadrants.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("x", metavar="X.toml", help="the axis file of the first axis")
    parser.add_argument("y", metavar="Y.toml", help="the axis file of the second axis")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    add_json_option(parser)
    parser.add_argument(
        "--centre", metavar="MM", nargs=2, type=_finite, help="of both axes (default: the middles of their targets)"
    )
    parser.add_argument("--radius", metavar="MM", type=_positive, default=10.0, help="default 10")
    parser.add_argument("--feed", metavar="MM/MIN", type=_positive, default=100.0, help="default 100")
    parser.add_argument("--clockwise", action="store_true", help="instead of counter-clockwise")
    parser.add_argument("--period-ms", metavar="MS", type=_positive, default=4.0, help="of the set-points (default 4)")
    parser.add_argument("--uncorrected", action="store_true", help="only the uncorrected circle; needs no password")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser)
    add_password_options(parser, key=False)
    add_effects_option(parser)
    parser.set_defaults(run=Later("hil.lost_motion.circle.command"))


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a number")
    return value


def _positive(text: str) -> float:
    value = _finite(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a number > 0")
    return value
