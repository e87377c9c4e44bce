"""Measurements as a CSV table of free form: any column names and delimiter, decimal point or comma, lengths in any unit.

The settings state which column holds what; it is never guessed: `target_mm`, `measured_mm` (or `error_um` = measured - target),
`direction`, `run`, and any other record column. Columns that they do not name are left out. Lines above the header are a heading; a
row of units below it must name those of the columns. Where the file has no run and direction, `infer` takes them from the order of
the targets (`inferred`).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import LENGTH_MM, delimited_rows, number, require, without_unit_row
from hil.records.rows import UM_PER_MM, Floats, Records

DIRECTIONS = {
    **dict.fromkeys(("+1", "1", "+", "↑", "up", "fwd", "forward", "pos", "positive", "f"), 1.0),
    **dict.fromkeys(("-1", "-", "−", "↓", "down", "rev", "reverse", "backward", "neg", "negative", "b", "r"), -1.0),
}
"""Text of a direction, in lower case -> +1 or -1."""


@dataclass(frozen=True)
class Column:
    """The column of a quantity. header: its text in the header line; unit: of a length, "" for the one in the quantity's name."""

    header: str
    unit: str = ""


@dataclass(frozen=True)
class MeasuredCsvSettings:
    """columns: record column -> column of the file

    delimiter: "" for the first of tab, semicolon and comma that is in the header; decimal: the decimal mark, "." or ","
    infer: whether run and direction are taken from the order of the targets where the file has none
    """

    columns: Mapping[str, Column] = field(default_factory=dict)
    delimiter: str = ""
    decimal: str = "."
    infer: bool = False

    def __post_init__(self) -> None:
        require(self.decimal in (".", ","), f"decimal mark is {self.decimal!r}, expected . or ,")
        require(len(self.delimiter) <= 1, f"delimiter is {self.delimiter!r}, expected one character")
        both = {"measured_mm", "error_um"} <= set(self.columns)
        require(not both, "columns name measured_mm and error_um, expected one of them, not both")
        for name, column in self.columns.items():
            if column.unit:
                require(
                    column.unit.lower() in LENGTH_MM,
                    f"column {name}: unit is {column.unit!r}, expected such as mm or um",
                )
                require(_is_length(name), f"column {name} is no length, it cannot have the unit {column.unit}")

    def column(self, name: str) -> Column:
        """The file's column for the record column `name`: as stated, else the one with that name."""
        return self.columns.get(name, Column(name))


def _is_length(name: str) -> bool:
    return name.endswith(("_mm", "_um"))


def load(text: str, settings: MeasuredCsvSettings = MeasuredCsvSettings()) -> Records:
    """The rows in the order of the file. Lines that begin with # are left out. Raises InputError with the line."""
    headers = [settings.column(name).header for name in _needed(settings)]
    table = delimited_rows(text, settings.delimiter, partial(_share, headers))
    header_line, header = table[0]
    wanted = _wanted(header, settings, header_line)
    units = {
        place: "" if settings.column(name).unit else name[-2:] for name, place in wanted.items() if _is_length(name)
    }
    body = without_unit_row(table, units, "state it: --column NAME=HEADER:UNIT")
    columns: dict[str, list[float]] = {name: [] for name in wanted}
    for line_number, cells in body:
        for name, index in wanted.items():
            columns[name].append(_value(name, cells[index], settings, line_number))
    return _records({name: np.array(values) for name, values in columns.items()}, settings, [line for line, _ in body])


def _needed(settings: MeasuredCsvSettings) -> list[str]:
    """The record columns that the header must have."""
    value = "error_um" if "error_um" in settings.columns and "measured_mm" not in settings.columns else "measured_mm"
    order = () if settings.infer else ("run", "direction")
    return list(dict.fromkeys(("target_mm", *order, value, *settings.columns)))


def _share(headers: Sequence[str], cells: list[str]) -> float:
    return sum(header in cells for header in headers) / len(headers)


def _wanted(header: list[str], settings: MeasuredCsvSettings, line: int) -> dict[str, int]:
    wanted: dict[str, int] = {}
    needed = _needed(settings)
    for name in dict.fromkeys((*needed, "run", "direction")):
        place = settings.column(name).header
        if header.count(place) > 1:
            raise InputError(f"header names {place!r} twice", line=line)
        if place in header:
            wanted[name] = header.index(place)
        elif name in needed:
            hint = "; or let run and direction be inferred (infer)" if name in ("run", "direction") else ""
            has = ", ".join(cell for cell in header if cell)
            raise InputError(f"header lacks {place!r} for {name} (it is one line and has {has}){hint}", line=line)
    return wanted


