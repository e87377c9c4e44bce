"""Measurement records: one row per captured position, in the order of time.

The columns are those of the file format (README, "Records"): `run`, `direction`, `target_mm` and `measured_mm` are
required, the named optional ones are known, any other column is kept as a candidate regressor. All columns are float64
arrays of one length, read-only; an empty cell (or `nan`) is NaN and allowed in optional columns only. An empty
`command_mm` means the target.

Signs: error = measured - target; error of the uncorrected machine = measured - command.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.files import is_row, read_text, without_empty_end

Floats = NDArray[np.float64]

REQUIRED = ("run", "direction", "target_mm", "measured_mm")
UM_PER_MM = 1000.0

LARGEST = 1e30
"""Largest value of any column (time in ns since 1970 is 2e18); the squares of larger ones would overflow in a fit."""

WITHDRAWN = "withdrawn"
"""First word of a comment line that withdraws rows above it: `# withdrawn 3: why`."""
_WITHDRAWN = re.compile(rf"#\s*{WITHDRAWN} (\d{{1,9}}):")
_LINE_END = re.compile(r"\r\n|\r|\n")
_SHOWN = 40  # characters of a bad cell that an error quotes


@dataclass(frozen=True)
class Records:
    """Rows of one or more runs, one float64 array of shape (n,) per column. Build with `Records.of`, `read_csv` or
    `concatenate`; never mutated.
    """

    columns: Mapping[str, Floats]

    @classmethod
    def of(cls, columns: Mapping[str, Iterable[float]]) -> Records:
        """Checks and freezes columns given by name, each shape (n,). Raises InputError on missing or ragged columns or
        bad required values.
        """
        frozen: dict[str, Floats] = {}
        for name, values in columns.items():
            frozen[_column_name(name)] = _column(name, values)
        missing = [name for name in REQUIRED if name not in frozen]
        if missing:
            raise InputError(f"records lack the column(s) {', '.join(missing)}")
        lengths = {len(array) for array in frozen.values()}
        if len(lengths) != 1:
            raise InputError(f"columns differ in length: {sorted(lengths)}")
        for name in REQUIRED:
            if np.any(np.isnan(frozen[name])):
                raise InputError(f"column {name} holds a value that is not a number")
        if not np.all(np.abs(frozen["direction"]) == 1.0):
            raise InputError("column direction holds a value other than +1 or -1")
        if not np.all(frozen["run"] == np.floor(frozen["run"])):
            raise InputError("column run holds a value that is not a whole number")
        return cls(frozen)

    def __len__(self) -> int:
        return len(self.columns["run"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Floats:
        return self.columns[name]

    @property
    def run(self) -> Floats:
        """Run numbers, shape (n,)."""
        return self.columns["run"]

    @property
    def direction(self) -> Floats:
        """+1 or -1, shape (n,)."""
        return self.columns["direction"]

    @property
    def target_mm(self) -> Floats:
        """Targets, mm, shape (n,)."""
        return self.columns["target_mm"]

    @property
    def measured_mm(self) -> Floats:
        """Positions by the instrument, mm, shape (n,)."""
        return self.columns["measured_mm"]

    @property
    def command_mm(self) -> Floats:
        """Commanded positions, mm, shape (n,); the target where there is no other (no column, or an empty cell)."""
        command = self.columns.get("command_mm")
        return self.target_mm if command is None else np.where(np.isnan(command), self.target_mm, command)

    @property
    def error_um(self) -> Floats:
        """Error as measured, with whatever correction was in force: measured - target, µm, shape (n,)."""
        return (self.measured_mm - self.target_mm) * UM_PER_MM

    @property
    def uncorrected_error_um(self) -> Floats:
        """Error of the uncorrected machine: measured - command, µm, shape (n,)."""
        return (self.measured_mm - self.command_mm) * UM_PER_MM

    @property
    def runs(self) -> list[int]:
        """The run numbers, ascending."""
        return sorted({int(run) for run in self.run})

    def where(self, mask: NDArray[np.bool_]) -> Records:
        """The rows where mask, shape (n,), holds."""
        return Records.of({name: array[mask] for name, array in self.columns.items()})

    def of_runs(self, runs: Iterable[int]) -> Records:
        """The rows of the given runs."""
        return self.where(np.isin(self.run, list(runs)))

    def with_column(self, name: str, values: Floats) -> Records:
        """A copy with one column, shape (n,), added or replaced. Raises InputError as `of`."""
        return Records.of({**self.columns, name: values})


def _column_name(name: str) -> str:
    """A name that a header row can hold and give back."""
    if not name or name != name.strip() or name.startswith("#") or "," in name or not name.isprintable():
        raise InputError(f"column name {name!r} cannot stand in a header row")
    return name


def _column(name: str, values: Iterable[float]) -> Floats:
    try:
        array = np.array(values if isinstance(values, np.ndarray) else list(values), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"column {name} holds something that is not a number") from error
    if array.ndim != 1:
        raise InputError(f"column {name} has {array.ndim} dimensions, expected 1")
    if np.any(np.abs(array) > LARGEST):
        raise InputError(f"column {name} holds a value beyond ±{LARGEST:g}")
    array.setflags(write=False)
    return array


def concatenate(parts: Iterable[Records]) -> Records:
    """Rows one after the other; a column that a part lacks is NaN there (`command_mm` falls back to the target). Raises
    InputError as `Records.of`.
    """
    parts = list(parts)
    names = list(dict.fromkeys(name for part in parts for name in part.columns))
    columns: dict[str, Floats] = {}
    for name in names:
        pieces = []
        for part in parts:
            if name in part:
                pieces.append(part[name])
            elif name == "command_mm":
                pieces.append(part.target_mm)
            else:
                pieces.append(np.full(len(part), np.nan))
        columns[name] = np.concatenate(pieces)
    return Records.of(columns)


MOVES_WITH = (0.5, 1.5)
"""Change of the measured position per change of the target, mm/mm: no machine is wrong by a half."""
FAR_MM, STRAIGHT = 0.1, 0.1
"""Standard deviation of targets, or of positions, from which errors cannot be what such a change shows, and share of it within which
positions lie on a line: a drift of micrometres at one place has any slope.
"""
REPEATS = 1e-3
"""Share by which numbers of µm that repeat those of mm deviate from doing so: a position is off by less."""
OTHER_UNITS = (
    (re.compile(r"(temp_\w+|air_temp)_c"), 200.0, 400.0, "°C", "kelvin"),
    (re.compile(r"air_pressure_hpa"), 50.0, 120.0, "hPa", "kPa"),
    (re.compile(r"air_pressure_hpa"), 5e4, 1.2e5, "hPa", "Pa"),
)
"""Columns, and the least and most of their mean that is no machine hall's in their own unit, but is in another one."""


