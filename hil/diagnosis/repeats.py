"""Pure error: what differs between rows that nothing set apart, with its degrees of freedom. No model enters but the effects that
were found, so that no cause can hide in it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hil.diagnosis.campaign import Floats, Ints
from hil.effects import Estimate
from hil.effects.history import time_column

SAME_TARGET_MM, SAME_PART = 1e-3, 1e-4
"""Targets nearer than this, and than that part of the travel, are one: no error of a machine changes by more than its noise over a
µm."""
SAME_SHARE = 1e-3
"""Relative difference within which a set condition is the same."""
LEAST_DOF = 5
"""Degrees of freedom from which a noise floor is stated: its standard deviation is then a third of it."""
WITHIN_S, WITHIN_ROWS = 30.0, 10.0
"""Time between repeats in which nothing warms up, s; the same in rows where no time was recorded."""
SET = re.compile(r"velocity_mm_s|load_kg|abbe_offset_mm|pos_\w+_mm")
"""Conditions that are set, not sensed."""


@dataclass(frozen=True)
class PureError:
    """Standard deviation of true repeats, µm, with its uncertainty, its degrees of freedom, which repeats they are, and their rows."""

    std_um: Estimate
    dof: int
    how: str
    rows: Ints = field(compare=False, repr=False)


def pure_error(columns: Mapping[str, Floats], error_um: Floats) -> PureError | None:
    """From completed columns, each (n,), and errors without the effects that were found, µm, (n,); None without repeats.

    Repeats within seconds come first. Where there are none, runs that repeat one another are taken in pairs, about the mean
    difference of each pass.
    """
    cell = _cells(columns)
    for squares, dof, how, rows in (
        _within_seconds(columns, cell, error_um),
        _in_pairs(columns, cell, error_um),
    ):
        if dof >= LEAST_DOF:
            std = math.sqrt(squares / dof)
            return PureError(Estimate(std, std / math.sqrt(2 * dof)), dof, how, rows)
    return None


def _cells(columns: Mapping[str, Floats]) -> Ints:
    """A number for each direction, target and set of conditions, (n,)."""
    apart_mm = min(SAME_TARGET_MM, SAME_PART * float(np.ptp(columns["target_mm"]))) or SAME_TARGET_MM
    keys = [columns["direction"], np.round(columns["target_mm"] / apart_mm)]
    for name in sorted(columns):
        values = columns[name]
        if SET.fullmatch(name) and np.all(np.isfinite(values)):
            keys.append(np.round(values / max(SAME_SHARE * float(np.max(np.abs(values))), 1e-9)) + 0.0)  # one zero
    return np.asarray(np.unique(np.column_stack(keys), axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def _within_seconds(columns: Mapping[str, Floats], cell: Ints, error_um: Floats) -> tuple[float, int, str, Ints]:
    """Sum of squares about the mean of each group of repeats, its degrees of freedom, and their rows."""
    time = columns[time_column(columns)]
    within = WITHIN_S if time_column(columns) == "time_s" else WITHIN_ROWS
    order = np.lexsort((np.arange(len(cell)), cell))
    new = np.ones(len(cell), dtype=np.bool_)
    new[1:] = (np.diff(cell[order]) != 0) | (np.diff(columns["run"][order]) != 0) | (np.diff(time[order]) > within)
    group = np.cumsum(new) - 1
    count = np.bincount(group)
    y = error_um[order]
    mean = np.bincount(group, weights=y) / count
    squares = float(np.sum((y - mean[group]) ** 2))
    return squares, int(np.sum(count - 1)), "repeats within seconds", order[count[group] > 1]


def _in_pairs(columns: Mapping[str, Floats], cell: Ints, error_um: Floats) -> tuple[float, int, str, Ints]:
    """The same from runs two by two, each once: half the squared differences about the mean of each direction."""
    squares, dof = 0.0, 0
    rows: list[Ints] = []
    run, direction = columns["run"], columns["direction"]
    numbers = np.unique(run)
    for first, second in zip(numbers[:-1:2], numbers[1::2], strict=False):
        for sign in (1.0, -1.0):
            a, b = (np.flatnonzero((run == number) & (direction == sign)) for number in (first, second))
            _, i, j = np.intersect1d(cell[a], cell[b], return_indices=True)
            if len(i) < 2:
                continue
            apart = error_um[b[j]] - error_um[a[i]]
            squares += float(np.sum((apart - np.mean(apart)) ** 2)) / 2.0
            dof += len(i) - 1
            rows += [a[i], b[j]]
    return squares, dof, "runs in pairs", np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
