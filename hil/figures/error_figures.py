"""Summary figures of a pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers.errors import InputError
from hil.figures.iso230 import iso230
from hil.records.rows import Records


def rms(values: ArrayLike) -> float:
    """Root mean square, in the unit of the values."""
    return float(np.sqrt(np.mean(np.square(values))))


def error_figures(records: Records) -> dict[str, Any]:
    """RMS, mean and peak of the error as measured, and ISO 230-2 A, R, B and M where the rows allow them; µm."""
    error = records.error_um
    figures: dict[str, Any] = {
        "rows": len(records),
        "rms_um": rms(error),
        "mean_um": float(np.mean(error)),
        "peak_um": float(np.max(np.abs(error))),
    }
    try:
        iso = iso230(records)
    except InputError:
        return figures
    return {**figures, "A_um": iso.A, "R_um": iso.R, "B_um": iso.B, "M_um": iso.M}
