"""What verbs that make passes in motion share: feeds, stretch and period, and how the instrument is dated."""

from __future__ import annotations

import argparse

from drivers.errors import InputError
from hil.axis.axis_file import InstrumentConfig
from hil.calibration.in_motion import InMotion
from hil.diagnosis.loop.jobs.plan import feeds_of


def add_in_motion_options(parser: argparse.ArgumentParser) -> None:
    """`--stretch` and `--period`."""
    usual = InMotion(())
    parser.add_argument(
        "--stretch",
        metavar="MM",
        type=float,
        default=usual.stretch_mm,
        help=f"of constant velocity in each pass (default {usual.stretch_mm:g})",
    )
    parser.add_argument(
        "--period",
        metavar="S",
        type=float,
        default=usual.period_s,
        help=f"of the set-points in motion (default {usual.period_s:g})",
    )


def feeds(text: str) -> tuple[float, ...]:
    """At least two feeds, as argparse takes them."""
    try:
        return feeds_of(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(error.what) from error


def passes_of(args: argparse.Namespace, at: tuple[float, ...], instrument: InstrumentConfig) -> InMotion:
    """The passes that a command line asks for, with the instrument's latency and trigger as the axis file has them."""
    return InMotion(
        at,
        stretch_mm=args.stretch,
        period_s=args.period,
        latency_s=instrument.latency_s,
        trigger_input=instrument.trigger_input,
    )
