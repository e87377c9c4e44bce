"""Listening: a time-out that counts the time in which this process listened.

A process that waits for a processor, or in the kernel for the thread that hands on a terminal's input, does not listen meanwhile. Its
delay is not the peer's: an answer that came in time waits in the receive buffer, or is handed on next.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.clock import IO_SLICE_S, NS_PER_S

EXCUSED_S = 1.0
"""Longest delay of this process, in all, that one time-out does not count, s: among fourteen that computed on two cores a process
waited for so long."""


class Listening:
    """A time-out that begins now. within_s: its length, s; now_ns: the clock, ns."""

    def __init__(self, within_s: float, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._now_ns = now_ns
        self._seen_ns = now_ns()
        self._granted_s = 0.0
        self._left_s = within_s
        self._excused_s = EXCUSED_S

    def extend(self, more_s: float) -> None:
        """Listen for so much longer, s."""
        self._left_s += more_s

    def next_slice_s(self, *, in_vain: bool = False) -> float:
        """The longest time to wait next, s; 0.0: the time-out is over. What took longer since the last call than was granted by it is
        this process's delay.

        in_vain: the wait that was granted has passed in full, even where it does not advance the clock."""
        now_ns, granted_s = self._now_ns(), self._granted_s
        took_s = (now_ns - self._seen_ns) / NS_PER_S
        if took_s > granted_s:
            delay_s = min(took_s - granted_s, self._excused_s)
            self._excused_s -= delay_s
            took_s -= delay_s
        elif in_vain:
            took_s = granted_s
        self._left_s = left_s = self._left_s - took_s
        self._seen_ns = now_ns
        self._granted_s = granted_s = IO_SLICE_S if left_s > IO_SLICE_S else left_s if left_s > 0.0 else 0.0
        return granted_s
