"""One homing in progress: computes the next velocity from its method and the switches, and in the end the home position.

Knows no demand and no clock; the servo asks it once per step. Edges are latched where they are, not where a step ended, as a drive's
hardware does, so the result does not depend on the length of steps.
"""

from __future__ import annotations

from enum import Enum

from sim_backends.homing import HomingMethod
from sim_backends.servo_parameters import Switches


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
