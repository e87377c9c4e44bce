"""What every verb that works on an axis shares: its arguments, its sealed store, its dry run."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from drivers.errors import InputError
from hil.app.jobs.of_zero import OfZero
from hil.app.jobs.plan import Plan, Write, measuring_plan
from hil.app.terminal.output import add_json_option
from hil.app.terminal.passwords import KEY, READING, password
from hil.axis.axis_file import AxisConfig, InstrumentConfig
from hil.calibration.in_motion import InMotion
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore
from hil.diagnosis.loop.jobs.plan import feeds_of
from hil.effects import ALL, Effect
from hil.machine.conditions import Conditions
from hil.machine.measure import Step
from hil.machine.replay import recorded, replayed
from hil.machine.wiring import Machine, connected


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """`--record` and `--replay`."""
    recording = parser.add_mutually_exclusive_group()
    recording.add_argument("--record", metavar="FILE.csv", help="record drive and instrument to a new file")
    recording.add_argument("--replay", metavar="FILE.csv", help="play such a recording instead of connecting anything")


def recording_name(args: argparse.Namespace) -> str:
    """File name of what is replayed; empty where nothing is."""
    return Path(args.replay).name if args.replay else ""


@contextmanager
def machine_of(args: argparse.Namespace, axis: AxisConfig, conditions: Conditions | None = None) -> Iterator[Machine]:
    """The connected axis, recorded where that is asked for, or the axis of a recording."""
    if args.replay:
        with replayed(axis, Path(args.replay)) as machine:
            yield machine
        return
    with connected(axis, conditions=conditions) as machine, ExitStack() as stack:
        if args.record:
            stack.enter_context(recorded(machine, Path(args.record)))
        yield machine


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


def add_axis_arguments(parser: argparse.ArgumentParser) -> None:
    """The axis file, `--dry-run` and `--json`."""
    parser.add_argument("axis", metavar="AXIS.toml", help="the axis file")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    add_json_option(parser)


def add_zero_options(parser: argparse.ArgumentParser, *, anew: bool = False) -> None:
    """What a person knows of the axis's zero and nothing else can tell."""
    parser.add_argument(
        "--instrument-zeroed",
        action="store_true",
        help="the instrument was zeroed, or its beam was broken, since the axis was last measured: only the drive's zero ties both",
    )
    if anew:
        parser.add_argument(
            "--new-zero",
            action="store_true",
            help="take the axis's zero anew, also where it stands now (homing 35, 37); what was made in the old one is of no use then",
        )


def tell_zero(args: argparse.Namespace, machine: Machine) -> None:
    """Hand on what the options say. Raises InputError for a zero that is to be new in a campaign of old rows."""
    said = OfZero(anew=getattr(args, "new_zero", False), instrument_zeroed=args.instrument_zeroed)
    said.check(resume=getattr(args, "resume", False))
    zero = machine.session.zero
    if zero is not None:
        zero.anew, zero.instrument_zeroed = said.anew, said.instrument_zeroed


def seed(text: str) -> int:
    """A `--seed` as argparse takes it: what every random generator takes."""
    if not (text.isascii() and text.isdecimal() and int(text) < 2**31):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a whole number from 0 to {2**31 - 1}")
    return int(text)


def positive(text: str) -> float:
    """A number > 0 as argparse takes it."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a number > 0")
    return value


def add_password_options(parser: argparse.ArgumentParser, *, key: bool) -> None:
    """Where the passwords of the sealed store come from."""
    parser.add_argument(
        "--password-file", metavar="F", help=f"file with the tables' reading password (else ${READING}, else asked)"
    )
    if key:
        parser.add_argument(
            "--key-password-file", metavar="F", help=f"file with the builder key's password (else ${KEY}, else asked)"
        )


def open_store(args: argparse.Namespace, axis: AxisConfig, *, writing: bool) -> SealedStore:
    """The axis's sealed store, for writing with the builder's private key; every password is asked for before anything moves."""
    key = password(args.key_password_file, KEY, "builder key's password", os.environ) if writing else None
    return SealedStore.of(axis, password(args.password_file, READING, "reading password", os.environ), key)


def load_stored(store: SealedStore, effects: Sequence[Effect] = ALL) -> Compensation:
    """What is stored, with a warning where it opens although it does not say all that it should."""
    compensation = store.load(effects)
    warning = store.warning()
    if warning is not None:
        print(f"hil: {warning}", file=sys.stderr)
    return compensation


def print_dry_run(axis: AxisConfig, steps: list[Step], writes: list[str]) -> None:
    """What would move how far, and what would be written."""
    print_plan(measuring_plan(axis, steps, [Write("", line) for line in writes]))


_WRITTEN = {"rows": "rows of each pass below ", "tables": ""}


def print_plan(plan: Plan) -> None:
    """The plan of a job that measures along the axis."""
    reach = plan.reach_mm
    homing = "home it, " if plan.homes else ""
    if reach is not None:
        print(f"axis {plan.axis} over {plan.backend}: would enable it, {homing}take the datum at {plan.datum_mm:g} mm")
        velocity = max(move.velocity_mm_s for move in plan.moves)
        print(f"would move between {reach[0]:.3f} and {reach[1]:.3f} mm (corrections come on top) at {velocity:g} mm/s")
        print(f"would capture {plan.positions} positions, {plan.at_rest_s:g} s at rest each")
    for write in plan.writes:
        print(f"would write {_WRITTEN.get(write.what, '')}{write.place}")
