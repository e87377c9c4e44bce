"""The wire of a simulated serial instrument: a pseudo-terminal that takes what fits and loses the rest.

What was put during a sleep of simulated time is on the wire when the sleeper wakes: written, and waited for until the kernel shows it
at the reader's end. Nobody reading never blocks it: when the terminal is full, whole messages are lost.
"""

from __future__ import annotations

import fcntl
import os
import struct
import termios
import time
import tty
from dataclasses import dataclass

PTY_CAPACITY_BYTES = 4000  # a terminal's line discipline holds 4095; beyond that order and loss are the kernel's choice
_ARRIVAL_BOUND_S = 0.25  # real time to wait at most for the kernel to hand bytes over


@dataclass(slots=True)
class WireCounters:
    """What was sampled, and what of it did not get through."""

    samples: int = 0
    dropped_lines: int = 0
    late_arrivals: int = 0


class InstrumentTerminal:
    """`path` is what a reader opens. wait_for_arrival False: for readers in other threads or processes."""

    def __init__(self, *, wait_for_arrival: bool = True) -> None:
        self.counters = WireCounters()
        self._pending: list[bytes] = []
        self._pending_bytes = 0
        self._unsent = b""
        self._wait = wait_for_arrival
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)

    def close(self) -> None:
        """Close the terminal; readers then see the port vanish."""
        if self._master >= 0:
            os.close(self._slave)
            os.close(self._master)
            self._master = self._slave = -1

    @property
    def is_open(self) -> bool:
        """Whether the terminal is still there."""
        return self._master >= 0

    def heard(self) -> bytes:
        """What the reader has written, possibly nothing."""
        try:
            return os.read(self._master, PTY_CAPACITY_BYTES) if self.is_open else b""
        except BlockingIOError:
            return b""

    def put(self, message: bytes) -> None:
        """Send this at the next `settle`, whole or not at all."""
        if self._pending_bytes + len(message) > PTY_CAPACITY_BYTES:
            self.counters.dropped_lines += 1
            return
        self._pending.append(message)
        self._pending_bytes += len(message)

    def _waiting_bytes(self) -> int:
        """What lies at the reader's end, unread."""
        return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0"))[0])

    def settle(self) -> None:
        """Send what was put since the last time; return once it lies at the reader's end."""
        if self._master < 0 or not (self._pending or self._unsent):
            return
        before = self._waiting_bytes()
        room = PTY_CAPACITY_BYTES - before - len(self._unsent)
        out = [self._unsent] if self._unsent else []
        for message in self._pending:
            if len(message) > room:
                self.counters.dropped_lines += 1
                room = 0  # none that comes after may overtake it
            else:
                room -= len(message)
                out.append(message)
        self._pending.clear()
        self._pending_bytes = 0
        data = b"".join(out)
        if not data:
            return
        try:
            written = os.write(self._master, data)
        except BlockingIOError:
            written = 0
        self._unsent = data[written:]
        if self._wait and written:
            self._wait_for(before + written)

    def _wait_for(self, expected_bytes: int) -> None:
        """The kernel hands bytes over in its own time; another thread that reads meanwhile ends the wait by its bound only."""
        deadline = time.monotonic() + _ARRIVAL_BOUND_S
        while self._waiting_bytes() < expected_bytes:
            if time.monotonic() > deadline:
                self.counters.late_arrivals += 1
                return
            os.sched_yield()
