"""Homing of the simulated drive: methods of CiA-402 (IEC 61800-7-201, object 6098h) as data, switches, and one homing in progress.

`HomingRun` executes any method with one sequence: seek at the high speed until the sensor is in a state, stop, go the
final way at the low speed until the edge, and on to the next index pulse where the method requires one. It has no demand and no clock;
the servo calls it once per step. Edges are latched at their position, not at the end of a step, as in a drive's
hardware, so the result does not depend on the length of steps.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from enum import Enum

from sim_backends.servo_parameters import ServoParameters


class HomingSensor(Enum):
    """The switches that a homing method can use."""

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
LIMIT_SWITCH_AND_INDEX = 1
"""The method of a simulated drive that is not told another."""


class Switches:
    """Limit and home switches and the encoder's index, asked at places in shaft counts."""

    def __init__(self, parameters: ServoParameters) -> None:
        self._p = parameters
        self._spread = random.Random(parameters.seed + 1)
        self._off = 0.0  # present deviation of the switching points

    def trip_anew(self) -> None:
        """Draw the deviation of the switching points anew, as it varies in mechanical switches."""
        spread = self._p.switch_spread_counts
        self._off = self._spread.gauss(0.0, spread) if spread else 0.0

    def positive_limit(self, at: float) -> bool:
        """Whether the positive limit switch is active at this position, shaft counts."""
        return at >= self._p.positive_limit_counts + self._off

    def negative_limit(self, at: float) -> bool:
        """Whether the negative limit switch is active at this position, shaft counts."""
        return at <= self._p.negative_limit_counts + self._off

    def home(self, at: float) -> bool:
        """Whether the home switch is active at this position, shaft counts."""
        return at < self._p.home_switch_counts + self._off

    def active(self, sensor: HomingSensor, at: float) -> bool:
        """Whether a switch is active at this position, shaft counts."""
        if sensor is HomingSensor.HOME:
            return self.home(at)
        return self.negative_limit(at) if sensor is HomingSensor.NEGATIVE_LIMIT else self.positive_limit(at)

    def edge(self, sensor: HomingSensor) -> float:
        """Position of the edge of a switch, shaft counts."""
        p = self._p
        if sensor is HomingSensor.HOME:
            return p.home_switch_counts + self._off
        place = p.negative_limit_counts if sensor is HomingSensor.NEGATIVE_LIMIT else p.positive_limit_counts
        return place + self._off

    def index_between(self, start: float, end: float) -> float | None:
        """The first index pulse on the way from start to end, shaft counts; None where there is none."""
        turn, offset = float(self._p.counts_per_rev), self._p.index_offset_counts
        if end > start:
            pulse = math.floor((start - offset) / turn + 1.0) * turn + offset
            return pulse if pulse <= end else None
        pulse = math.ceil((start - offset) / turn - 1.0) * turn + offset
        return pulse if pulse >= end else None


class _Phase(Enum):
    SEEK = 1
    TURN = 2  # stopping after the switch was found
    FINAL = 3
    INDEX = 4
    LEAVE = 5  # stopping with the home position latched


class HomingRun:
    """`latch` is the home position in shaft counts once it is known; `done` when the axis is at rest after that."""

    def __init__(self, method: HomingMethod, switches: Switches, speed_switch: float, speed_zero: float) -> None:
        self.method = method
        self.latch = 0.0
        self.done = False
        self._switches = switches
        self._seek = method.seek_direction * speed_switch
        self._final = method.final_direction * speed_zero
        self._phase = _Phase.SEEK

    def begin(self, at: float) -> float:
        """The first velocity to ramp to, counts/s, from position `at`, shaft counts."""
        method = self.method
        if method.sensor is None:
            self._phase = _Phase.INDEX if method.index else _Phase.LEAVE
            self.latch = at
            return self._final if method.index else 0.0
        if self._switches.active(method.sensor, at) == method.seek_until:
            self._phase = _Phase.FINAL
            return self._final
        return self._seek

    def step(self, before: float, at: float, at_rest: bool) -> float | None:
        """The velocity to ramp to, counts/s, after the axis went from `before` to `at` (shaft counts); None: no change."""
        if self._phase is _Phase.TURN and at_rest:
            self._phase = _Phase.FINAL
            return self._final
        if self._phase in (_Phase.TURN, _Phase.LEAVE):
            self.done = self._phase is _Phase.LEAVE and at_rest
            return None
        return self._on_the_way(before, at)

    def _on_the_way(self, before: float, at: float) -> float | None:
        method, switches = self.method, self._switches
        if self._phase is not _Phase.INDEX and method.sensor is not None:
            wanted = method.seek_until if self._phase is _Phase.SEEK else method.final_until
            if switches.active(method.sensor, at) != wanted:
                return None
            if self._phase is _Phase.SEEK:
                self._phase = _Phase.TURN
                return 0.0
            before = switches.edge(method.sensor)
            if not method.index:
                return self._latched(before)
            self._phase = _Phase.INDEX
        pulse = switches.index_between(before, at)
        return None if pulse is None else self._latched(pulse)

    def _latched(self, at: float) -> float:
        self.latch = at
        self._phase = _Phase.LEAVE
        return 0.0
