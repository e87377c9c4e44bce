"""Measurements in the layout of ISO 230-2 reports: a row per target, a column per run and direction.

The first column is the target; the headers of the others name run and direction in either order: `1+ 1- 2+ 2-`, `1↑ 1↓`,
`run 1 forward`, `up 3`. Cells are deviations (measured - target) or positions. Such a table does not hold the order of measuring; the
records have the usual one: run by run, rising targets in +, then falling ones in -.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from drivers.files import without_empty_end
from hil.correction import WIDE_ISO_CELLS
from hil.correction.formats.common import delimited_rows, number, require, without_unit_row
from hil.correction.formats.measured_csv import DIRECTIONS
from hil.records.rows import Records, shown

_SIGN = "|".join(sorted((re.escape(name) for name in DIRECTIONS if not name[-1].isdigit()), key=len, reverse=True))
_RUN_FIRST = re.compile(rf"(?:run|cycle|j)? ?=? ?(\d{{1,9}}) ?[,_]? ?({_SIGN})", re.IGNORECASE | re.ASCII)
_SIGN_FIRST = re.compile(rf"({_SIGN}) ?[,_]? ?(?:run|cycle|j)? ?=? ?(\d{{1,9}})", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True)
class WideIsoSettings:
    """cells: one of `WIDE_ISO_CELLS`; delimiter: "" for the first of tab, semicolon and comma in a line; decimal: "." or "," """

    cells: str = "deviation_um"
    delimiter: str = ""
    decimal: str = "."

    def __post_init__(self) -> None:
        require(self.cells in WIDE_ISO_CELLS, f"cells are {self.cells!r}, expected {', '.join(WIDE_ISO_CELLS)}")
        require(self.decimal in (".", ","), f"decimal mark is {self.decimal!r}, expected . or ,")
        require(len(self.delimiter) <= 1, f"delimiter is {self.delimiter!r}, expected one character")


def load(text: str, settings: WideIsoSettings = WideIsoSettings()) -> Records:
    """The rows of all runs. Raises InputError with the line, also for an empty cell."""
    rows = delimited_rows(text, settings.delimiter, _share)
    header_line, header = rows[0]
    columns = [_column(label, header_line) for label in header[1:]]
    if not columns:
        raise InputError("the header has no column of a run, such as 1+ or 1-", line=header_line)
    if len(set(columns)) != len(columns):
        raise InputError("the header names a run and direction twice", line=header_line)
    units = {0: "mm", **dict.fromkeys(range(1, len(header)), settings.cells.rpartition("_")[2])}
    body = without_unit_row(rows, units, "targets are in mm, and what the cells hold is stated (cells)")
    table: list[tuple[float, list[float]]] = []
    seen: set[float] = set()
    for line_number, cells in body:
        values = [number(cell, label, line_number, settings.decimal) for cell, label in zip(cells, header, strict=True)]
        if values[0] in seen:
            raise InputError(f"target {cells[0]} comes a second time", line=line_number)
        seen.add(values[0])
        table.append((values[0], values[1:]))
    table.sort()
    scale = WIDE_ISO_CELLS[settings.cells]
    measured: list[tuple[float, float, float, float]] = []
    for index in sorted(range(len(columns)), key=lambda at: (columns[at][0], -columns[at][1])):
        run, direction = columns[index]
        for target, values in table if direction > 0 else reversed(table):
            cell = values[index] * scale
            measured.append((run, direction, target, cell if settings.cells == "position_mm" else target + cell))
    names = ("run", "direction", "target_mm", "measured_mm")
    return Records.of(dict(zip(names, np.array(measured).T, strict=True)))


def dump(records: Records, settings: WideIsoSettings = WideIsoSettings()) -> str:
    """The table of these records; reading it back gives their positions to 1 nm.

    Raises InputError where a run lacks a target that another one has, or has a target twice: the table has one cell for each.
    """
    cells: dict[tuple[int, float], dict[float, float]] = {}
    scale = WIDE_ISO_CELLS[settings.cells]
    for run, direction, target, measured in zip(
        records.run, records.direction, records.target_mm, records.measured_mm, strict=True
    ):
        column = cells.setdefault((int(run), float(direction)), {})
        if float(target) in column:
            raise InputError(f"run {int(run)} holds target {target:g} mm in direction {direction:+g} twice")
        column[float(target)] = measured if settings.cells == "position_mm" else (measured - target) / scale
    targets = sorted(set(records.target_mm.tolist()))
    columns = sorted(cells, key=lambda key: (key[0], -key[1]))
    for (run, direction), column in cells.items():
        if missing := set(targets) - column.keys():
            raise InputError(
                f"run {run} lacks target {min(missing):g} mm in direction {direction:+g}, which others have"
            )
    delimiter = settings.delimiter or (";" if settings.decimal == "," else ",")
    decimals = 3 if settings.cells == "deviation_um" else 6
    lines = [delimiter.join(["target_mm", *(f"{run}{'+' if direction > 0 else '-'}" for run, direction in columns)])]
    for target in targets:
        values = [repr(target), *(f"{cells[key][target]:.{decimals}f}" for key in columns)]
        lines.append(delimiter.join(value.replace(".", settings.decimal) for value in values))
    return "\n".join(lines) + "\n"


def _share(cells: list[str]) -> float:
    labels = without_empty_end(cells)[1:]
    return sum(_run_and_direction(label) is not None for label in labels) / max(len(labels), 1)


def _column(label: str, line: int) -> tuple[int, float]:
    if found := _run_and_direction(label):
        return found
    raise InputError(
        f"column {shown(label)} names no run and direction, expected such as 1+ or run 1 reverse", line=line
    )


def _run_and_direction(label: str) -> tuple[int, float] | None:
    single_blanks = " ".join(label.split())  # in runs of them the patterns would try every division
    if match := _RUN_FIRST.fullmatch(single_blanks):
        return int(match[1]), DIRECTIONS[match[2].lower()]
    if match := _SIGN_FIRST.fullmatch(single_blanks):
        return int(match[2]), DIRECTIONS[match[1].lower()]
    return None
