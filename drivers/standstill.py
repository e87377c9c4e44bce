"""Standstill: whether an axis stands, and whether what is shown of it is alive, judged from looks in a row, on any wire."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from drivers.clock import NS_PER_S

STILL_S = 0.2
"""An axis whose positions have agreed for so long stands, whatever its drive shows, s. One that shows arrivals has done so by then."""
AGREED_S = 0.02
"""The same where a velocity of 0 is shown by a drive that has no word for arrival, s: it may be stuck."""
STILL_MM = 0.005
"""Positions of an axis at rest lie within this, mm: 0.025 mm/s over `STILL_S`, 0.25 mm/s over `AGREED_S`."""
STILL_MM_S = 0.5
"""The velocity shown by an axis at rest stays below this, mm/s: noise of an encoder of 0.5 µm, differentiated over 1 ms."""


FROZEN_S = 1.0
"""A drive that has shown one position and one velocity for so long, the velocity above `STILL_MM_S`, shows neither, s."""


class FrozenValues:
    """Whether a drive's values have ceased to be of its axis, judged from looks in a row at one that was told to move."""

    def __init__(self) -> None:
        self._shown: tuple[float, float] | None = None
        self._since_ns = 0

    def forget(self) -> None:
        self._shown = None

    def look(self, time_ns: int, position_mm: float, velocity_mm_s: float | None) -> bool:
        """True once they contradict each other: it is said to move, and does not."""
        if velocity_mm_s is None or Standstill.is_slow(velocity_mm_s):
            self._shown = None
            return False
        if self._shown != (position_mm, velocity_mm_s):
            self._shown, self._since_ns = (position_mm, velocity_mm_s), time_ns
        return time_ns - self._since_ns >= FROZEN_S * NS_PER_S


class Standstill:
    """count_mm: what the drive tells apart; an encoder at rest may stand between two counts.

    An arrival that is shown counts once two looks agree with it. Positions count by themselves when they stay within a window, and
    within a wider one where the velocity is low all the time. A velocity in other units, or an arrival that a drive forgets or shows
    late, is thus not relied on by itself.
    """

    def __init__(self, count_mm: float) -> None:
        self._window_mm = max(STILL_MM, 1.5 * abs(count_mm))
        self._looks: deque[tuple[int, float, float | None]] = deque()

    @staticmethod
    def is_slow(velocity_mm_s: float) -> bool:
        """A velocity that an axis at rest may show."""
        return abs(velocity_mm_s) <= STILL_MM_S

    def look(
        self,
        time_ns: int,
        position_mm: float,
        velocity_mm_s: float | None = None,
        *,
        reached: bool | None = None,
        still_s: float = STILL_S,
    ) -> bool:
        """True when it stands. velocity_mm_s: None where none is shown. reached: the drive shows its arrival, None where it has no
        word for that; still_s: for how long positions have to agree where they are the only evidence."""
        looks = self._looks
        looks.append((time_ns, position_mm, velocity_mm_s))
        while len(looks) > 2 and time_ns - looks[1][0] >= still_s * NS_PER_S:
            looks.popleft()
        last = list(looks)[-2:]
        if reached and len(last) == 2 and all(v is None or self.is_slow(v) for _, _, v in last) and self._agree(last):
            return True
        if reached is None and velocity_mm_s == 0.0 and self._stays(AGREED_S):
            return True
        if self._stays(still_s):
            return True
        spans = time_ns - looks[0][0] >= still_s * NS_PER_S
        return spans and all(v is not None and self.is_slow(v) for _, _, v in looks) and self._agree(list(looks))

    def _stays(self, for_s: float) -> bool:
        """The positions of the last for_s lie within the window."""
        since_ns = self._looks[-1][0] - for_s * NS_PER_S
        before = [index for index, (time_ns, _, _) in enumerate(self._looks) if time_ns <= since_ns]
        return bool(before) and _spread(list(self._looks)[before[-1] :]) <= self._window_mm

    def _agree(self, looks: Sequence[tuple[int, float, float | None]]) -> bool:
        """The positions do not contradict a velocity below the threshold."""
        return _spread(looks) <= self._window_mm + STILL_MM_S * (looks[-1][0] - looks[0][0]) / NS_PER_S


def _spread(looks: Sequence[tuple[int, float, float | None]]) -> float:
    positions = [position for _, position, _ in looks]
    return max(positions) - min(positions)
