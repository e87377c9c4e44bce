"""Rows of a measurement as columns, for scripts: to CSV, pandas or Polars."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.desk.reading import AxisReading
from hil.records.rows import Floats, Records, to_csv


@dataclass(frozen=True)
class Rows:
    """Columns by name, each of shape (n,), as the record format names them."""

    columns: Mapping[str, Floats]

    @classmethod
    def of(cls, readings: Iterable[AxisReading], run: int = 1) -> Rows:
        """Rows of the readings with a position of the instrument, for `hil diagnose`. Raises InputError where none has one."""
        rows = [one.row(run) for one in readings if one.instrument_mm is not None]
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