def cell_value(name: str, cell: str, decimal: str, line: int) -> float:
    """A cell of the record column `name`. Raises InputError for no number, no direction, and a run that is no whole number."""
    if name == "direction":
        if cell.strip().lower() not in DIRECTIONS:
            raise InputError(
                f"direction is {cell!r}, expected +1 or -1 (or up and down, forward and reverse)", line=line
            )
        return DIRECTIONS[cell.strip().lower()]
    value = number(cell, name, line, decimal)
    if name == "run" and value != int(value):
        raise InputError(f"run is {cell!r}, expected a whole number", line=line)
    return value


def _value(name: str, cell: str, settings: MeasuredCsvSettings, line: int) -> float:
    value = cell_value(name, cell, settings.decimal, line)
    unit = settings.column(name).unit.lower()
    if not unit:
        return value
    return value * LENGTH_MM[unit] * (UM_PER_MM if name.endswith("_um") else 1.0)


def _records(columns: dict[str, Floats], settings: MeasuredCsvSettings, lines: Sequence[int]) -> Records:
    target = columns["target_mm"]
    if "error_um" in columns:
        columns["measured_mm"] = target + columns.pop("error_um") / UM_PER_MM
    return ordered_records(columns, lines if settings.infer else None)


def ordered_records(columns: dict[str, Floats], lines: Sequence[int] | None) -> Records:
    """Records of these columns, the required ones first. lines: of the rows in the file, from which a missing run or direction is
    `inferred`; None: they are there."""
    if lines is not None and ("run" not in columns or "direction" not in columns):
        run, direction = inferred(columns["target_mm"], lines)
        columns.setdefault("run", run)
        columns.setdefault("direction", direction)
    order = ["run", "direction", "target_mm", "measured_mm"]
    return Records.of({name: columns[name] for name in (*order, *(name for name in columns if name not in order))})


def inferred(target_mm: Floats, lines: Sequence[int]) -> tuple[Floats, Floats]:
    """Run, from 1, and direction, +1 or -1, of targets in the order of time; shape (n,) each. lines: where each stands in its file.

    Rising is +, falling is -. A target equal to the one before it belongs to the direction that follows: there the axis has turned.
    A run begins where the direction of the first row comes again after the other one; and where the axis has gone back past other
    targets to a single one and on as before: that way back was not measured, and the target belongs to the new run. Raises InputError
    with the line where the first two targets are equal, and for a way of one target next to it, which may be either.
    """
    signs = _directions(target_mm, lines)
    turns = np.flatnonzero(np.diff(signs)) + 1
    begins = np.zeros(len(signs), dtype=bool)
    begins[1:] = (signs[1:] == signs[0]) & (signs[:-1] != signs[0])
    for start, end in itertools.pairwise([*turns.tolist(), len(signs)]):
        repeated = target_mm[start] == target_mm[start - 1]
        at = start + repeated
        if end - at > 1:
            continue
        low, high = sorted(target_mm[[start - 1, end - 1]])
        passed = bool(np.any((target_mm > low) & (target_mm < high)))
        if repeated and at < end and not passed:
            continue
        if repeated or not passed or end == len(signs):
            raise InputError(
                f"target {target_mm[end - 1]:g} after {target_mm[start - 1]:g} is a way back of one target, or the first of another"
                " run: state run and direction in columns of their own",
                line=lines[end - 1],
            )
        signs[start] = -signs[start]
        begins[start : start + 2] = True, False
    return 1.0 + np.cumsum(begins), signs


def _directions(target_mm: Floats, lines: Sequence[int]) -> Floats:
    """The direction of the step to each target."""
    steps = np.sign(np.diff(target_mm))
    if len(steps) == 0 or steps[0] == 0:
        raise InputError("the first two targets are the same, so the direction cannot be inferred", line=lines[0])
    direction = [float(steps[0])]
    for index, step in enumerate(steps):
        following = steps[index + 1] if index + 1 < len(steps) else 0.0
        direction.append(float(step or following or -direction[-1]))
    return np.array(direction)


def parse_column(text: str) -> tuple[str, Column]:
    """A column as typed on the command line, `name=header` or `name=header:unit`. Raises InputError."""
    name, separator, place = text.partition("=")
    match = re.fullmatch(r"(.+?)(?::([A-Za-zµμ]+))?", place)
    if not separator or not name.strip() or match is None:
        raise InputError(f"column is {text!r}, expected NAME=HEADER or NAME=HEADER:UNIT")
    return name.strip(), Column(match[1].strip(), match[2] or "")
