"""How an axis came to rest after the operator's stop, by what its thread saw of it."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample

RESTS_BELOW = 0.1
"""Of the speed it had; what is left below it is the last creep into position."""
MOVES_ABOVE_MM_S = 0.05


@dataclass(frozen=True)
class CameToRest:
    """After a stop: the time from the click until the axis was seen at rest, s, and its way meanwhile, mm."""

    after_s: float
    way_mm: float


class Standstill:
    """`pressed` is for any thread, `look` for the one that owns the axis. found: of the last stop in motion, once it is known"""

    def __init__(self) -> None:
        self.found: CameToRest | None = None
        self._pressed_ns: int | None = None
        self._before: DriveSample | None = None
        self._speed_mm_s = 0.0
        self._from_mm = 0.0

    def pressed(self, now_ns: int) -> None:
        """The stop was clicked at this time of the axis's clock; a second click before it is at rest counts as the first."""
        if self._pressed_ns is None:
            self._pressed_ns = now_ns

    def forget(self) -> None:
        """A new job begins."""
        self.found = self._pressed_ns = self._before = None
        self._speed_mm_s = 0.0

    def look(self, sample: DriveSample) -> None:
        """The axis was seen."""
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
