"""The plot data of a diagnosis: for each finding, the residual and the effect over the column it follows; the residuals
of both models.

Added to the JSON form of a diagnosis, so that a later report draws the same plots.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.diagnosis.campaign import columns_of
from hil.diagnosis.result import Diagnosis
from hil.effects.history import time_column
from hil.effects.survey import varies
from hil.records.rows import Floats, Records

MOST_ROWS = 2000
"""Longer records are thinned evenly: mean curves and spectra do not need more."""
DECIMALS = 4


def left_over(diagnosis: Diagnosis, columns: Mapping[str, Floats]) -> dict[str, Any]:
    """{"left_um": [...], "columns": {name: [...]}, "every": k}: the extended model's residual of every k-th row.

    columns: of the diagnosed rows, completed, each (n,). Besides `run`: position, direction, time, velocity, travel
    since the reversal, and the columns that the unexplained part follows, as far as they are there and vary.
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


MOST_POINTS = 4000
"""Most points of a plot; longer records are thinned evenly."""
NM = 3
"""Decimals of a value in µm."""


def with_plots(form: Mapping[str, Any], diagnosis: Diagnosis, records: Records) -> dict[str, Any]:
    """The form with a `plot` in each finding, `left` (`left_over`), and `residual_um`: the declared model's held-out
    residual of each row, and `explained_um`: what of it the extended model takes away, so that the figures "after" are of the
    difference.

    records: those that were diagnosed. Records longer than a plot have neither.
    """
    columns = columns_of(records)
    shown = np.arange(0, len(records), -(-len(records) // MOST_POINTS))
    findings = []
    for finding, plain in zip(diagnosis.findings, form["findings"], strict=True):
        effect_um = np.sum([term.error_um(columns) for term in finding.terms], axis=0)
        effect_um = effect_um - np.mean(effect_um)
        name = _column(finding.term.needs, columns)
        plot = {
            "column": name,
            "unit": _unit(name),
            "x": columns[name][shown].tolist(),
            "direction": records.direction[shown].astype(int).tolist(),
            "residual_um": _rounded(diagnosis.residual_um + effect_um, shown),
            "effect_um": _rounded(effect_um, shown),
        }
        findings.append({**plain, "plot": plot})
    whole = {}
    if len(shown) == len(records):
        explained_um = diagnosis.before_um - diagnosis.after_um
        whole = {"residual_um": _rounded(diagnosis.before_um, shown), "explained_um": _rounded(explained_um, shown)}
    return {**form, "findings": findings, "left": left_over(diagnosis, columns), **whole}


def _column(needs: Sequence[str], columns: Mapping[str, Floats]) -> str:
    """The column of the plot: the first that the effect reads beyond position and direction, else the position."""
    for name in needs:
        if name not in ("target_mm", "direction") and name in columns:
            return name
    return "target_mm"


def _unit(column: str) -> str:
    for ending, unit in (("_mm_s", "mm/s"), ("_mm", "mm"), ("_c", "°C"), ("_s", "s"), ("_kg", "kg"), ("_percent", "%")):
        if column.endswith(ending):
            return unit
    return ""


def _rounded(values: Floats, shown: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> list[float]:
    return [float(value) for value in np.round(values[shown], NM)]
