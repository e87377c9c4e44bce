"""Causes through a quantity that was not recorded: set anew for each run, or drifting with time, times what physics makes of it along
the travel and with the direction. Each is a random part with an evidence of its own, and a rival of what was found.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np

from hil.diagnosis.campaign import CampaignRows, Floats
from hil.diagnosis.model.evidence import Fit
from hil.diagnosis.model.policy import USUAL
from hil.effects.history import time_column
from hil.effects.survey import OTHER_AXIS

WAVES = np.arange(1.0, 9.0)
"""Half periods over the campaign of a course that drifts."""
SET, DRIFTING = "set for each run", "drifting"
UNKNOWN = math.log(2.0)
"""Log odds against such a cause: the quantity changed during the campaign, or did not, with even odds."""
OFFSET, ALONG, REVERSAL, REVERSAL_ALONG, ABOUT_A_POINT = "1", "u", "d", "du", "1 and u"


@dataclass(frozen=True)
class Way:
    """How an effect acts through such a quantity: columns that show all there is of it, its courses, and what multiplies them."""

    columns: tuple[str, ...]
    courses: tuple[str, ...]
    factors: tuple[str, ...]


WAYS: Mapping[str, Way] = MappingProxyType(
    {
        "load_deflection": Way(("load_kg",), (SET,), (OFFSET, ALONG, REVERSAL, REVERSAL_ALONG)),
        "cross_axis": Way(("pos_",), (SET,), (OFFSET, ALONG)),
        "abbe": Way(("pitch_urad", "yaw_urad"), (SET, DRIFTING), (OFFSET,)),
        "velocity_lag": Way(("velocity_mm_s",), (SET,), (REVERSAL,)),
        "thermal_expansion": Way(("temp_",), (DRIFTING,), (ALONG, ABOUT_A_POINT)),
        "thermal_drift": Way(("temp_",), (DRIFTING,), (OFFSET,)),
        "air_index": Way(("air_temp_c", "air_pressure_hpa"), (DRIFTING,), (ALONG, ABOUT_A_POINT)),
        "dead_path": Way(("air_temp_c", "air_pressure_hpa"), (DRIFTING,), (OFFSET,)),
    }
)


def absent(way: Way, recorded: Collection[str]) -> tuple[str, ...]:
    """Those of its columns that were not recorded; of thermometers and other axes any one is enough."""
    known = {
        "temp_" if name.startswith("temp_") else "pos_" if OTHER_AXIS.fullmatch(name) else name for name in recorded
    }
    return tuple(column for column in way.columns if column not in known)


def courses(campaign: CampaignRows) -> dict[str, Floats]:
    """The courses, (n, c) each."""
    own = (campaign.run[:, None] == np.arange(campaign.runs)).astype(float)
    time = campaign.columns[time_column(campaign.columns)]
    share = (time - np.min(time)) / max(float(np.ptp(time)), 1e-9)
    return {SET: own - own.mean(axis=0), DRIFTING: np.cos(np.pi * np.outer(share, WAVES)) / WAVES}


def factors(campaign: CampaignRows) -> dict[str, Floats]:
    """What multiplies a course, (n, m) each."""
    survey, d = campaign.survey, campaign.d
    u = (campaign.x - survey.centre_mm) / survey.half_span_mm
    one = np.ones(len(u))
    each = {OFFSET: [one], ALONG: [u], REVERSAL: [d], REVERSAL_ALONG: [d * u], ABOUT_A_POINT: [one, u]}
    return {name: np.column_stack(columns) for name, columns in each.items()}


def unlogged(fit: Fit, recorded: Collection[str]) -> Iterator[tuple[str, float]]:
    """By effect, the log evidence of the parts of a fit with it, acting through a quantity that was not recorded."""
    campaign = fit.rows.campaign
    course, factor = courses(campaign), factors(campaign)

    @cache
    def gain(of: str, by: str) -> float:
        columns = course[of][:, :, None] * factor[by][:, None, :]
        return fit.random_gain(columns.reshape(len(columns), -1))[0]

    for effect, way in WAYS.items():
        if not absent(way, recorded):
            continue
        gains = [gain(c, f) for c in way.courses for f in way.factors if campaign.runs > 2 or c != SET]
        if gains:
            yield effect, fit.log_p + max(gains) - math.log(len(gains)) - UNKNOWN


def share_of(odds: Mapping[str, float]) -> dict[str, float]:
    """Posterior of each explanation, the likeliest first, from log evidences, at the policy's temperature."""
    top = max(odds.values())
    raw = {name: math.exp(max((value - top) / USUAL.temperature, -40.0)) for name, value in odds.items()}
    whole = sum(raw.values())
    return {name: value / whole for name, value in sorted(raw.items(), key=lambda one: -one[1])}


def columns_of(effect: str, recorded: Collection[str]) -> Sequence[str]:
    """Columns that would show an effect and were not recorded."""
    whole = {"temp_": "temp_screw_c", "pos_": "pos_y_mm"}
    return tuple(whole.get(name, name) for name in absent(WAYS[effect], recorded)) if effect in WAYS else ()
