"""Overspeed: whether the motor moves faster than it was told to. Pure: positions go in, what is wrong comes out as a sentence."""

from __future__ import annotations

from collections import deque

from drivers.clock import NS_PER_S
from hil.axis.agreement import DATED_WITHIN_S
from hil.machine.agreement import FASTER_SHARE

OVER_S = 1.0
"""Positions are compared with those of up to so long before."""
FLOOR_MM = 0.1
"""Travel that is never judged: overshoot of a slow move, noise of a coarse encoder."""


class Overspeed:
    """Of one axis."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()

    def forget(self) -> None:
        """A motion begins or ends, or the drive's zero is a new one."""
        self._seen.clear()

    def look(self, time_ns: int, position_mm: float, speed_mm_s: float) -> str | None:
        """What is wrong with where the motor is, for a motion at this speed."""
        seen = self._seen
        while seen and time_ns - seen[0][0] > OVER_S * NS_PER_S:
            seen.popleft()
        wrong = None
        for before_ns, before_mm in (seen[0], seen[-1]) if seen else ():
            seconds, travel_mm = (time_ns - before_ns) / NS_PER_S, abs(position_mm - before_mm)
            if travel_mm > speed_mm_s * (1.0 + FASTER_SHARE) * (seconds + DATED_WITHIN_S) + FLOOR_MM:
                wrong = (
                    f"runs too fast: {travel_mm:.3f} mm in {seconds:.3f} s, told were {speed_mm_s:g} mm/s, allowed are"
                    f" {100 * FASTER_SHARE:g} % more"
                )
        seen.append((time_ns, position_mm))
        return wrong
