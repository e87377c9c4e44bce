"""Data of a finding's drawing: the column, the residual along it, and the curve over the residual. No drawing and no HTML here.

Residual and effect come from the finding's own `plot` where it has one, else from columns of the diagnosed records (`residual_um`;
`effect_<id>_um`, or `effect_um` for a single finding). Where neither holds the effect, the curve is the residual's mean along the
column.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.effects import Estimate
from hil.records.rows import Floats, Records
from hil.ui.report.data import NamedCampaign, history
from hil.ui.report.markup import plain

_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "thermal_expansion": ("temp_", "time_s"),
    "thermal_drift": ("temp_", "time_s"),
    "lost_motion": ("since_reversal_mm",),
    "velocity_lag": ("velocity_mm_s",),
    "load_deflection": ("load_kg", "torque_percent"),
    "abbe": ("pitch_urad", "yaw_urad"),
    "cross_axis": ("pos_",),
    "datum_step": ("time_s",),
    "beam_drift": ("time_s",),
    "dead_path": ("air_temp_c", "air_pressure_hpa"),
    "air_index": ("air_temp_c", "air_pressure_hpa"),
}
"""Effect -> columns, or beginnings of their names: it is drawn along the first that varies. Others: along the position."""

_WITHOUT_OTHERS = "Residual without the other effects found"
LARGEST = 1e12
"""Largest number that is drawn; a larger one in a diagnosis counts as missing."""


@dataclass(frozen=True)
class ResidualView:
    """A residual along one column, and the curve over it; arrays of one shape (n,). label: of the x axis; over: name of the
    curve; of: of what it is the residual."""

    x: Floats
    label: str
    direction: Floats
    residual_um: Floats
    over_um: Floats
    over: str
    of: str = "Residual"


def with_residual(campaign: NamedCampaign, diagnosis: Mapping[str, Any]) -> NamedCampaign:
    """The campaign with `residual_um` and `explained_um` of its diagnosis as columns, each where it has one number per row."""
    records = campaign.records
    for name in ("residual_um", "explained_um"):
        values = _floats(diagnosis.get(name))
        if values is not None and len(values) == len(records):
            records = records.with_column(name, values)
    return replace(campaign, records=records)


def position_view(records: Records, findings: list[Mapping[str, Any]]) -> ResidualView:
    """The residual along the position, with what the effects found take away from it; where that is not known per row, with the sum of
    the effects, or with its own mean."""
    residual = _residual(records)
    if findings and "explained_um" in records:
        taken = "what the effects found take away"
        return ResidualView(
            records.target_mm, "Target position, mm", records.direction, residual, records["explained_um"], taken
        )
    effects = [
        over for finding in findings if (over := _effect(records, finding, alone=len(findings) == 1)) is not None
    ]
    if effects and len(effects) == len(findings):
        over, name = np.asarray(np.sum(effects, axis=0), dtype=np.float64), "effects found"
    else:
        over, name = _mean_along(records.target_mm, residual, records.direction), "mean along the position"
    return ResidualView(records.target_mm, "Target position, mm", records.direction, residual, over, name)


def finding_view(finding: Mapping[str, Any], diagnosed: NamedCampaign | None, *, alone: bool) -> ResidualView | None:
    """The drawing of a finding; None where `position_view` shows it, or without data to draw. alone: whether it is the only one."""
    records = None if diagnosed is None else diagnosed.records
    own = _own_plot(finding, records)
    if own is not None or records is None:
        return own
    along = _along(finding, records)
    if along is None:
        return None
    residual, effect = _residual(records), _effect(records, finding, alone=alone)
    if effect is not None:
        return ResidualView(*along, records.direction, residual, effect, plain(finding.get("effect")))
    mean = _mean_along(along[0], residual, records.direction)
    return ResidualView(*along, records.direction, residual, mean, "mean along this column")


def _own_plot(finding: Mapping[str, Any], records: Records | None) -> ResidualView | None:
    """The finding's own `plot`, None where it has none or one that cannot be drawn."""
    plot = finding.get("plot")
    if not isinstance(plot, Mapping):
        return None
    x, residual, effect = (_floats(plot.get(name)) for name in ("x", "residual_um", "effect_um"))
    if x is None or residual is None or effect is None or not len(x) == len(residual) == len(effect):
        return None
    direction = _floats(plot.get("direction"))
    if direction is None and records is not None and len(records) == len(x):
        direction = records.direction
    if direction is None or len(direction) != len(x):
        direction = np.ones(len(x))
    column = plain(plot.get("column", "x"))
    folded = _folded(x, finding) if column == "target_mm" else None
    if folded is not None:
        return ResidualView(*folded, direction, residual, effect, plain(finding.get("effect")), _WITHOUT_OTHERS)
    label = label_of(column, plot.get("unit"))
    return ResidualView(x, label, direction, residual, effect, plain(finding.get("effect")), _WITHOUT_OTHERS)


def _floats(values: object) -> Floats | None:
    """A JSON list of finite numbers as an array, shape (n,); None for anything else, and for an empty list."""
    numbers = [value_of(value, "value") for value in list_of(values)]
    known = [value for value in numbers if value is not None]
    return np.asarray(known, dtype=np.float64) if known and len(known) == len(numbers) else None


def _residual(records: Records) -> Floats:
    return records.columns.get("residual_um", records.error_um)


