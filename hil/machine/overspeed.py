"""Overspeed check: motor speed against commanded speed. Does no I/O."""

from __future__ import annotations

from collections import deque

from drivers.clock import NS_PER_S
from hil.axis.agreement import DATED_WITHIN_S
from hil.machine.instrument_check import FASTER_SHARE

OVER_S = 1.0
"""Longest time between two positions that are compared, s."""
FLOOR_MM = 0.1
"""Travel that is allowed at any speed, mm: overshoot of a slow move, noise of a coarse encoder."""


class Overspeed:
    """Overspeed check of one axis."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()

    def forget(self) -> None:
        """Drop the positions seen: call at the begin and end of a motion, and when the drive's zero changes."""
        self._seen.clear()

    def look(self, time_ns: int, position_mm: float, speed_mm_s: float) -> str | None:
        """Take a motor position, mm. speed_mm_s: commanded. Returns what is wrong as a sentence, None when nothing is."""
        seen = self._seen
        while seen and time_ns - seen[0][0] > OVER_S * NS_PER_S:
            seen.popleft()
        wrong = None
        for before_ns, before_mm in (seen[0], seen[-1]) if seen else ():
            seconds, travel_mm = (time_ns - before_ns) / NS_PER_S, abs(position_mm - before_mm)
            if travel_mm > speed_mm_s * (1.0 + FASTER_SHARE) * (seconds + DATED_WITHIN_S) + FLOOR_MM:
                wrong = (
                    f"runs too fast: {travel_mm:.3f} mm in {seconds:.3f} s, commanded {speed_mm_s:g} mm/s, allowed are"
                    f" {100 * FASTER_SHARE:g} % more"
                )
        seen.append((time_ns, position_mm))
        return wrong
