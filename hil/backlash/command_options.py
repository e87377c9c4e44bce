"""Options of `hil backlash`."""

from __future__ import annotations

from hil.axis.backlash import FEEDS, METHODS, REVERSALS
from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_axis_arguments,
    add_password_options,
    number_type,
    verb_parser,
    whole_type,
)

_MICROMETRES = number_type("micrometres, 0 to 10000", lambda value: 0.0 <= value <= 10_000.0)

EXAMPLE = """\
example:
  hil backlash X.toml --dry-run                     what would move, how far, and which parameters
  hil backlash X.toml --report backlash.html        measure both reversals; the drive's parameters are as before afterwards
  hil backlash X.toml --runs 5 --write              mean of five, written to the drive's backlash parameter and read back
  hil backlash X.toml --laser 53.2                  also say by which scale an instrument's figure and this one differ
  hil backlash X.toml --write-um 52                 measure nothing; write this amount
  hil backlash X.toml --feed creep                  a very slow feed instead of steps; quicker, less certain
  hil backlash X.toml --restore                     put back what was there before the first --write, or what an interruption left

The [backlash] section of the axis file says where, in which steps, and which parameters (hil/examples/backlash_axis.toml). No position
sensor is needed: the motor's torque shows when the table breaks away. Every reading is kept in the axis's folder, also those of an
interrupted run. For a drive without a backlash parameter --write enters the mean in the axis's sealed tables, beside their pitch, and
needs their passwords. Exit status 1: no break-away within the allowed steps (detection limit exceeded); everything was put back.
"""


def add_parser(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "backlash",
        "Reverse, step until the table breaks away, and read the lost motion from the motor's torque, both ways.",
        EXAMPLE,
    )
    add_axis_arguments(parser)
    parser.add_argument(
        "--runs", type=whole_type(1, 100), help="measurements of both reversals (default: the axis file's)"
    )
    parser.add_argument("--method", choices=METHODS, help="the estimate that is used (default: the axis file's)")
    parser.add_argument(
        "--feed", choices=FEEDS, help="after the reversal: steps, or a very slow creep (default: the axis file's)"
    )
    parser.add_argument(
        "--reversals", choices=list(REVERSALS), help="both, or one direction alone (default: the axis file's)"
    )
    parser.add_argument(
        "--laser",
        type=_MICROMETRES,
        metavar="UM",
        help="lost motion by an instrument at the same place, µm: says the [backlash] scale that makes this measurement agree",
    )
    parser.add_argument(
        "--write-um",
        type=_MICROMETRES,
        metavar="UM",
        help="measure nothing; write this amount, µm, as --write does with the mean",
    )
    parser.add_argument(
        "--write",
        action="store_true",
        help="write the mean to the backlash parameter, and read it back; without one, enter it in the sealed tables",
    )
    parser.add_argument(
        "--restore",
        action="store_true",
        help="measure nothing; restore what an interrupted run left changed, else the values before the first --write",
    )
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_password_options(parser, key=True)
    parser.set_defaults(run=Later("hil.backlash.command"))
