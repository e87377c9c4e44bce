"""Options of `hil export` and `hil import`, and those for the settings of a format.

Each option of a format belongs to the formats whose settings have its field; given for another one it is refused, never ignored.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

from drivers.errors import InputError
from hil.correction import CONTROLLER_FORMATS, MAX_CORRECTION_UM, MAX_SLOPE_UM_PER_MM, MEASUREMENT_FORMATS
from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_effects_option,
    add_json_option,
    add_password_options,
    positive,
    verb_parser,
)


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


# -- hil export --------------------------------------------------------------------------------------------------------
EXPORT_EXAMPLE = """\
example:
  hil export X.toml --format linuxcnc --out x.comp
  hil export X.toml --format sinumerik --axis X1 --reference-mm 0 --allow-shift --out CEC_X.INI
  hil export typed.csv --format fanuc --axis 1 --step-mm 50 --magnification 2 --out X.NC
  hil export tables.json --format twincat --axis 2 --name Y --out achskw2.lis

SOURCE is an axis file (its sealed store is read), a table file of manual mode (.csv), or tables or a model as JSON. The file is read
back before it is handed out; what a controller must be set to besides is printed.
"""


def add_export(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "export",
        "Write the correction tables of an axis in the format of a CNC controller.",
        EXPORT_EXAMPLE,
    )
    parser.add_argument("source", metavar="SOURCE", help="AXIS.toml, TABLE.csv, or tables or a model as JSON")
    parser.add_argument("--format", required=True, choices=CONTROLLER_FORMATS, help="the controller")
    parser.add_argument("--out", metavar="FILE", required=True, help="the file to write")
    parser.add_argument(
        "--tables-only",
        action="store_true",
        help="leave out fitted effects that no table holds: of load, time, velocity …",
    )
    parser.add_argument(
        "--bound",
        nargs=2,
        type=positive,
        default=(MAX_CORRECTION_UM, MAX_SLOPE_UM_PER_MM),
        metavar=("UM", "UM_PER_MM"),
        help=f"of a source without axis file: a larger or steeper correction is refused"
        f" (default {MAX_CORRECTION_UM:g} {MAX_SLOPE_UM_PER_MM:g}; an axis file states its own)",
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be written, and write nothing")
    add_options(parser, "options of the formats", CONTROLLER_OPTIONS)
    add_password_options(parser, key=False)
    add_effects_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.export"), own_plan=True)


# -- hil import --------------------------------------------------------------------------------------------------------
IMPORT_EXAMPLE = """\
example:
  hil import x.comp --format linuxcnc --out x.csv           a table file of manual mode, to look at, edit, or store
  hil import X.NC --format fanuc --axis 1 --out tables.json
  hil import Sample.Lin --format keysight --out records.csv
  hil import X.rtl --format renishaw --out records.csv
  hil import log.txt --format lines --pattern '^\\d+ +(?P<target_mm>\\S+) +(?P<error_um>\\S+)' --out records.csv
  hil import lab.csv --format csv --column target_mm=Soll --column measured_mm=Ist:um --decimal , --infer --out records.csv
  hil import report.csv --format iso-wide --cells deviation_um --out records.csv

Options of a controller's format that the file does not say (unit, type, reference, detection unit) must be those it was written with.
"""


MEASUREMENT_OPTIONS = (
    Option(
        "--pattern",
        "pattern",
        str,
        "lines: regular expression with groups target_<unit>, error_<unit> or measured_<unit>, …",
    ),
    Option("--delimiter", "delimiter", str, "csv, iso-wide: what parts the columns (default: found)"),
    Option("--decimal", "decimal", str, "csv, iso-wide, keysight, renishaw, lines: decimal mark, . (default) or ,"),
    Option(
        "--infer",
        "infer",
        None,
        "csv: read run and direction off the order of the targets; refused where it does not say them",
        switch=True,
    ),
    Option("--cells", "cells", str, "iso-wide: deviation_um (default), deviation_mm or position_mm"),
    Option("--column", "columns", None, "csv: where a column stands"),
)


def add_import(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "import",
        "Turn a controller's compensation file into tables, or another program's measurements into records.",
        IMPORT_EXAMPLE,
    )
    parser.add_argument("file", metavar="FILE", help="the file to read")
    names = [*CONTROLLER_FORMATS, *MEASUREMENT_FORMATS]
    parser.add_argument("--format", required=True, choices=names, help="what it is")
    parser.add_argument(
        "--out", metavar="OUT", required=True, help="tables: .csv (manual mode) or .json; measurements: records .csv"
    )
    add_options(parser, "options of the controllers' formats", CONTROLLER_OPTIONS)
    add_options(parser, "options of the measurements' formats", MEASUREMENT_OPTIONS[:-1])
    parser.add_argument(
        "--column",
        metavar="NAME=HEADER[:UNIT]",
        action="append",
        default=[],
        help="csv: where a column of ours stands (target_mm, measured_mm or error_um, run, direction, …); may be repeated",
    )
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.import_"))
