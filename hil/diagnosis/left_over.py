"""What a diagnosis leaves, row by row, beside the columns that may say something of it: for whoever draws it.

What may go in: the choice of rows and columns, and plain values; no statistics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hil.diagnosis.result import Diagnosis
from hil.effects.history import time_column
from hil.effects.survey import varies
from hil.records.rows import Floats

MOST_ROWS = 2000
"""Of longer records every so manieth row: a mean curve and a spectrum are as good with these."""
DECIMALS = 4


def left_over(diagnosis: Diagnosis, columns: Mapping[str, Floats]) -> dict[str, Any]:
    """{"left_um": [...], "columns": {name: [...]}, "every": 1}: what the extended model leaves of each (or every so manieth) row.

    columns: of the rows that were diagnosed, with those of the past, each (n,). Beside `run`: position, direction, time, velocity,
    travel since the reversal and the columns that carry what is unexplained, as far as they are there and vary.
    """
    every = -(-len(diagnosis.residual_um) // MOST_ROWS)
    shown = {name: columns[name] for name in ("run", *_wanted(diagnosis, columns))}
    return {
        "every": every,
        "left_um": _plain(diagnosis.residual_um[::every]),
        "columns": {name: _plain(values[::every]) for name, values in shown.items()},
    }


def _wanted(diagnosis: Diagnosis, columns: Mapping[str, Floats]) -> Iterator[str]:
    usual = ("target_mm", "direction", time_column(columns), "velocity_mm_s", "since_reversal_mm")
    carriers = [name for carrier in diagnosis.carriers for name in carrier.columns]
    for name in dict.fromkeys((*usual, *carriers)):
        if name in columns and varies(columns[name]):
            yield name


def _plain(values: Floats) -> list[float]:
    return [float(value) for value in np.round(values, DECIMALS)]
