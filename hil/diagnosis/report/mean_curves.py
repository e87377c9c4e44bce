"""The mean of a residual along a column, in bins of its rows, with the band that holds the true mean in 95 of 100
cases.

Plotted by `left_over`. Rows are taken as independent: correlated noise makes the bands too narrow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from hil.records.rows import Floats

Index = np.ndarray[tuple[int, ...], np.dtype[np.intp]]

ROWS_PER_BIN = 12
MOST_BINS = 16
MOST_LEVELS = 10
"""Up to so many values, each with its neighbours within NEAR of the span, each is a bin of its own."""
NEAR = 0.05
BAND = 0.95
"""Confidence level of the band."""


@dataclass(frozen=True)
class MeanCurve:
    """label: of its rows; at: mean of the column in each bin, ascending; mean, low, high: of the residual, µm; rows in
    it; each (k,)

    levels: the bins are levels that were set, between which nothing was measured
    """

    label: str
    at: Floats
    mean_um: Floats
    low_um: Floats
    high_um: Floats
    rows: Floats
    levels: bool


def mean_curve(label: str, x: Floats, residual_um: Floats) -> MeanCurve:
    """The curve of rows, each array (n,), n ≥ 1. A bin of a single row has no band (low and high are NaN)."""
    level = _levels(x)
    levels = level is not None
    index = _bins(x) if level is None else level
    rows = np.bincount(index).astype(np.float64)
    at = np.bincount(index, weights=x) / rows
    mean = np.bincount(index, weights=residual_um) / rows
    square = np.bincount(index, weights=(residual_um - mean[index]) ** 2)
    dof = np.maximum(rows - 1, 1)
    half = scipy.special.stdtrit(dof, (1 + BAND) / 2) * np.sqrt(square / dof / rows)
    half[rows < 2] = np.nan
    return MeanCurve(label, at, mean, mean - half, mean + half, rows, levels)


def _levels(x: Floats) -> Index | None:
    """Level of each row, numbered upwards, shape (n,); None where the column does not keep to few levels."""
    order = np.argsort(x, kind="stable")
    span = float(np.ptp(x))
    rank = np.concatenate([[0], np.cumsum(np.diff(x[order]) > NEAR * span)])
    if rank[-1] >= MOST_LEVELS:
        return None
    index = np.empty(len(x), dtype=np.intp)
    index[order] = rank
    widths = [float(np.ptp(x[index == level])) for level in range(int(rank[-1]) + 1)]
    return index if max(widths) <= NEAR * span else None


def _bins(x: Floats) -> Index:
    """Bins of equal count as far as ties allow, numbered without gaps, shape (n,)."""
    count = int(np.clip(len(x) // ROWS_PER_BIN, 2, MOST_BINS))
    edges = np.unique(np.quantile(x, np.linspace(0, 1, count + 1)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    return np.unique(index, return_inverse=True)[1].reshape(-1)