def _effect(records: Records, finding: Mapping[str, Any], *, alone: bool) -> Floats | None:
    """The effect on each row, µm, shape (n,), by a column, or by the finding's own plot where that is of the same rows; else None."""
    for name in (f"effect_{finding.get('effect')}_um", *(["effect_um"] if alone else [])):
        if name in records and np.all(np.isfinite(records[name])):
            return records[name]
    plot = finding.get("plot")
    own = _floats(plot.get("effect_um")) if isinstance(plot, Mapping) else None
    return own if own is not None and len(own) == len(records) else None


def _mean_along(x: Floats, residual: Floats, direction: Floats) -> Floats:
    over = np.empty(len(x))
    for sign in (1.0, -1.0):
        here = direction == sign
        if np.any(here):
            over[here] = binned_mean(x[here], residual[here])
    return over


def _along(finding: Mapping[str, Any], records: Records) -> tuple[Floats, str] | None:
    """The values, shape (n,), and the label of the x axis for an effect; None for one that is drawn along the position."""
    effect = plain(finding.get("effect"))
    if effect == "cyclic":
        return _folded(records.target_mm, finding)
    for wanted in _COLUMNS.get(effect, ()):
        for name in records.columns:
            if (name == wanted or (wanted.endswith("_") and name.startswith(wanted))) and _varies(records[name]):
                return (
                    (records[name] - records[name].min(), "Time, s")
                    if name == "time_s"
                    else (records[name], label_of(name))
                )
    if "time_s" in _COLUMNS.get(effect, ()):
        return history(records).x, "Row (the records hold no time)"
    return None


def _folded(x_mm: Floats, finding: Mapping[str, Any]) -> tuple[Floats, str] | None:
    """Positions within one period of a cyclic effect, mm, and the label; None for another effect."""
    period = value_of(object_of(finding.get("parameters")).get("period_mm"), "value")
    if finding.get("effect") != "cyclic" or not period or period <= 0:
        return None
    return np.mod(x_mm, period), f"Position within one period of {period:.4g} mm, mm"


BINS = 24


def binned_mean(x: Floats, y: Floats) -> Floats:
    """For each row the mean of y over the rows of its bin, shape (n,). Bins have equal numbers of rows; equal x are in one bin."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    total = np.bincount(index, weights=y)
    return np.asarray((total / np.maximum(np.bincount(index), 1))[index], dtype=np.float64)


def _varies(values: Floats) -> bool:
    return bool(np.all(np.isfinite(values)) and np.ptp(values) > 0)


UNITS = {
    "_um_s2_per_mm2": "µm·s²/mm²", "_um_per_percent": "µm/%", "_um_per_kg": "µm/kg", "_um_per_m2": "µm/m²", "_um_per_m": "µm/m",
    "_um_per_mm": "µm/mm", "_um_per_k": "µm/K", "_um_per_c": "µm/°C", "_ppm_per_k": "ppm/K", "_ppm_k": "ppm/K", "_ppm": "ppm",
    "_mm_s": "mm/s", "_mm": "mm", "_um": "µm", "_urad": "µrad", "_rad": "rad", "_deg": "°", "_ms": "ms", "_s": "s", "_c": "°C",
    "_hpa": "hPa", "_percent": "%", "_kg": "kg", "_rows": "rows",
}  # fmt: skip
"""Unit by the end of the name of a column or of an effect's parameter; the longest end decides."""


def with_unit(name: str) -> tuple[str, str]:
    """A name without its unit, and the unit, "" for none and for a quotient that is not in `UNITS`, which keeps its whole name."""
    if name == "phase":
        return name, "rad"
    ending = max((one for one in UNITS if name.endswith(one)), key=len, default="")
    stem = name.removesuffix(ending) or name
    return (name, "") if stem.endswith("_per") else (stem, UNITS.get(ending, ""))


def label_of(column: str, unit: object = None) -> str:
    """A column's name as an axis label: `temp_screw_c` is 'Temp screw, °C'. unit: in place of the one that the name ends in."""
    stem, stated = with_unit(plain(column))
    stated = plain(unit) if unit else stated
    name = stem.replace("_", " ").capitalize() or "X"
    return f"{name}, {stated}" if stated else name


def value_of(holder: object, key: str) -> float | None:
    """A finite number by its key in a JSON object; with the key "value" also a plain number. None for anything else."""
    value = holder.get(key) if isinstance(holder, Mapping) else holder if key == "value" else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return float(value) if abs(value) <= LARGEST else None


def estimate_of(form: object) -> Estimate | None:
    """A parameter of a finding, with its interval where the result has one (older ones do not); None for a bound or anything else."""
    value, std, low, high = (value_of(form, name) for name in ("value", "std", "low", "high"))
    if value is None or not std:
        return None
    return Estimate(value, std, None if low is None or high is None else (low, high))


def object_of(value: object) -> Mapping[str, Any]:
    """A JSON object, or an empty one for anything else."""
    return value if isinstance(value, Mapping) else {}


def list_of(value: object) -> list[Any]:
    """A JSON list, or an empty one for anything else."""
    return value if isinstance(value, list) else []


def objects_of(value: object) -> list[Mapping[str, Any]]:
    return [one for one in list_of(value) if isinstance(one, Mapping)]
