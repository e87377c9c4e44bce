"""What of one campaign can age: values with their uncertainty, from its rows and from the results stored beside them.

Backlash is of the uncorrected axis, measured − command: a new table does not change it. The figures of ISO 230-2 are
of the axis as it works, measured − target.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text
from hil.axis.backlash import REVERSALS
from hil.backlash.result import Reversal, fitted_lost_motion
from hil.backlash.torque_fit import fit_wind_up
from hil.backlash.trace import read_trace
from hil.diagnosis.stored import STORED
from hil.figures.iso230 import TARGET_RESOLUTION_MM, Iso230, iso230
from hil.records.files import parse_json, split_lines
from hil.records.rows import Floats, Records


@dataclass(frozen=True)
class Quantity:
    """A value that ages. either: a fall is a change for the worse too; otherwise only growth is."""

    title: str
    unit: str
    either: bool = False


QUANTITIES: Mapping[str, Quantity] = {
    "backlash_um": Quantity("backlash", "µm"),
    "lost_motion_um": Quantity("lost motion", "µm"),
    "torque_lost_motion_um": Quantity("lost motion by torque", "µm"),
    "friction_torque_percent": Quantity("friction torque", "%", either=True),  # preload that is lost lowers it
    "A_um": Quantity("A", "µm"),
    "E_um": Quantity("E", "µm"),
    "R_um": Quantity("R", "µm"),
    "scale_ppm": Quantity("scale error", "ppm", either=True),
    "expansion_ppm_per_k": Quantity("expansion", "ppm/K", either=True),
    "drift_um_per_k": Quantity("drift with temperature", "µm/K", either=True),
}
AGEING = (
    "backlash_um",
    "lost_motion_um",
    "torque_lost_motion_um",
    "friction_torque_percent",
    "A_um",
    "expansion_ppm_per_k",
    "drift_um_per_k",
)
"""What is watched where nothing else is asked for."""
LEAST_KELVIN = 0.5
"""Least range of temperature over the runs of a pass from which a coefficient is computed; its uncertainty says what
it is worth."""
LEAST_RUNS = 4
"""Least number of runs of such a pass: a line through three has one degree of freedom."""
_COEFFICIENTS = {
    ("thermal_expansion", "coefficient_ppm_per_k"): "expansion_ppm_per_k",
    ("thermal_drift", "coefficient_um_per_k"): "drift_um_per_k",
}


@dataclass(frozen=True)
class FleetValue:
    """One value of one pass or result. std: standard uncertainty by its own repeats or fit, NaN for none; of: how
    many runs or reversals it is from; source: pass or file; temp_c: mean temperature, NaN for none"""

    quantity: str
    value: float
    std: float
    of: int
    source: str
    temp_c: float = math.nan


def of_pass(records: Records, source: str) -> list[FleetValue]:
    """The values of one pass; none of records that are no positioning test."""
    found = list(_friction(records, source))
    try:
        figures = iso230(records)
    except InputError:
        return found
    temp_c, place = _temperature(records)
    mean_c = math.nan if temp_c is None else float(np.nanmean(temp_c))
    runs, (as_works, own) = _by_run(records, (records.error_um, records.uncorrected_error_um))
    known = figures.figures()
    std_A = _without_one(as_works, _accuracy) if runs is not None else math.nan
    for name in ("A", "E", "R"):
        value = known[name]
        if value is not None:
            found.append(FleetValue(f"{name}_um", value, std_A if name == "A" else math.nan, figures.n, source, mean_c))
    if figures.B_mean is not None:
        found.append(_backlash(records, own, figures, source, mean_c))
    if runs is not None:
        found += _stretch(own, figures.target_mm, runs, records, place=place, source=source, mean_c=mean_c)
    return found


def _temperature(records: Records) -> tuple[Floats | None, str]:
    """Temperature of the part of the axis that changes most, shape (n,), and its column; None, "" without one."""
    places = [name for name in records.columns if name.startswith("temp_") and name.endswith("_c")]
    places = [name for name in places if np.any(np.isfinite(records[name]))]
    if not places:
        return None, ""
    place = max(places, key=lambda name: float(np.nanmax(records[name]) - np.nanmin(records[name])))
    return records[place], place


def _by_run(records: Records, errors_um: Sequence[Floats]) -> tuple[Floats | None, list[dict[int, Floats]]]:
    """Run numbers, shape (n,), and of each error a matrix of shape (m, n) per direction; None where the runs are not
    alike."""
    key = np.round(records.target_mm / TARGET_RESOLUTION_MM)
    matrices: list[dict[int, Floats]] = [{} for _ in errors_um]
    runs: Floats | None = None
    for sign in (1, -1):
        here = np.flatnonzero(records.direction == sign)
        if not len(here):
            continue
        order = here[np.lexsort((records.run[here], key[here]))]
        m = len(np.unique(key[here]))
        table = records.run[order].reshape(m, -1)
        if np.any(table != table[0]) or (runs is not None and not np.array_equal(runs, table[0])):
            return None, matrices
        runs = table[0]
        for matrix, error_um in zip(matrices, errors_um, strict=True):
            matrix[sign] = error_um[order].reshape(m, -1)
    return runs, matrices


def _accuracy(errors_um: Mapping[int, Floats]) -> float:
    """A of ISO 230-2:2014, 3.21, of errors of shape (m, n) per direction."""
    ends = [(one.mean(axis=1), 2.0 * one.std(axis=1, ddof=1)) for one in errors_um.values()]
    return max(float((x + s).max()) for x, s in ends) - min(float((x - s).min()) for x, s in ends)


def _without_one(errors_um: Mapping[int, Floats], figure: Any) -> float:
    """Standard uncertainty of a figure by leaving out one run at a time (jackknife), NaN of fewer than three runs."""
    n = next(iter(errors_um.values())).shape[1] if errors_um else 0
    if n < 3:
        return math.nan
    left = np.array([figure({sign: np.delete(one, at, axis=1) for sign, one in errors_um.items()}) for at in range(n)])
    return math.sqrt((n - 1) / n * float(np.sum((left - left.mean()) ** 2)))


def _backlash(records: Records, own: Mapping[int, Floats], figures: Iso230, source: str, mean_c: float) -> FleetValue:
    """Mean reversal value of the uncorrected axis, positive where motion is lost (−B̄ of measured − command), by the
    runs' own values."""
    if len(own) == 2:
        each_um = -(own[1] - own[-1]).mean(axis=0)
        n = len(each_um)
        std = float(each_um.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
        return FleetValue("backlash_um", float(each_um.mean()), std, n, source, mean_c)
    error_um, up = records.uncorrected_error_um, records.direction > 0
    key = np.round(records.target_mm / TARGET_RESOLUTION_MM)
    ways = [error_um[up & (key == one)].mean() - error_um[~up & (key == one)].mean() for one in np.unique(key)]
    return FleetValue("backlash_um", -float(np.mean(ways)), math.nan, figures.n, source, mean_c)


def _stretch(
    own: Mapping[int, Floats],
    target_mm: Floats,
    runs: Floats,
    records: Records,
    *,
    place: str,
    source: str,
    mean_c: float,
) -> Iterator[FleetValue]:
    """The scale error, and how it follows the temperature from run to run."""
    error_um = np.asarray(sum(own.values())) / len(own)
    away_m = (target_mm - target_mm.mean()) / 1000.0
    scale_ppm = away_m @ error_um / float(away_m @ away_m)
    n = len(runs)
    std = float(scale_ppm.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
    yield FleetValue("scale_ppm", float(scale_ppm.mean()), std, n, source, mean_c)
    if not place or n < LEAST_RUNS:
        return
    with_temp = [records[place][records.run == run] for run in runs]
    if not all(np.any(np.isfinite(one)) for one in with_temp):
        return
    temp_c = np.array([float(np.nanmean(one)) for one in with_temp])
    if float(np.ptp(temp_c)) < LEAST_KELVIN:
        return
    away_k = temp_c - temp_c.mean()
    total = float(away_k @ away_k)
    slope = float(away_k @ scale_ppm) / total
    left = scale_ppm - scale_ppm.mean() - slope * away_k
    std = math.sqrt(float(left @ left) / (n - 2) / total)
    yield FleetValue("expansion_ppm_per_k", slope, std, n, source, mean_c)


def _friction(records: Records, source: str) -> Iterator[FleetValue]:
    """Half the difference of the torques in both directions, of rows in motion, by runs: the weight of a vertical
    axis cancels."""
    if "torque_percent" not in records or "velocity_mm_s" not in records:
        return
    moving = (np.abs(np.nan_to_num(records["velocity_mm_s"])) > 0.0) & np.isfinite(records["torque_percent"])
    each = []
    for run in np.unique(records.run[moving]):
        here = moving & (records.run == run)
        up, down = (records["torque_percent"][here & (records.direction == sign)] for sign in (1.0, -1.0))
        if len(up) and len(down):
            each.append(float(up.mean() - down.mean()) / 2.0)
    if each:
        std = float(np.std(each, ddof=1)) / math.sqrt(len(each)) if len(each) > 1 else math.nan
        yield FleetValue("friction_torque_percent", float(np.mean(each)), std, len(each), source)


# -- stored results ----------------------------------------------------------------------------------------------------
RESULT = "result.json"
"""Result of a measurement of lost motion, beside its rows."""


def is_result(name: str) -> bool:
    """Whether a file of a campaign holds results that are read."""
    return name == RESULT or name.endswith(STORED)


def of_result(path: Path) -> list[FleetValue]:
    """The values of a stored result. Raises InputError for a file that holds none."""
    try:
        form = parse_json(read_text(path))
    except ValueError as error:
        raise InputError("is not JSON", path=path) from error
    if not isinstance(form, dict):
        raise InputError("holds no result, expected a JSON object", path=path)
    if path.name == RESULT:
        value = _estimate(form.get("parameters"), "amount_um")
        if value is None:
            raise InputError("holds no lost motion, expected parameters.amount_um", path=path)
        reversals = form.get("reversals")
        count = len(reversals) if isinstance(reversals, list) else 0
        return [FleetValue("lost_motion_um", *value, count, path.name)]
    found = []
    findings = form.get("findings")
    if not isinstance(findings, list):
        raise InputError("holds no diagnosis, expected findings", path=path)
    for one in findings:
        for (effect, parameter), quantity in _COEFFICIENTS.items():
            if isinstance(one, dict) and one.get("effect") == effect:
                value = _estimate(one.get("parameters"), parameter)
                found += [] if value is None else [FleetValue(quantity, *value, 1, path.name)]
    return found


def _estimate(parameters: object, name: str) -> tuple[float, float] | None:
    form = parameters.get(name) if isinstance(parameters, dict) else None
    if not isinstance(form, dict):
        return None
    value, std = form.get("value"), form.get("std")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    known = isinstance(std, int | float) and not isinstance(std, bool) and std > 0.0
    return float(value), float(std) if known and std is not None else math.nan


TORQUE_FILE = re.compile(r"backlash-\d+\.jsonl")
"""Name of a file with the reversals of one measurement by torque, which lies beside campaigns."""


@dataclass(frozen=True)
class TorqueFile:
    """A measurement by torque. axis, begun: as it states them, "" where it is from before that was stated"""

    values: list[FleetValue]
    axis: str
    begun: str


def of_torque_file(path: Path) -> TorqueFile:
    """Lost motion and friction torque of a measurement by torque. Raises InputError naming the line that cannot be
    read."""
    reversals: list[Reversal] = []
    axis = begun = ""
    asked = "both"
    text = read_text(path)
    lines = split_lines(text)
    whole = lines if text.endswith("\n") else lines[:-1]  # a line torn by a power cut was never confirmed
    for number, line in enumerate(whole, start=1):
        try:
            form = parse_json(line)
        except ValueError as error:
            raise InputError("is not JSON", path=path, line=number) from error
        if not isinstance(form, dict):
            raise InputError("holds no reversal", path=path, line=number)
        try:
            trace = read_trace(form)
        except InputError as error:
            raise InputError(error.what, path=path, line=number) from error
        run = form.get("run")
        reversals.append(Reversal(run if isinstance(run, int) else 0, trace, None, fit_wind_up(trace)))
        asked = str(form.get("reversals", asked))
        axis, begun = axis or str(form.get("axis", "")), begun or str(form.get("begun", ""))
    values = []
    lost = fitted_lost_motion(reversals, REVERSALS.get(asked, REVERSALS["both"]))
    if lost is not None:
        values.append(FleetValue("torque_lost_motion_um", lost.mean_um, lost.u95_um / 1.96, len(reversals), path.name))
    levels = np.array([one.fitted.level_percent for one in reversals if one.fitted is not None])
    if len(levels):
        std = float(levels.std(ddof=1)) / math.sqrt(len(levels)) if len(levels) > 1 else math.nan
        values.append(FleetValue("friction_torque_percent", float(levels.mean()), std, len(levels), path.name))
    return TorqueFile(values, axis, begun)
