"""Options that several verbs have, and `Later`: a verb's help is shown without what the verb itself imports."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TypeAlias

from drivers.errors import InputError
from hil.correction import TABLES
from hil.machine.in_motion_settings import InMotion, feeds_of

Subparsers: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
READING = "HIL_PASSWORD"
KEY = "HIL_KEY_PASSWORD"
RUNS = re.compile(r"\d+(-\d+)?(,\d+(-\d+)?)*")


@dataclass(frozen=True)
class Later:
    """What a verb runs: a function of a module that is imported only for it."""

    module: str
    name: str = "run"

    def load(self) -> None:
        import_module(self.module)

    def __call__(self, args: argparse.Namespace) -> int:
        """Run the function; returns the exit status."""
        return int(getattr(import_module(self.module), self.name)(args))


def verb_parser(subparsers: Subparsers, verb: str, description: str, example: str) -> argparse.ArgumentParser:
    """The parser of a verb, to which its options are added. example: what its help ends with, laid out as it is."""
    layout = argparse.RawDescriptionHelpFormatter
    return subparsers.add_parser(verb, description=description, epilog=example, formatter_class=layout)


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """The `--json FILE` that every verb has."""
    parser.add_argument(
        "--json",
        metavar="FILE",
        help="also write the result as JSON to FILE; with - it alone is on standard output, the rest on stderr",
    )


def add_axis_arguments(parser: argparse.ArgumentParser) -> None:
    """The axis file, `--dry-run` and `--json`."""
    parser.add_argument("axis", metavar="AXIS.toml", help="the axis file")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    add_json_option(parser)


def add_zero_options(parser: argparse.ArgumentParser, *, anew: bool = False) -> None:
    """`--instrument-zeroed` and, with anew, `--new-zero`: facts about the axis's zero that only a person knows."""
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


def add_password_options(parser: argparse.ArgumentParser, *, key: bool) -> None:
    parser.add_argument(
        "--password-file", metavar="F", help=f"file with the tables' reading password (else ${READING}, else asked)"
    )
    parser.add_argument(
        "--table-password",
        metavar="NAME=F",
        action="append",
        default=[],
        help=f"file with the own password of one table ({', '.join(TABLES)}); may be repeated, the others have the common one",
    )
    if key:
        parser.add_argument(
            "--key-password-file", metavar="F", help=f"file with the builder key's password (else ${KEY}, else asked)"
        )


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """Options for the password(s) of the entries of a sealed file."""
    parser.add_argument(
        "--password-file",
        metavar="F",
        help=f"file whose first line is the reading password (else ${READING}, else asked)",
    )
    parser.add_argument(
        "--entry-password",
        metavar="NAME=F",
        action="append",
        default=[],
        help="an own password for one entry, from the first line of file F; may be repeated",
    )


def add_key_options(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Options for the builder's private key and its password."""
    parser.add_argument("--key", metavar="BUILDER.key", required=required, help="the builder's private key")
    parser.add_argument(
        "--key-password-file",
        metavar="F",
        help=f"file whose first line is the key's password (else ${KEY}, else asked)",
    )


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    recording = parser.add_mutually_exclusive_group()
    recording.add_argument("--record", metavar="FILE.csv", help="record drive and instrument to a new file")
    recording.add_argument("--replay", metavar="FILE.csv", help="play such a recording instead of connecting anything")


def add_limit_option(parser: argparse.ArgumentParser) -> None:
    """`--limit`: the largest accuracy A that is allowed."""
    parser.add_argument(
        "--limit",
        metavar="UM",
        type=positive,
        help="largest accuracy A of ISO 230-2 that is allowed, µm (default: accuracy_limit_um of [correction], else no limit)",
    )


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


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    """`--effects FILE.py`."""
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        action="append",
        default=[],
        help="Python code of yours with EFFECTS = (MyEffect(), …), run and used beside the catalogue; may be repeated",
    )


def add_records_argument(parser: argparse.ArgumentParser) -> None:
    """`RECORDS.csv …` and `--runs 1-3`."""
    parser.add_argument(
        "records", metavar="RECORDS.csv", nargs="+", help="measurement records: run, direction, target_mm, measured_mm"
    )
    parser.add_argument("--runs", metavar="1-3", type=parse_runs, help="only these runs, e.g. 1-3 or 1,4,6-8")


def number_type(expected: str, fits: Callable[[float], bool]) -> Callable[[str], float]:
    """The argparse type of a number that fits; for another one, and for no number, the error says what was expected."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not fits(value):
            raise argparse.ArgumentTypeError(f"is {text!r}, expected {expected}")
        return value

    return read


def whole_type(low: int, high: int, expected: str = "") -> Callable[[str], int]:
    """As `number_type` of a whole number from low to high."""

    def read(text: str) -> int:
        if not (text.isascii() and text.isdecimal() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"is {text!r}, expected {expected or f'a whole number, {low} to {high}'}")
        return int(text)

    return read


positive = number_type("a number > 0", lambda value: 0.0 < value <= 1e6)
seed = whole_type(0, 2**31 - 1, f"a whole number from 0 to {2**31 - 1}")


def feeds(text: str) -> tuple[float, ...]:
    """At least two feeds, mm/s, as an argparse type. Raises ArgumentTypeError."""
    try:
        return feeds_of(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(error.what) from error


def parse_runs(text: str) -> tuple[int, ...]:
    """'1-3,5' as run numbers. Raises argparse's error."""
    if not RUNS.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no list of runs, expected e.g. 1-3 or 1,4,6-8")
    runs: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        if last and int(last) < int(first):
            raise argparse.ArgumentTypeError(f"{part!r} runs backwards")
        if len(part) > len("10000-20000"):
            raise argparse.ArgumentTypeError(f"{part!r} is no run of a campaign, expected numbers below 100000")
        runs.extend(range(int(first), int(last or first) + 1))
    return tuple(runs)
