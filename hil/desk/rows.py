"""One look at an axis, and rows of a measurement as columns, for scripts: to CSV, pandas or Polars."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.records.rows import Floats, Records, to_csv


@dataclass(frozen=True)
class Rows:
    """Columns by name, each of shape (n,), as the record format names them."""

    columns: Mapping[str, Floats]

    @classmethod
    def of(cls, readings: Iterable[AxisReading], run: int = 1) -> Rows:
        """Rows of the readings with a position of the instrument, for `hil diagnose`. Raises InputError where none has one."""
        given = list(readings)
        if not given:
            raise InputError("there are no readings, expected one or more")
        rows = [one.row(run) for one in given if one.instrument_mm is not None]
        if not rows:
            raise InputError("no reading has a position of the instrument, expected home() before it")
        names = [name for name in rows[0] if all(name in row for row in rows)]
        return cls({name: np.array([row[name] for row in rows], dtype=np.float64) for name in names})

    @classmethod
    def from_lists(cls, **columns: Sequence[float]) -> Rows:
        """Rows of columns given by name, all of one length."""
        return cls({name: np.array(values, dtype=np.float64) for name, values in columns.items()})

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> Floats:
        return self.columns[name]

    def __iter__(self) -> Iterator[dict[str, float]]:
        for index in range(len(self)):
            yield {name: float(values[index]) for name, values in self.columns.items()}

    def __repr__(self) -> str:
        return f"<{len(self)} rows of {', '.join(self.columns)}>"

    def __add__(self, other: Rows) -> Rows:
        names = [name for name in self.columns if name in other.columns]
        return Rows({name: np.concatenate([self[name], other[name]]) for name in names})

    def save(self, path: str | Path) -> Path:
        """Write them as CSV in the record format. Raises InputError where a required column is missing."""
        replace_file(path, to_csv(Records.of(self.columns)).encode())
        return Path(path)

    def to_pandas(self) -> Any:
        """A pandas.DataFrame; pandas has to be installed."""
        return import_module("pandas").DataFrame(dict(self.columns))

    def to_polars(self) -> Any:
        """A polars.DataFrame; Polars has to be installed."""
        return import_module("polars").DataFrame(dict(self.columns))


@dataclass(frozen=True)
class AxisReading:
    """One look at the axis. What is not known is None, never a made-up zero.

    time_s: time since the axis was opened, or since its last job began
    motor_mm: the drive's actual position, mm of the load; instrument_mm: the load's position by the instrument, None before `home()`;
    instrument_raw_mm: as the instrument shows it
    std_um: standard deviation of one reading, if several were averaged
    target_mm, command_mm: target of the last `move_to`, without and with the correction; direction: of arrival there, +1, -1 or 0
    since_reversal_mm, stroke_mm: commanded travel since the last reversal, and length of the stroke before it, 1e6 before the first
    sensors: air, workpiece and conditions, by their columns in the record format
    """

    time_s: float
    state: str
    motor_mm: float
    instrument_mm: float | None = None
    instrument_raw_mm: float | None = None
    std_um: float | None = None
    velocity_mm_s: float | None = None
    torque_percent: float | None = None
    following_error_mm: float | None = None
    homed: bool | None = None
    fault_code: int | None = None
    target_mm: float | None = None
    command_mm: float | None = None
    direction: int = 0
    since_reversal_mm: float | None = None
    stroke_mm: float | None = None
    sensors: Mapping[str, float] = field(default_factory=dict)

    def row(self, run: int = 1) -> dict[str, float]:
        """A row of the record format. Raises InputError without a target or an instrument's position: call `home()` and `move_to()`
        first."""
        if self.instrument_mm is None or self.target_mm is None or self.command_mm is None:
            missing = "position of the instrument" if self.instrument_mm is None else "target"
            raise InputError(f"a reading has no {missing}, expected home() and move_to() before it")
        row = {"run": float(run), "direction": float(self.direction), "target_mm": self.target_mm}
        row |= {"measured_mm": self.instrument_mm, "command_mm": self.command_mm, "time_s": self.time_s}
        row |= {"motor_mm": self.motor_mm, **self.sensors}
        optional = ("since_reversal_mm", "stroke_mm", "torque_percent")
        return row | {name: value for name in optional if (value := getattr(self, name)) is not None}

    def __repr__(self) -> str:
        seen = "–" if self.instrument_mm is None else f"{self.instrument_mm:.5f} mm"
        return f"<{self.time_s:.2f} s: motor {self.motor_mm:.5f} mm, instrument {seen}, {self.state}>"
