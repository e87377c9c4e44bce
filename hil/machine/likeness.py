"""The measured errors of a real machine, from the folder of its campaigns, for a simulated one."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text
from hil.records.files import parse_json
from hil.records.journal import MARKER, read_purpose
from hil.records.rows import Records, read_csv
from sim_backends.likeness import Likeness
from sim_backends.plant.switches import SWITCHES

UNCORRECTED = "measure.csv"
"""Rows of the uncorrected axis in a campaign of `hil calibrate` or `hil close-loop`."""
DIAGNOSIS = "*diagnosis.json"
IN_THE_TABLE = ("backlash", "backlash_position", "pitch_shape")
"""Effects that the measured rows hold as they are."""


def read_likeness(folder: Path) -> Likeness:
    """The errors in the newest uncorrected rows of an axis's folder, and the effects of its newest diagnosis.

    Raises InputError for a folder without such rows.
    """
    rows = _newest(folder, UNCORRECTED)
    if rows is None:
        what = (
            f"holds no {UNCORRECTED} of hil calibrate or hil close-loop, which has the errors of the uncorrected axis"
        )
        raise InputError(what, path=folder)
    limits, scaling = _known(rows.parent)
    lead_mm = float(Fraction(scaling["feed_mm_per_shaft_rev"]) / Fraction(scaling["motor_revs_per_shaft_rev"]))
    plus, minus = (_mean_um(read_csv(rows), sign) for sign in (1, -1))
    both = [(place, (minus | plus)[place], (plus | minus)[place]) for place in sorted({*plus, *minus})]
    return Likeness(
        (limits["travel_min_mm"], limits["travel_max_mm"]),
        lead_mm,
        limits["max_velocity_mm_s"],
        limits["max_acceleration_mm_s2"],
        tuple((place, 0.5 * (up + down)) for place, up, down in both),
        tuple((place, down - up) for place, up, down in both),
        _effects(folder),
    )


def _newest(folder: Path, name: str) -> Path | None:
    found = [path for kind in ("calibrate", "close-loop") for path in folder.glob(f"{kind}-[0-9]*/{name}")]
    return max(found, key=lambda path: path.stat().st_mtime, default=None)


def _known(campaign: Path) -> tuple[dict[str, float], dict[str, str]]:
    """Limits and scaling of the axis, as the campaign noted them."""
    purpose = read_purpose(campaign)
    try:
        return {name: float(value) for name, value in purpose["limits"].items()}, dict(purpose["scaling"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("does not say the limits and the scaling of its axis", path=campaign / MARKER) from error


def _mean_um(rows: Records, sign: int) -> dict[float, float]:
    """Mean error of the uncorrected axis at each target that is approached in a direction, µm."""
    mine = rows.direction == sign
    targets, errors_um = rows.target_mm[mine], rows.uncorrected_error_um[mine]
    return {float(place): float(errors_um[targets == place].mean()) for place in np.unique(targets)}


def _effects(folder: Path) -> tuple[tuple[str, float], ...]:
    """The effects of the machine that the newest diagnosis found, each with its largest contribution, µm."""
    path = _newest(folder, DIAGNOSIS)
    if path is None:
        return ()
    try:
        findings: list[dict[str, Any]] = parse_json(read_text(path))["findings"]
        mine = [one for one in findings if one["action"] == "compensate" and one["effect"] not in IN_THE_TABLE]
        return tuple((one["effect"], float(one["peak_um"])) for one in mine if one["effect"] in SWITCHES)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("is no diagnosis with findings", path=path) from error
