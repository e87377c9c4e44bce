"""Standstill: judges from successive samples whether an axis is at rest, and whether its values still change, on any wire."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from drivers.clock import NS_PER_S

STILL_S = 0.2
"""An axis whose positions agree for this long is at rest, whatever its drive shows, s."""
AGREED_S = 0.02
"""The same where a drive shows a velocity of 0, s: its value may be stuck."""
STILL_MM = 0.005
"""Window of the positions of an axis at rest, mm: 0.025 mm/s over `STILL_S`, 0.25 mm/s over `AGREED_S`."""
ARRIVED_WITHIN_MM = 0.1
"""An axis farther from its target by its motor encoder, mm, has not arrived, however wide its drive's window is: below any distance
to be measured."""
ARRIVED_COUNTS = 2
"""Smallest window of an arrival that the drive does not show itself, counts: an axis at rest may stand between two."""
STILL_MM_S = 0.5
"""The velocity shown by an axis at rest is below this, mm/s: noise of an encoder of 0.5 µm, differentiated over 1 ms."""


FROZEN_S = 1.0
"""Values are frozen when a drive shows one position and one velocity above `STILL_MM_S` for this long, s."""


def arrived_within_counts(counts_per_mm: float, window_counts: float = 0.0) -> float:
    """Largest distance from the target, counts, at which an axis at rest has arrived, where its drive does not show it. window_counts:
    of the drive, 0 for none."""
    return max(min(window_counts, ARRIVED_WITHIN_MM * counts_per_mm), ARRIVED_COUNTS, STILL_MM * counts_per_mm)


class FrozenValues:
    """Detects frozen values of a drive from successive samples of an axis that was ordered to move."""

    def __init__(self) -> None:
        self._shown: tuple[float, float] | None = None
        self._since_ns = 0

    def forget(self) -> None:
        self._shown = None

    def look(self, time_ns: int, position_mm: float, velocity_mm_s: float | None) -> bool:
        """True once position (mm) and velocity (mm/s) contradict each other: the drive shows a velocity and its position does not
        change."""
        if velocity_mm_s is None or Standstill.is_slow(velocity_mm_s):
            self._shown = None
            return False
        if self._shown != (position_mm, velocity_mm_s):
            self._shown, self._since_ns = (position_mm, velocity_mm_s), time_ns
        return time_ns - self._since_ns >= FROZEN_S * NS_PER_S


class Standstill:
    """Standstill of one axis. count_mm: resolution of the drive, mm; an encoder at rest may alternate between two counts.

    Positions count by themselves when they stay within a window, and within a wider one where the velocity is low all the time. A
    velocity in other units is thus never the only evidence, nor is an arrival that a drive shows.
    """

    def __init__(self, count_mm: float) -> None:
        self._window_mm = max(STILL_MM, 1.5 * abs(count_mm))
        self._looks: deque[tuple[int, float, float | None]] = deque()

    @staticmethod
    def is_slow(velocity_mm_s: float) -> bool:
        """Whether an axis at rest may show this velocity, mm/s."""
        return abs(velocity_mm_s) <= STILL_MM_S

    def look(
        self, time_ns: int, position_mm: float, velocity_mm_s: float | None = None, *, still_s: float = STILL_S
    ) -> bool:
        """True when the axis is at rest (ns, mm, mm/s). velocity_mm_s: None where none is shown. still_s: for how long positions have
        to agree where they are the only evidence, s."""
        looks = self._looks
        looks.append((time_ns, position_mm, velocity_mm_s))
        while len(looks) > 2 and time_ns - looks[1][0] >= still_s * NS_PER_S:
            looks.popleft()
        if velocity_mm_s == 0.0 and self._stays(AGREED_S):
            return True
        if self._stays(still_s):
            return True
        spans = time_ns - looks[0][0] >= still_s * NS_PER_S
        return spans and all(v is not None and self.is_slow(v) for _, _, v in looks) and self._agree(list(looks))

    def _stays(self, for_s: float) -> bool:
        """Whether the positions of the last for_s seconds lie within the window."""
        since_ns = self._looks[-1][0] - for_s * NS_PER_S
        before = [index for index, (time_ns, _, _) in enumerate(self._looks) if time_ns <= since_ns]
        return bool(before) and _spread(list(self._looks)[before[-1] :]) <= self._window_mm

    def _agree(self, looks: Sequence[tuple[int, float, float | None]]) -> bool:
        """Whether the positions are compatible with a velocity below the threshold."""
        return _spread(looks) <= self._window_mm + STILL_MM_S * (looks[-1][0] - looks[0][0]) / NS_PER_S


def _spread(looks: Sequence[tuple[int, float, float | None]]) -> float:
    positions = [position for _, position, _ in looks]
    return max(positions) - min(positions)
