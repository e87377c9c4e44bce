"""Options of `hil lost-motion` and `hil circle`."""

from __future__ import annotations

import argparse
import math

from drivers.errors import InputError
from hil.correction import RISE_SHAPES
from hil.correction.published_rise import TwoTanh
from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_axis_arguments,
    add_effects_option,
    add_json_option,
    add_password_options,
    add_zero_options,
    number_type,
    positive,
    seed,
    verb_parser,
)

# -- hil lost-motion ---------------------------------------------------------------------------------------------------
LOST_MOTION_EXAMPLE = """\
example:
  hil lost-motion X.toml --dry-run                   what would move, how far, and how long it takes
  hil lost-motion X.toml --report lost-motion.html   measure, fit, prove, and store it beside the axis's tables
  hil lost-motion X.toml --shape two-tanh            with the published two terms, whichever shape fits best
  hil lost-motion X.toml --typed 4,3,0.02,0.4,0.1    the published terms as typed: Pc1, Pc2 µm, a1, a2, b2 mm of the load's travel
  hil lost-motion X.toml --only-measure              store nothing; needs no key
  hil circle X.toml Y.toml --report circle.html      the circle test with it

The [lost_motion] section of the axis file says where and how far: at_mm, stroke_mm, places, finest_um, runs, proof_moves,
shortest_rise_um. Calibrate first: the tables hold the correction of each direction, the rise is the transition from one to the
other after a reversal. Without tables the axis gets the lost motion alone. A new calibration replaces it.
Stored is what leaves less than before in fresh moves of all lengths, by more than the uncertainty of the difference (k = 2).
Exit status 0 also where nothing was to be corrected; 1: the proof failed, or the strokes were too short; nothing was stored.
"""


SHAPES = {name.replace(" ", "-"): name for name in RISE_SHAPES}
"""As it is typed -> name."""


def add_lost_motion(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "lost-motion",
        "Measure how the table lags after reversals, fit its rise, put it into force, and prove it by fresh moves.",
        LOST_MOTION_EXAMPLE,
    )
    add_axis_arguments(parser)
    parser.add_argument("--only-measure", action="store_true", help="measure, fit and prove, but store nothing")
    parser.add_argument(
        "--shape",
        choices=list(SHAPES),
        help="of the rise (default: two tanh, unless another leaves less, by more than the noise, and in the proof too)",
    )
    parser.add_argument(
        "--typed",
        type=_numbers,
        metavar="PC1,PC2,A1,A2,B2",
        help="two tanh terms with these amounts (µm), rises and onset (mm) in place of fitted ones; strokes and proof as always",
    )
    parser.add_argument("--resume", action="store_true", help="continue an interrupted measurement")
    parser.add_argument("--seed", type=seed, default=1, help="chooses the moves of the proof (default 1)")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser)
    add_password_options(parser, key=True)
    add_effects_option(parser)
    parser.set_defaults(run=Later("hil.lost_motion.command"), resumes="lost-motion")


def _numbers(text: str) -> TwoTanh:
    try:
        amount_1, amount_2, rise_1, rise_2, onset_2 = (float(value) for value in text.split(","))
        return TwoTanh(amount_1, amount_2, rise_1, rise_2, onset_2)
    except (ValueError, InputError) as error:
        raise argparse.ArgumentTypeError(
            f"'{text}': expected Pc1,Pc2,a1,a2,b2 as five numbers, amounts ≥ 0 in µm, a1 and a2 > 0 and b2 ≥ 0 in mm ({error})"
        ) from error


# -- hil circle --------------------------------------------------------------------------------------------------------
CIRCLE_EXAMPLE = """\
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


def add_circle(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "circle",
        "Drive a circle with two axes, uncorrected and corrected, and read the bumps after the quadrants.",
        CIRCLE_EXAMPLE,
    )
    parser.add_argument("x", metavar="X.toml", help="the axis file of the first axis")
    parser.add_argument("y", metavar="Y.toml", help="the axis file of the second axis")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    add_json_option(parser)
    parser.add_argument(
        "--centre",
        metavar="MM",
        nargs=2,
        type=number_type("a number", math.isfinite),
        help="of both axes (default: the middles of their targets)",
    )
    parser.add_argument("--radius", metavar="MM", type=positive, default=10.0, help="default 10")
    parser.add_argument("--feed", metavar="MM/MIN", type=positive, default=100.0, help="default 100")
    parser.add_argument("--clockwise", action="store_true", help="instead of counter-clockwise")
    parser.add_argument("--period-ms", metavar="MS", type=positive, default=4.0, help="of the set-points (default 4)")
    parser.add_argument("--uncorrected", action="store_true", help="only the uncorrected circle; needs no password")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser)
    add_password_options(parser, key=False)
    add_effects_option(parser)
    parser.set_defaults(run=Later("hil.lost_motion.circle.command"))
