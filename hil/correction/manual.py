"""Manual mode of system A: corrections typed or computed elsewhere, read from a table file instead of measured.

The file is CSV with a header: `position_mm`, `plus_um` (corrections, added to the command), and `minus_um`, `backlash_um` or both, in
addition any of `specified_plus_um`, `specified_minus_um`, `straightness_um`. A backlash beside both directions was measured by other
means and takes the place of their own difference; one on positions of its own is a file with `position_mm`, `backlash_um`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text, table_rows
from hil.correction.tables import Band, DirectionalTable, SignedSections, SingleTable, TableMode, TableSet
from hil.records.files import split_lines
from hil.records.rows import Floats, parse_number, repeats, shown

_KNOWN = (
    "position_mm",
    "plus_um",
    "minus_um",
    "backlash_um",
    "specified_plus_um",
    "specified_minus_um",
    "straightness_um",
    "straightness_plus_um",
    "straightness_minus_um",
)


def read_manual_tables(path: str | Path, backlash: SingleTable | None = None) -> TableSet:
    """Tables from a file. Without `minus_um` they are one-directional. Raises InputError with file and line.

    backlash: measured by other means, from a file of its own; then the file holds none
    """
    columns = _read_columns(path)
    positions = columns["position_mm"]
    if backlash is not None and "backlash_um" in columns:
        raise InputError(
            "holds a backlash already, and another is given beside it: it would count twice", path=path, line=1
        )
    if "backlash_um" in columns:
        backlash = SingleTable(positions, columns["backlash_um"])
    if "minus_um" not in columns and backlash is None:
        raise InputError("needs minus_um, or backlash_um, or a backlash beside it (--backlash)", path=path, line=1)
    if ("specified_plus_um" in columns) != ("specified_minus_um" in columns):
        raise InputError("needs both specified_plus_um and specified_minus_um, or neither", path=path, line=1)
    plus = columns["plus_um"]
    try:
        if backlash is None:
            mode, minus = TableMode.BIDIRECTIONAL, columns["minus_um"]
        elif "minus_um" in columns:
            mode, minus = TableMode.MEAN_BACKLASH, columns["minus_um"]
        else:
            mode, minus = TableMode.UNIDIRECTIONAL_BACKLASH, plus - backlash.at(positions)
        return TableSet(
            mode,
            DirectionalTable(positions, plus, minus),
            SingleTable(positions, plus - minus) if backlash is None else backlash,
            DirectionalTable(positions, columns["specified_plus_um"], columns["specified_minus_um"])
            if "specified_plus_um" in columns
            else None,
            _by_direction(columns, "straightness", path),
        )
    except InputError as error:
        raise InputError(error.what, path=path) from error


def manual_text(tables: TableSet, comment: str = "") -> str:
    """The text of a manual table file: a row per node of any of the tables. comment: put before the header, each line after "# ".

    Raises InputError for a straightness table that corrects another axis: such a file holds one axis.
    """
    if tables.straightness is not None and tables.straightness_axis:
        raise InputError(
            f"the file holds a correction of axis {tables.straightness_axis} too, and a table file holds one axis; write JSON"
        )
    parts = [tables.pitch.position_mm]
    parts += [part.position_mm for part in (tables.backlash, tables.specified, tables.straightness) if part is not None]
    nodes = np.unique(np.concatenate(parts))
    columns: dict[str, Floats] = {"position_mm": nodes, "plus_um": tables.pitch.at(nodes, 1)}
    if tables.mode is not TableMode.UNIDIRECTIONAL_BACKLASH:
        columns["minus_um"] = tables.pitch.at(nodes, -1)
    if tables.mode is not TableMode.BIDIRECTIONAL and tables.backlash is not None:
        columns["backlash_um"] = tables.backlash.at(nodes)
    if tables.specified is not None:
        columns["specified_plus_um"] = tables.specified.at(nodes, 1)
        columns["specified_minus_um"] = tables.specified.at(nodes, -1)
    if tables.straightness is not None:
        alike = tables.straightness.is_alike
        for sign, name in (
            ((1, "straightness_um"),) if alike else ((1, "straightness_plus_um"), (-1, "straightness_minus_um"))
        ):
            columns[name] = tables.straightness.at(nodes, sign)
    lines = [f"# {line}" for line in comment.splitlines()]
    lines.append(",".join(columns))
    lines += [",".join(repr(float(value)) for value in row) for row in np.column_stack(list(columns.values()))]
    return "\n".join(lines) + "\n"


def _by_direction(columns: dict[str, Floats], what: str, path: str | Path) -> DirectionalTable | None:
    """A table with one column for both directions, `what_um`, or with one for each; None without any."""
    both, *each = f"{what}_um", f"{what}_plus_um", f"{what}_minus_um"
    have = [name for name in each if name in columns]
    if len(have) == 1 or (have and both in columns):
        raise InputError(f"needs {both} alone, or both {each[0]} and {each[1]}", path=path, line=1)
    if have:
        return DirectionalTable(columns["position_mm"], *(columns[name] for name in each))
    return DirectionalTable.alike(columns["position_mm"], columns[both]) if both in columns else None


def read_backlash(path: str | Path) -> SingleTable:
    """A backlash measured by other means, D = C - B in µm, on its own positions: CSV with `position_mm` and `backlash_um`.

    Positive where the table lags behind a motor that has turned round. Raises InputError with file and line.
    """
    columns = _read_columns(path, ("position_mm", "backlash_um"), ("position_mm", "backlash_um"))
    try:
        return SingleTable(columns["position_mm"], columns["backlash_um"])
    except InputError as error:
        raise InputError(error.what, path=path) from error


def read_signs(path: str | Path, text: str | None = None) -> tuple[SignedSections, ...]:
    """The signs of a specified accuracy: CSV with `from_mm`, `to_mm`, `plus`, `minus`, as `signs` of the axis file; none without rows.

    text: in place of the file's. Raises InputError with the file, and the line where it is of one, also for a section with two signs.
    """
    names = ("from_mm", "to_mm", "plus", "minus")
    text = read_text(path) if text is None else text
    if len(_rows(text)) < 2:
        return ()
    columns = _read_columns(path, names, names, text)
    try:
        signs = [
            SignedSections(start, end, *(int(sign) if abs(sign) == 1.0 else 0 for sign in pair))
            for start, end, *pair in zip(*(columns[name].tolist() for name in names), strict=True)
        ]
        return Band(0.0, 1.0, tuple(signs)).signs
    except InputError as error:
        raise InputError(error.what, path=path) from error


def read_straightness(path: str | Path) -> DirectionalTable:
    """A straightness correction from measured deviations (correction = -deviation): CSV with `position_mm` and `deviation_um`, or
    `deviation_plus_um` and `deviation_minus_um`.
    """
    names = ("position_mm", "deviation_um", "deviation_plus_um", "deviation_minus_um")
    columns = _read_columns(path, names, ("position_mm",))
    try:
        deviation = _by_direction(columns, "deviation", path)
    except InputError as error:
        raise InputError(error.what, path=path) from error
    if deviation is None:
        raise InputError("header lacks deviation_um", path=path, line=1)
    return deviation.scaled(-1.0)


def _read_columns(
    path: str | Path,
    known: Sequence[str] = _KNOWN,
    required: Sequence[str] = ("position_mm", "plus_um"),
    text: str | None = None,
) -> dict[str, Floats]:
    rows = _rows(read_text(path) if text is None else text)
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
    columns = dict(zip(names, np.array(values).T, strict=True))
    for name in names:
        if name.endswith("_um") and "position_mm" in columns and repeats(columns["position_mm"], columns[name]):
            what = f"{name} repeats the positions in mm: expected corrections in µm, not the positions that are reached"
            raise InputError(what, path=path, line=header_line)
    return columns


def _rows(text: str) -> list[tuple[int, list[str]]]:
    """Number and cells of each row."""
    return list(table_rows(split_lines(text)))


def _number(cell: str, name: str, path: str | Path, line: int) -> float:
    value = parse_number(cell.strip())
    if value is None or not math.isfinite(value):
        point = " with a decimal point" if "," in cell else ""
        raise InputError(f"{name} is {shown(cell.strip())}, expected a finite number{point}", path=path, line=line)
    return value
