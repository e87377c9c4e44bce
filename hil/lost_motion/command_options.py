"""Options of `hil lost-motion`."""

from __future__ import annotations

import argparse

from drivers.errors import InputError
from hil.correction import RISE_SHAPES
from hil.correction.published_rise import TwoTanh
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


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil lost-motion`."""
    parser = subparsers.add_parser(
        "lost-motion",
        description="Measure how the table lags after reversals, fit its rise, put it into force, and prove it by fresh moves.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
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
