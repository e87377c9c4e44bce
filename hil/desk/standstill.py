"""Time and distance of an axis from the operator's stop to its standstill, from the samples of its thread."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample

RESTS_BELOW = 0.1
"""Share of its speed below which the axis counts as at rest; what remains is the settling into position."""
MOVES_ABOVE_MM_S = 0.05
"""Speed above which an axis counts as moving, mm/s."""


@dataclass(frozen=True)
class CameToRest:
    """A stop: time from the click to the standstill, s, and the distance meanwhile, mm."""

    after_s: float
    way_mm: float


class Standstill:
    """`pressed` is for any thread, `look` for the one that owns the axis. found: result of the last stop in motion, None before."""

    def __init__(self) -> None:
        self.found: CameToRest | None = None
        self._pressed_ns: int | None = None
        self._before: DriveSample | None = None
        self._speed_mm_s = 0.0
        self._from_mm = 0.0

    def pressed(self, now_ns: int) -> None:
        """Note the click at this time of the axis's clock. A second click before the standstill is ignored."""
        if self._pressed_ns is None:
            self._pressed_ns = now_ns

    def forget(self) -> None:
        """Drop the result: call when a job begins."""
        self.found = self._pressed_ns = self._before = None
        self._speed_mm_s = 0.0

    def look(self, sample: DriveSample) -> None:
        before, self._before = self._before, sample
        if before is None or sample.time_ns <= before.time_ns:
            return
        speed_mm_s = (
            abs(sample.position_load_mm - before.position_load_mm) * NS_PER_S / (sample.time_ns - before.time_ns)
        )
        if self._pressed_ns is None or sample.time_ns <= self._pressed_ns:
            self._speed_mm_s, self._from_mm = speed_mm_s, sample.position_load_mm
            return
        self._speed_mm_s = max(self._speed_mm_s, speed_mm_s)
        if self._speed_mm_s < MOVES_ABOVE_MM_S:
            self._pressed_ns = None  # it stood
        elif speed_mm_s < RESTS_BELOW * self._speed_mm_s:
            after_s = max(0, before.time_ns - self._pressed_ns) / NS_PER_S  # since when it is so slow
            self.found = CameToRest(after_s, abs(sample.position_load_mm - self._from_mm))
            self._pressed_ns = None
