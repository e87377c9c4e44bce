"""Homing methods of CiA-402 (IEC 61800-7-201, object 6098h) as data: which sensor, which way, which edge.

`HomingRun` executes any of them with one sequence: seek at the high speed until the sensor is in a state, stop, go the
final way at the low speed until the edge, and on to the next index pulse where the method requires one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class HomingSensor(Enum):
    NEGATIVE_LIMIT = "negative limit switch"
    POSITIVE_LIMIT = "positive limit switch"
    HOME = "home switch"


@dataclass(frozen=True)
class HomingMethod:
    """sensor None: no switch is used. Directions ±1. `seek_until`/`final_until` are states of the sensor."""

    sensor: HomingSensor | None
    seek_direction: int = 0
    seek_until: bool = True
    final_direction: int = 0
    final_until: bool = False
    index: bool = False


_N, _P, _H = HomingSensor.NEGATIVE_LIMIT, HomingSensor.POSITIVE_LIMIT, HomingSensor.HOME

HOMING_METHODS: dict[int, HomingMethod] = {
    1: HomingMethod(_N, -1, True, +1, False, index=True),
    2: HomingMethod(_P, +1, True, -1, False, index=True),
    3: HomingMethod(_H, +1, True, -1, False, index=True),
    4: HomingMethod(_H, -1, False, +1, True, index=True),
    5: HomingMethod(_H, -1, True, +1, False, index=True),
    6: HomingMethod(_H, +1, False, -1, True, index=True),
    17: HomingMethod(_N, -1, True, +1, False),
    18: HomingMethod(_P, +1, True, -1, False),
    19: HomingMethod(_H, +1, True, -1, False),
    20: HomingMethod(_H, -1, False, +1, True),
    21: HomingMethod(_H, -1, True, +1, False),
    22: HomingMethod(_H, +1, False, -1, True),
    33: HomingMethod(None, final_direction=-1, index=True),
    34: HomingMethod(None, final_direction=+1, index=True),
    35: HomingMethod(None),  # the present position, former number
    37: HomingMethod(None),  # the present position
}
