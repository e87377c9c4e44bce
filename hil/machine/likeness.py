"""The measured errors of a real machine, from the folder of its campaigns, for a simulated one."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text
from hil.records.files import parse_json
from hil.records.journal import DISCARDED, FINISHED, MARKER, read_purpose
from hil.records.rows import Records, read_csv
from sim_backends.likeness import Likeness
from sim_backends.plant.switches import SWITCHES

UNCORRECTED = "measure.csv"
"""Rows of the uncorrected axis in a campaign of `hil calibrate` or `hil close-loop`."""
DIAGNOSIS = "*diagnosis.json"
IN_THE_TABLE = ("backlash", "backlash_position", "pitch_shape")
"""Effects that the measured rows hold as they are."""


def read_likeness(folder: Path) -> Likeness:
    """The errors in the newest uncorrected rows of an axis's folder, and the effects of its newest diagnoses.

    Of finished campaigns that were not discarded and not made on a likeness themselves, at the targets approached from both sides.
    Raises InputError for a folder without such rows.
    """
    campaigns = [one for kind in ("calibrate", "close-loop") for one in folder.glob(f"{kind}-[0-9]*") if _counts(one)]
    rows = _newest(campaigns, UNCORRECTED)
    if rows is None:
        what = f"holds no {UNCORRECTED} of a finished hil calibrate or hil close-loop, which has the errors of the uncorrected axis"
        raise InputError(what, path=folder)
    limits, scaling = _known(rows.parent)
    lead_mm = float(Fraction(scaling["feed_mm_per_shaft_rev"]) / Fraction(scaling["motor_revs_per_shaft_rev"]))
    plus, minus = (_mean_um(read_csv(rows), sign) for sign in (1, -1))
    both = [(place, plus[place], minus[place]) for place in sorted({*plus} & {*minus})]
    if not both:
        raise InputError("has no target approached from both sides: the reversal error is not known", path=rows)
    return Likeness(
        (limits["travel_min_mm"], limits["travel_max_mm"]),
        lead_mm,
        limits["max_velocity_mm_s"],
        limits["max_acceleration_mm_s2"],
        tuple((place, 0.5 * (up + down)) for place, up, down in both),
        tuple((place, down - up) for place, up, down in both),
        _effects(_newest(campaigns, DIAGNOSIS)),
    )


def _counts(campaign: Path) -> bool:
    """Whether the campaign is complete and of the machine itself, not of a likeness of one."""
    if not (campaign / FINISHED).exists() or (campaign / DISCARDED).exists():
        return False
    drive = read_purpose(campaign).get("drive")
    return not (isinstance(drive, dict) and "like" in drive)


def _newest(campaigns: Sequence[Path], name: str) -> Path | None:
    found = [path for campaign in campaigns for path in campaign.glob(name)]
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


def _effects(newest: Path | None) -> tuple[tuple[str, float], ...]:
    """The effects of the machine that the diagnoses of one campaign found, each with its largest contribution, µm.

    A diagnosis in motion names only what the one at rest before it did not find. newest: a diagnosis of that campaign.
    """
    sizes_um: dict[str, float] = {}
    for path in [] if newest is None else sorted(newest.parent.glob(DIAGNOSIS)):
        try:
            findings: list[dict[str, Any]] = parse_json(read_text(path))["findings"]
            for one in findings:
                name = one["effect"]
                if one["action"] == "compensate" and name in SWITCHES and name not in IN_THE_TABLE:
                    sizes_um[name] = max(sizes_um.get(name, 0.0), float(one["peak_um"]))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("is no diagnosis with findings", path=path) from error
    return tuple(sizes_um.items())
