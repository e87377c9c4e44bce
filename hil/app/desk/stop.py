"""The operator's stop: pressed in any thread, it ends the wait of the one thread that owns the axis.

Every wait of every procedure goes through the clock, and the desk's clocks wait here. A stop is to a procedure what Ctrl-C is: it
quick-stops the axis, puts settings back and keeps what was measured. While it does so a second press does not disturb it.
"""

from __future__ import annotations

import threading
import time

from drivers.clock import NS_PER_S

_LATE_S = 0.2  # behind by more than this, simulated time does not hurry to catch up


class StoppedByOperator(KeyboardInterrupt):
    """Somebody pressed the stop. Like Ctrl-C it is none of the errors that a procedure may try to get over."""


class Stop:
    """One stop for one axis. `press` is for any thread; everything else is for the thread that owns the axis."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._armed = True

    def press(self) -> None:
        """Stop at the next moment the axis's thread waits; at once if it is waiting."""
        self._event.set()

    @property
    def pressed(self) -> bool:
        """Pressed, and not answered yet."""
        return self._event.is_set()

    def check(self) -> None:
        """Raise StoppedByOperator, once, if it was pressed."""
        if self._armed and self._event.is_set():
            self._armed = False
            self._event.clear()
            raise StoppedByOperator("stopped by the operator")

    def wait_s(self, duration_s: float) -> None:
        """Let real time pass; raises as `check`, as soon as it is pressed."""
        if not self._armed:
            time.sleep(duration_s)
            return
        if duration_s > 0.0:
            self._event.wait(duration_s)
        self.check()

    def rearm(self) -> None:
        """What the last press broke off has been put in order; a press since then counts."""
        self._armed = True


class Pacing:
    """How time passes for the axis's clock: real time as it is, simulated time `factor` times as fast (0: as fast as it goes)."""

    def __init__(self, stop: Stop, factor: float = 1.0) -> None:
        self._stop = stop
        self._factor = factor
        self._from: tuple[float, int] | None = None  # a real moment, s, and the simulated one that belongs to it, ns
        self._simulated_ns: int | None = None  # how far simulated time has come, if it is that

    def now_ns(self) -> int:
        """The time of the clock that waits here, for any thread: on the bench it stands still between two steps."""
        simulated_ns = self._simulated_ns
        return time.monotonic_ns() if simulated_ns is None else simulated_ns

    def set_factor(self, factor: float) -> None:
        """From now on."""
        if factor != self._factor:
            self._factor, self._from = factor, None

    def real(self, duration_s: float) -> None:
        self._stop.wait_s(duration_s)

    def simulated(self, now_ns: int) -> None:
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
