"""Positioning by set-points for a drive without profile position: a ramp that goes one step further at each sample.

Sans-io: `step` says the next set-point. Whoever stops sampling stops the axis: the drive holds the last set-point.
"""

from __future__ import annotations

import math

FEED_S = 0.02
"""Interval of the set-points, s, written into 60C2h: two of the usual looks at a moving axis (10 ms)."""
LATE_S = 0.1
"""A gap above which the axis has come to rest at its last set-point, s: five intervals. The ramp then begins anew."""


class StreamedMove:
    """One axis on its way to a target, counts. feed_s: interval that the drive interpolates over; no set-point lies further away
    than the velocity takes it within that time."""

    def __init__(self, place: float, now_ns: int, feed_s: float = FEED_S) -> None:
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
