"""Time as something one is given, never something one looks up.

Every wait and every time-out of the project goes through a `Clock`, so that the same procedure runs on a machine in real
time and on the bench as fast as the processor allows (`sim_backends.clock` advances the plant instead of waiting).
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

NS_PER_S = 1_000_000_000
IO_SLICE_S = 0.005
"""Longest time that I/O may block without `Clock.check_interrupt`, s: a quarter of the 20 ms allowed from a stop to its frame."""


class Clock(ABC):
    """A monotonic clock in nanoseconds; its zero means nothing."""

    @abstractmethod
    def now_ns(self) -> int:
        """Monotonic time in ns."""

    @abstractmethod
    def sleep_until_ns(self, time_ns: int) -> None:
        """Return once `now_ns() >= time_ns`; at once when that is past."""

    def sleep_s(self, duration_s: float) -> None:
        """Sleep for a duration in seconds, counted from now."""
        self.sleep_until_ns(self.now_ns() + round(duration_s * NS_PER_S))

    @abstractmethod
    def check_interrupt(self) -> None:
        """Raise whatever ends the present wait (the operator's stop). Called at least every `IO_SLICE_S` while input or output blocks.

        A clock that nobody can interrupt does nothing here.
        """

    def side_by_side(self, works: Sequence[Callable[[], None]]) -> Sequence[Callable[[], None]]:
        """These works on this clock, each for a thread of its own; all of the threads have to be started.

        A clock whose time passes by itself gives them back as they are.
        """
        return works

    def deadline(self, duration_s: float) -> Deadline:
        """A deadline `duration_s` seconds from now."""
        return Deadline(self, self.now_ns() + round(duration_s * NS_PER_S))


class Waiting(Protocol):
    """How time really passes for whoever waits on a clock; here somebody else can end the wait, by an error raised in the waiter."""

    def real(self, duration_s: float) -> None:
        """Let this much real time pass (0.0: only look whether the wait is to end)."""

    def simulated(self, now_ns: int) -> None:
        """Simulated time has come to `now_ns`: hold it back for as long as it should last."""


class WallClock(Clock):
    """Real time."""

    def __init__(self, waiting: Waiting | None = None) -> None:
        self._waiting = waiting
        self._wait = time.sleep if waiting is None else waiting.real

    def check_interrupt(self) -> None:
        if self._waiting is not None:
            self._waiting.real(0.0)

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, time_ns: int) -> None:
        self._wait(max(0, time_ns - time.monotonic_ns()) / NS_PER_S)
        while (left_ns := time_ns - time.monotonic_ns()) > 0:
            self._wait(left_ns / NS_PER_S)


class Deadline:
    """A moment by which something must have happened."""

    def __init__(self, clock: Clock, end_ns: int) -> None:
        self._clock = clock
        self.end_ns = end_ns

    def remaining_s(self) -> float:
        """Seconds left, 0.0 when it is over."""
        return max(0, self.end_ns - self._clock.now_ns()) / NS_PER_S

    @property
    def expired(self) -> bool:
        return self._clock.now_ns() >= self.end_ns
