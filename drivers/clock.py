"""Clock: the time base of every wait and time-out, handed to each object that waits.

The same procedure so runs on a machine in real time and on the bench as fast as the processor allows (`sim_backends.clock` advances
the simulated machine instead of waiting).
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
    """A monotonic clock in nanoseconds; its zero is arbitrary."""

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
        """Raise the error that ends the present wait (the operator's stop). Called at least every `IO_SLICE_S` while I/O blocks.

        A clock without an operator does nothing here.
        """

    def side_by_side(self, works: Sequence[Callable[[], None]]) -> Sequence[Callable[[], None]]:
        """The same calls, wrapped so that each can run in a thread of its own on this clock; all of the threads have to be started.

        A clock in real time returns them unchanged.
        """
        return works

    def deadline(self, duration_s: float) -> Deadline:
        """A deadline `duration_s` seconds from now."""
        return Deadline(self, self.now_ns() + round(duration_s * NS_PER_S))


class Waiting(Protocol):
    """How real time passes while a clock waits. An implementation ends the wait by raising an error in the waiting thread."""

    def real(self, duration_s: float) -> None:
        """Let this much real time pass, s (0.0: only check whether the wait is to end)."""

    def simulated(self, now_ns: int) -> None:
        """Simulated time has reached `now_ns`: block for as long as it should last in real time."""


class WallClock(Clock):
    """Real time (`time.monotonic_ns`). waiting: used instead of `time.sleep`, so that a wait can be interrupted."""

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
    """A moment by which a wait must have ended. end_ns: in the clock's time, ns."""

    def __init__(self, clock: Clock, end_ns: int) -> None:
        self._clock = clock
        self.end_ns = end_ns

    @property
    def expired(self) -> bool:
        """Whether the moment has passed."""
        return self._clock.now_ns() >= self.end_ns