def refuse_other_units(records: Records) -> None:
    """Raises InputError for positions that do not go with the targets, and for sensors that are logged in another unit.

    The file format allows them; a fit would put the difference into the table, or into an effect of some 290 K.
    """
    target = records.target_mm - np.mean(records.target_mm)
    spread = float(np.std(target))
    if spread and max(spread, float(np.std(records.measured_mm))) > FAR_MM:
        slope = float(target @ records.measured_mm) / float(target @ target)
        off = records.measured_mm - np.mean(records.measured_mm) - slope * target
        is_straight = float(np.std(off)) < STRAIGHT * spread * max(1.0, abs(slope))
        if is_straight and not MOVES_WITH[0] <= slope <= MOVES_WITH[1]:
            raise InputError(
                f"measured_mm changes by {slope:.3g} mm per mm of target_mm, expected about 1: it is in another unit, counts the other"
                " way or holds the error instead of the position"
            )
    for column, least, most, unit, other in OTHER_UNITS:
        for name in filter(column.fullmatch, records.columns):
            known = records[name][np.isfinite(records[name])]
            if len(known) and least <= float(np.mean(known)) <= most:
                raise InputError(f"{name} has a mean of {np.mean(known):.5g}, expected {unit}: it looks like {other}")


def repeats(position_mm: Floats, value_um: Floats) -> bool:
    """Whether values in µm are the numbers of the positions in mm, shape (n,) each: positions in place of errors."""
    off = value_um - position_mm - np.mean(value_um - position_mm)
    return bool(np.std(position_mm) > FAR_MM and np.std(off) < REPEATS * np.std(position_mm))


def read_csv(path: str | Path) -> Records:
    """Reads a record file. Raises InputError with file and line for an invalid row or header."""
    return parse_csv(read_text(path), path)


def parse_csv(text: str, path: str | Path = "records") -> Records:
    """Parses the text of a record file; `path` only names it in errors. Raises InputError as `read_csv`."""
    header, rows = parse_rows(text, path)
    if not rows:
        raise InputError("holds no rows under its header", path=path)
    table = np.array(rows, dtype=np.float64)
    return Records.of({name: table[:, column] for column, name in enumerate(header)})


