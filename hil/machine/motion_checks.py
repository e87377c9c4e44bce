"""Checks of the motor's motion: it stays within its travel, and where it is while no motion is commanded; and it is not faster than
commanded. They do no I/O."""

from __future__ import annotations

from collections import deque

from drivers.clock import NS_PER_S
from drivers.limits import DriveLimits
from hil.axis.agreement import DATED_WITHIN_S
from hil.machine.instrument_check import FASTER_SHARE

OUTSIDE_MM = 1.0
"""Allowed distance beyond the travel, mm: more than a move to the end of the travel overshoots."""
AT_REST_MM = 1.0
"""Allowed change of position without a commanded motion, mm: more than a load sags when a brake opens."""
OVER_S = 1.0
"""Longest time between two positions that are compared, s."""
FLOOR_MM = 0.1
"""Travel that is allowed at any speed, mm: overshoot of a slow move, noise of a coarse encoder."""


class PositionCheck:
    """Position check of one axis under power. An axis found beyond its travel (at a homing switch) may come back but not go further
    out."""

    def __init__(self, limits: DriveLimits) -> None:
        self._limits = limits
        self._rest_mm: float | None = None
        self._beyond_mm: float | None = None

    def forget(self) -> None:
        """Accept the next position as it is: call when the drive's zero changes and while the axis is without power."""
        self._rest_mm = self._beyond_mm = None

    def look(self, position_mm: float, *, moving: bool) -> str | None:
        """Take a motor position, mm. moving: a motion is commanded. Returns what is wrong as a sentence, None when nothing is."""
        limits = self._limits
        beyond_mm = max(0.0, limits.travel_min_mm - position_mm, position_mm - limits.travel_max_mm)
        if self._beyond_mm is None:
            self._beyond_mm = beyond_mm
        if beyond_mm > self._beyond_mm + OUTSIDE_MM:
            return (
                f"is at {position_mm:.3f} mm, outside its travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm:"
                " it does not follow its drive's commands, or another master moves it"
            )
        self._beyond_mm = min(self._beyond_mm, beyond_mm)
        if moving:
            self._rest_mm = None
            return None
        if self._rest_mm is None:
            self._rest_mm = position_mm
        if abs(position_mm - self._rest_mm) > AT_REST_MM:
            return (
                f"moved from {self._rest_mm:.3f} to {position_mm:.3f} mm without a command: another master moves it,"
                " or its drive does not hold it"
            )
        return None


class Overspeed:
    """Overspeed check of one axis."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float, int]] = deque()
        """Date, position, and a moment before it was asked for."""
        self._from: tuple[int, float] | None = None
        self._before_ns: int | None = None  # the next position is asked for later

    def forget(self) -> None:
        """Drop the positions seen: call at the begin and end of a motion, and when the drive's zero changes."""
        self._seen.clear()
        self._from = self._before_ns = None

    def stood(self, now_ns: int, position_mm: float) -> None:
        """Note where the motor stands before a motion is commanded."""
        self._from, self._before_ns = (now_ns, position_mm), now_ns

    def look(self, time_ns: int, position_mm: float, speed_mm_s: float, *, now_ns: int) -> str | None:
        """Take a motor position, mm. speed_mm_s: commanded. now_ns: after the position was received. Returns what is wrong as a
        sentence, None when nothing is.

        From the rest before the command to the receipt of a position more time passes than the motor had for its travel, however late
        the host is: no uncertainty of the moments is allowed for. Between two positions of the motion at most the time from the look
        before the first to the receipt of the second: a host that is held up dates a position late.
        """
        if self._from is not None:
            seconds, travel_mm = (now_ns - self._from[0]) / NS_PER_S, abs(position_mm - self._from[1])
            if travel_mm > speed_mm_s * (1.0 + FASTER_SHARE) * seconds + FLOOR_MM:
                return _too_fast(travel_mm, seconds, speed_mm_s)
        seen, asked_ns = self._seen, time_ns if self._before_ns is None else min(time_ns, self._before_ns)
        self._before_ns = now_ns
        while seen and time_ns - seen[0][0] > OVER_S * NS_PER_S:
            seen.popleft()
        wrong = None
        for before_ns, before_mm, before_asked_ns in (seen[0], seen[-1]) if seen else ():
            seconds, travel_mm = (time_ns - before_ns) / NS_PER_S, abs(position_mm - before_mm)
            longest_s = max(seconds + DATED_WITHIN_S, (now_ns - before_asked_ns) / NS_PER_S)
            if travel_mm > speed_mm_s * (1.0 + FASTER_SHARE) * longest_s + FLOOR_MM:
                wrong = _too_fast(travel_mm, seconds, speed_mm_s)
        seen.append((time_ns, position_mm, asked_ns))
        return wrong


def _too_fast(travel_mm: float, seconds: float, speed_mm_s: float) -> str:
    return (
        f"runs too fast: {travel_mm:.3f} mm in {seconds:.3f} s, commanded {speed_mm_s:g} mm/s, allowed are"
        f" {100 * FASTER_SHARE:g} % more"
    )
