"""Manual mode of system A: corrections typed or computed elsewhere, read from a table file instead of measured.

The file is CSV with a header: `position_mm`, `plus_um`, `minus_um` (corrections, added to the command), or `position_mm`, `plus_um`,
`backlash_um`; in addition any of `specified_plus_um`, `specified_minus_um`, `straightness_um`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet, straightness_table
from hil.records.files import read_text
from hil.records.rows import Floats, parse_number, shown

_KNOWN = (
    "position_mm",
    "plus_um",
    "minus_um",
    "backlash_um",
    "specified_plus_um",
    "specified_minus_um",
    "straightness_um",
)


def read_manual_tables(path: str | Path) -> TableSet:
    """Tables from a file. With `backlash_um` and no `minus_um` they are one-directional. Raises InputError with file and line."""
    columns = _read_columns(path)
    positions = columns["position_mm"]
    if ("minus_um" in columns) == ("backlash_um" in columns):
        raise InputError("needs one of the columns minus_um and backlash_um", path=path, line=1)
    if ("specified_plus_um" in columns) != ("specified_minus_um" in columns):
        raise InputError("needs both specified_plus_um and specified_minus_um, or neither", path=path, line=1)
    plus = columns["plus_um"]
    try:
        if "minus_um" in columns:
            mode, minus = TableMode.BIDIRECTIONAL, columns["minus_um"]
        else:
            mode, minus = TableMode.UNIDIRECTIONAL_BACKLASH, plus - columns["backlash_um"]
        return TableSet(
            mode,
            DirectionalTable(positions, plus, minus),
            SingleTable(positions, plus - minus),
            DirectionalTable(positions, columns["specified_plus_um"], columns["specified_minus_um"])
            if "specified_plus_um" in columns
            else None,
            SingleTable(positions, columns["straightness_um"]) if "straightness_um" in columns else None,
        )
    except InputError as error:
        raise InputError(error.what, path=path) from error


def read_straightness(path: str | Path) -> SingleTable:
    """A straightness correction from measured deviations: CSV with `position_mm` and `deviation_um` (correction = -deviation)."""
    columns = _read_columns(path, ("position_mm", "deviation_um"), ("position_mm", "deviation_um"))
    try:
        return straightness_table(columns["position_mm"], columns["deviation_um"])
    except InputError as error:
        raise InputError(error.what, path=path) from error


def _read_columns(
    path: str | Path, known: Sequence[str] = _KNOWN, required: Sequence[str] = ("position_mm", "plus_um")
) -> dict[str, Floats]:
    rows = [
        (number, line.split(","))
        for number, line in enumerate(read_text(path).removeprefix("\ufeff").splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(rows) < 2:
        raise InputError("holds no table, expected a header and at least one row", path=path)
    (header_line, header), *body = rows
    names = [name.strip() for name in header]
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"unknown column {shown(unknown[0])} (known: {', '.join(known)})", path=path, line=header_line)
    if len(set(names)) != len(names):
        raise InputError("header names a column twice", path=path, line=header_line)
    if missing := [name for name in required if name not in names]:
        raise InputError(f"header lacks {missing[0]}", path=path, line=header_line)
    values: list[list[float]] = []
    for line, cells in body:
        if len(cells) != len(names):
            raise InputError(f"row has {len(cells)} columns, expected {len(names)}", path=path, line=line)
        values.append([_number(cell, name, path, line) for name, cell in zip(names, cells, strict=True)])
    table = np.array(values)
    return {name: table[:, index] for index, name in enumerate(names)}


def _number(cell: str, name: str, path: str | Path, line: int) -> float:
    value = parse_number(cell.strip())
    if value is None or not math.isfinite(value):
        raise InputError(f"{name} is {shown(cell.strip())}, expected a finite number", path=path, line=line)
    return value
