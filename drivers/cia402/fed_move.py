"""FedMove: positioning by set-points for a drive without profile position; its ramp goes one step further at each sample.

Whoever stops sampling stops the axis: the drive holds the last set-point.
"""

from __future__ import annotations

import math
from contextlib import suppress

from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.cia402.motion_parts import MotionParts, MoveOrder
from drivers.cia402.power import RUN
from drivers.cia402.state_machine import Control, decode_state
from drivers.drive import DriveState
from drivers.errors import AbortError
from drivers.standstill import Standstill

FEED_S = 0.02
"""Interval of the set-points, s, written into 60C2h: two of the usual looks at a moving axis (10 ms)."""
LATE_S = 0.1
"""A gap above which the axis has come to rest at its last set-point, s: five intervals. The ramp then begins anew."""


class FedMove:
    """near_counts: largest distance of an arrival."""

    def __init__(self, parts: MotionParts, near_counts: float) -> None:
        self._parts = parts
        self._near_counts = near_counts
        with suppress(AbortError):  # 60C2h is optional, and fixed in some drives
            parts.kept.set(objects.INTERPOLATION_PERIOD, round(1000 * FEED_S))
            parts.kept.set(objects.INTERPOLATION_EXPONENT, -3)
        self._ramp = _Ramp(parts.image.position_counts, parts.clock.now_ns(), self._interpolated_s())
        self._interpolated = parts.modes.mode is Mode.INTERPOLATED_POSITION

    @property
    def target_counts(self) -> float:
        return self._ramp.target

    def _interpolated_s(self) -> float:
        """60C2h, s, at most `FEED_S`."""
        value = self._parts.access.read_if_shown(objects.INTERPOLATION_PERIOD, 0)
        exponent = self._parts.access.read_if_shown(objects.INTERPOLATION_EXPONENT, -3)
        return min(FEED_S, value * 10.0**exponent) if value > 0 and exponent < 0 else FEED_S

    def go(self, order: MoveOrder, *, anew: bool) -> None:
        """A new target; a move in progress changes to it along its ramp. anew: the mode was just changed."""
        units, power = self._parts.units, self._parts.power
        speed, ramp = units.velocity.counts, units.acceleration.counts
        self._ramp.go(order.counts, order.velocity * float(speed), order.acceleration * float(ramp))
        run = RUN | Control.INTERPOLATE if self._interpolated else RUN
        if anew or power.controlword != run:
            power.write(RUN)  # in homing mode bit 4 had another meaning
            power.write(run)

    def look(self, status: int) -> bool:
        """Send the next set-point; False where a stop or a halt has ended the move."""
        power = self._parts.power
        if power.stopped or decode_state(status) is not DriveState.ENABLED or power.controlword & Control.HALT:
            return False
        place = self._ramp.step(self._parts.clock.now_ns())
        if place is not None:
            entry = objects.INTERPOLATION_TARGET if self._interpolated else objects.TARGET_POSITION
            self._parts.kept.set(entry, place, always=True)
        return True

    def arrived(self) -> bool:
        """Whether the axis rests at the target, once the last set-point was sent."""
        image = self._parts.image
        speed = self._parts.units.mm_s(image.values.get(objects.VELOCITY_ACTUAL, 0))
        at_rest = self._ramp.fed and Standstill.is_slow(speed)
        return at_rest and abs(image.position_counts - self._ramp.target) <= self._near_counts


class _Ramp:
    """One axis on its way to a target, counts. feed_s: interval that the drive interpolates over; no set-point lies further away
    than the velocity takes it within that time."""

    def __init__(self, place: float, now_ns: int, feed_s: float) -> None:
        self.place = place
        self.target = place
        self._speed = 0.0  # signed, counts/s
        self._velocity = self._ramp = 1.0
        self._fed_ns = now_ns
        self._feed_s = feed_s

    def go(self, target: float, velocity: float, ramp: float) -> None:
        """A new target, counts, with counts/s and counts/s²; a move in progress changes to it along its ramp."""
        self.target, self._velocity, self._ramp = target, velocity, ramp

    @property
    def fed(self) -> bool:
        """Whether the last set-point is the target."""
        return self.place == self.target

    def step(self, now_ns: int) -> int | None:
        """The next set-point, counts; None while the last one is in force."""
        since_s = (now_ns - self._fed_ns) * 1e-9
        if since_s < 0.95 * self._feed_s or self.fed:
            if self.fed:
                self._fed_ns = now_ns
            return None
        if since_s > LATE_S:
            self._speed = 0.0
        self._fed_ns = now_ns
        step_s = min(since_s, self._feed_s)
        left = self.target - self.place
        change = self._ramp * step_s
        # the speed from which the ramp still ends at the target, one step ahead
        brake = math.sqrt(2.0 * self._ramp * abs(left) + 0.25 * change * change) - 0.5 * change
        wanted = math.copysign(min(self._velocity, brake), left)
        self._speed += max(-change, min(change, wanted - self._speed))
        moved = self._speed * step_s
        if abs(left) <= max(abs(moved), change * step_s) and abs(self._speed) <= change + brake:
            self.place, self._speed = self.target, 0.0
        else:
            self.place += moved
        return round(self.place)
