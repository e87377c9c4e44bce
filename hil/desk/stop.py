"""The operator's stop: pressed in any thread, it ends the wait of the thread that owns the axis.

Every wait of every procedure goes through the clock, and the desk's clocks wait here. A stop has the effect of Ctrl-C: the axis is
quick-stopped, settings are restored, and rows are kept. A second press meanwhile has no effect. `MeasuredStop` is the time and
distance from the press to the standstill.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample

_LATE_S = 0.2
"""Delay of simulated against real time, s, beyond which the delay is not made up."""


class StoppedByOperator(KeyboardInterrupt):
    """The operator pressed the stop. As a KeyboardInterrupt it is not handled by procedures that handle errors."""


class Stop:
    """The stop of one axis. `press` is for any thread, all else for the thread that owns the axis."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._armed = True

    def press(self) -> None:
        """Stop at the next wait of the axis's thread, at once if it is waiting."""
        self._event.set()

    @property
    def pressed(self) -> bool:
        """Whether a press has not been carried out yet."""
        return self._event.is_set()

    def check(self) -> None:
        """Raises StoppedByOperator, once, if the stop was pressed."""
        if self._armed and self._event.is_set():
            self._armed = False
            self._event.clear()
            raise StoppedByOperator("stopped by the operator")

    def wait_s(self, duration_s: float) -> None:
        """Wait in real time. Raises as `check`, as soon as the stop is pressed."""
        if not self._armed:
            time.sleep(duration_s)
            return
        if duration_s > 0.0:
            self._event.wait(duration_s)
        self.check()

    def rearm(self) -> None:
        """Call once the last stop is carried out: from now on a press counts again."""
        self._armed = True


class Pacing:
    """The waits of the axis's clock: real time, or simulated time `factor` times as fast (0: as fast as possible)."""

    def __init__(self, stop: Stop, factor: float = 1.0) -> None:
        self._stop = stop
        self._factor = factor
        self._from: tuple[float, int] | None = None  # a real time, s, and its simulated time, ns
        self._simulated_ns: int | None = None  # the simulated time, None for a real clock

    def now_ns(self) -> int:
        """Time of the clock that waits here, ns, for any thread. On the bench it does not advance between two steps."""
        simulated_ns = self._simulated_ns
        return time.monotonic_ns() if simulated_ns is None else simulated_ns

    def set_factor(self, factor: float) -> None:
        if factor != self._factor:
            self._factor, self._from = factor, None

    def real(self, duration_s: float) -> None:
        """Wait in real time. Raises StoppedByOperator."""
        self._stop.wait_s(duration_s)

    def simulated(self, now_ns: int) -> None:
        """Wait until real time reaches the simulated time `now_ns`. Raises StoppedByOperator."""
        self._simulated_ns = now_ns
        self._stop.check()
        if self._factor <= 0.0:
            return
        now_s = time.monotonic()
        if self._from is None:
            self._from = (now_s, now_ns)
        ahead_s = (now_ns - self._from[1]) / NS_PER_S / self._factor - (now_s - self._from[0])
        if ahead_s > 0.0:
            self._stop.wait_s(ahead_s)
        elif ahead_s < -_LATE_S:
            self._from = (now_s, now_ns)


RESTS_BELOW = 0.1
"""Share of its speed below which the axis counts as at rest; what remains is the settling into position."""
MOVES_ABOVE_MM_S = 0.05
"""Speed above which an axis counts as moving, mm/s."""


@dataclass(frozen=True)
class CameToRest:
    """A stop: time from the click to the standstill, s, and the distance meanwhile, mm."""

    after_s: float
    way_mm: float


class MeasuredStop:
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
