"""Summary figures of a pass."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.figures.iso230 import iso230
from hil.records.rows import Records


def error_figures(records: Records) -> dict[str, Any]:
    """RMS, mean and peak of the error as measured, and ISO 230-2 A, R, B and M where the rows allow them; µm."""
    error = records.error_um
    figures: dict[str, Any] = {
        "rows": len(records),
        "rms_um": float(np.sqrt(np.mean(error**2))),
        "mean_um": float(np.mean(error)),
        "peak_um": float(np.max(np.abs(error))),
    }
    try:
        iso = iso230(records)
    except InputError:
        return figures
    return {**figures, "A_um": iso.A, "R_um": iso.R, "B_um": iso.B, "M_um": iso.M}