def parse_rows(text: str, path: str | Path) -> tuple[list[str], list[list[float]]]:
    """The header and the cells of all rows but those that were withdrawn. Raises InputError as `read_csv`, not for a file
    without rows.
    """
    header: list[str] | None = None
    rows: list[list[float]] = []
    for number, line in enumerate(_LINE_END.split(text), start=1):
        if not is_row(line):
            _withdraw(line, rows, path, number)
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if header is None:
            header = _check_header(without_empty_end(cells), path, number)
        else:
            rows.append(_parse_row(without_empty_end(cells, len(header)), header, path, number))
    if header is None:
        raise InputError("holds no header row", path=path)
    return header, rows


def _withdraw(comment: str, rows: list[list[float]], path: str | Path, line: int) -> None:
    found = _WITHDRAWN.match(comment.lstrip())
    if found is None:
        return
    count = int(found[1])
    if count > len(rows):
        raise InputError(f"withdraws {count} rows, there are {len(rows)} above it", path=path, line=line)
    del rows[len(rows) - count :]


def _check_header(cells: list[str], path: str | Path, line: int) -> list[str]:
    missing = [name for name in REQUIRED if name not in cells]
    if missing:
        found = shown(",".join(cells))
        commas = not re.search(r"[;\t]", "".join(cells))
        expected = f"at least {','.join(REQUIRED)}" if commas else "commas (`hil import --format csv` reads others)"
        what = f"header {found} lacks {', '.join(missing)}; expected {expected}"
        raise InputError(what, path=path, line=line)
    seen: set[str] = set()
    for number, name in enumerate(cells, start=1):
        if not name:
            raise InputError(f"header has no name for column {number} of {len(cells)}", path=path, line=line)
        if not name.isprintable():
            raise InputError(f"header names column {number} {shown(name)}, expected a name", path=path, line=line)
        if name in seen:
            raise InputError(f"header names column {shown(name)} twice", path=path, line=line)
        seen.add(name)
    return cells


def _parse_row(cells: list[str], header: list[str], path: str | Path, line: int) -> list[float]:
    if len(cells) != len(header):
        raise InputError(f"row has {len(cells)} columns, expected {len(header)}", path=path, line=line)
    values: list[float] = []
    for name, cell in zip(header, cells, strict=True):
        if not cell and name not in REQUIRED:
            values.append(math.nan)
            continue
        value = parse_number(cell)
        if value is None or (name in REQUIRED and math.isnan(value)):
            raise InputError(f"{name} is {shown(cell)}, expected a number", path=path, line=line)
        if abs(value) > LARGEST:
            raise InputError(f"{name} is {shown(cell)}, expected at most ±{LARGEST:g}", path=path, line=line)
        if name == "direction" and value not in (1.0, -1.0):
            raise InputError(f"direction is {shown(cell)}, expected +1 or -1", path=path, line=line)
        if name == "run" and value != int(value):
            raise InputError(f"run is {shown(cell)}, expected a whole number", path=path, line=line)
        values.append(value)
    return values


def parse_number(cell: str) -> float | None:
    """The number in a cell, None for anything else; Python's own `1_000` and non-ASCII digits are not accepted."""
    if not cell.isascii() or "_" in cell:
        return None
    try:
        return float(cell)
    except ValueError:
        return None


def shown(cell: str) -> str:
    """A wrong cell for an error text, shortened when it is long."""
    return repr(cell) if len(cell) <= _SHOWN else repr(cell[:_SHOWN] + "…")


def format_row(values: Mapping[str, float], names: Iterable[str]) -> str:
    """One CSV line without its line end; floats read back to the same value, NaN is an empty cell."""
    return ",".join(_format_cell(name, values[name]) for name in names)


def _format_cell(name: str, value: float) -> str:
    if math.isnan(value):
        return ""
    if name == "run":
        return str(int(value))
    if name == "direction":
        return f"{int(value):+d}"
    return repr(float(value))


def to_csv(records: Records, comment: str = "") -> str:
    """The text of a record file with these rows."""
    out = io.StringIO()
    for line in comment.splitlines():
        out.write(f"# {line}\n")
    names = list(records.columns)
    out.write(",".join(names) + "\n")
    for row in range(len(records)):
        out.write(format_row({name: float(records[name][row]) for name in names}, names) + "\n")
    return out.getvalue()
