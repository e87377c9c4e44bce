"""Options of `hil export` and `hil import` for the settings of a format.

Each option belongs to the formats whose settings have its field; given for another one it is refused, never ignored.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

from drivers.errors import InputError


@dataclass(frozen=True)
class Option:
    """A flag, the settings field it fills, how its text becomes a value (None: a switch that stands for `switch`), and its help."""

    flag: str
    field: str
    convert: Callable[[str], Any] | None
    help: str
    switch: Any = None

    @property
    def dest(self) -> str:
        return "format_" + self.flag.removeprefix("--").replace("-", "_")


CONTROLLER_OPTIONS = (
    Option(
        "--axis",
        "axis",
        str,
        "the axis on the controller: X1 (sinumerik), its number (fanuc, twincat), its letter (grblhal, fluidnc)",
    ),
    Option("--name", "name", str, "twincat: the axis's name"),
    Option("--unit", "unit", str, "linuxcnc: mm (default) or inch"),
    Option("--type", "comp_type", int, "linuxcnc: COMP_FILE_TYPE, 1 (trims, default) or 0 (positions reached)"),
    Option("--table", "table", str, "sinumerik: cec (both directions, default) or eec (one, with MD32450)"),
    Option("--index", "index", int, "sinumerik: first CEC table, or the EEC's encoder (default 0)"),
    Option("--cross-axis", "cross_axis", str, "sinumerik cec: the axis that a cross-axis straightness table corrects"),
    Option(
        "--reference-mm",
        "reference_mm",
        float,
        "sinumerik, fanuc: the reference point, where the table is zero (default 0)",
    ),
    Option(
        "--reference-direction",
        "reference_direction",
        int,
        "sinumerik, fanuc: direction in which the reference is approached, 1 (default) or -1",
    ),
    Option(
        "--allow-shift",
        "allow_shift",
        None,
        "sinumerik, fanuc: take the correction at the reference point out of the whole table",
        switch=True,
    ),
    Option(
        "--step-mm",
        "step_mm",
        float,
        "sinumerik, fanuc, mach3, mach4: distance of the points (default: the widest that is good enough)",
    ),
    Option(
        "--max-points", "max_points", int, "sinumerik (default 200), twincat (1500): points the control has room for"
    ),
    Option("--max-correction-um", "max_correction_um", float, "sinumerik cec: MD32720 (default 1000)"),
    Option(
        "--tolerance-um",
        "tolerance_um",
        float,
        "largest deviation from the tables, resampling and rounding together; refused where the format cannot keep it"
        " (default: 0.1 by resampling, and what rounding adds)",
    ),
    Option(
        "--steps-per-mm",
        "steps_per_mm",
        float,
        "grblhal, fluidnc: steps per mm as set now; changed by the straight part",
    ),
    Option("--symmetric", "asymmetric", None, "mach4: one map for both ways, and a backlash", switch=False),
    Option("--detection-unit-um", "detection_unit_um", float, "fanuc: the axis's detection unit (default 1)"),
    Option("--magnification", "magnification", int, "fanuc: parameter 3623 (default 1)"),
    Option("--first-number", "first_number", int, "fanuc: first free point number (default 0)"),
    Option("--setting-unit-mm", "setting_unit_mm", float, "fanuc: unit of parameter 3624 (default 0.001)"),
    Option("--rapid-mm-min", "rapid_mm_min", float, "fanuc: largest feed, to check the interval"),
    Option(
        "--one-directional",
        "bidirectional",
        None,
        "fanuc: one table for both directions, backlash in 1851",
        switch=False,
    ),
    Option("--bits-3605", "bits_3605", int, "fanuc: the other bits of parameter 3605 (default 0)"),
    Option(
        "--series", "series", str, "fanuc: 16i (G10 L50; also 18i, 21i, 0i-B; default) or 30i (G10 L52; also 31i, 32i)"
    ),
    Option("--program", "program", int, "fanuc: O number (default 9000)"),
)


def add_options(parser: argparse.ArgumentParser, title: str, options: tuple[Option, ...]) -> None:
    """The options as a group of their own."""
    group = parser.add_argument_group(title)
    for option in options:
        if option.convert is None:
            group.add_argument(
                option.flag, dest=option.dest, action="store_const", const=option.switch, default=None, help=option.help
            )
        else:
            metavar = option.flag.rpartition("-")[2].upper()
            group.add_argument(option.flag, dest=option.dest, metavar=metavar, type=option.convert, help=option.help)


@contextmanager
def as_typed(options: Iterable[Option]) -> Iterator[None]:
    """InputErrors raised inside that name a setting in brackets, as what to change, name the option that was or could be typed."""
    try:
        yield
    except InputError as error:
        what = error.what
        for option in options:
            what = re.sub(rf"\({option.field}\b", f"({option.flag}", what)
        raise type(error)(what, path=error.path, line=error.line) from error


def settings_from(args: argparse.Namespace, name: str, settings: type[Any], options: tuple[Option, ...]) -> Any:
    """The settings of a format with what was typed. Raises InputError for an option that is not the format's."""
    kinds = {field.name: type(field.default) for field in fields(settings)}
    values: dict[str, Any] = {}
    for option in options:
        value = getattr(args, option.dest, None)
        if value is None:
            continue
        if option.field not in kinds:
            raise InputError(f"{option.flag} is no option of the format {name}")
        if kinds[option.field] is int and isinstance(value, str):
            try:
                value = int(value)
            except ValueError:
                raise InputError(f"{option.flag} is {value!r}, expected a whole number for {name}") from None
        values[option.field] = value
    return settings(**values)
