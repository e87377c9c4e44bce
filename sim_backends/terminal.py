"""The wire of a simulated serial instrument: a pseudo-terminal that loses messages when it is full.

Messages put during a sleep of simulated time are on the wire when it ends: written, and waited for until the kernel shows them
at the reader's end. A missing reader never blocks it: when the terminal is full, whole messages are lost.
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
_ARRIVAL_BOUND_S = 0.25  # longest real time to wait for the kernel to deliver bytes, s


@dataclass(slots=True)
class WireCounters:
    """Numbers of samples, and of those that were not delivered."""

    samples: int = 0
    dropped_lines: int = 0
    late_arrivals: int = 0


class InstrumentTerminal:
    """`path` is the port that a reader opens. wait_for_arrival False: for readers in other threads or processes."""

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
        """Whether the terminal is open."""
        return self._master >= 0

    def heard(self) -> bytes:
        """The bytes that the reader has written, possibly none."""
        try:
            return os.read(self._master, PTY_CAPACITY_BYTES) if self.is_open else b""
        except BlockingIOError:
            return b""

    def put(self, message: bytes) -> None:
        """Send this at the next `settle`, completely or not at all."""
        if self._pending_bytes + len(message) > PTY_CAPACITY_BYTES:
            self.counters.dropped_lines += 1
            return
        self._pending.append(message)
        self._pending_bytes += len(message)

    def _waiting_bytes(self) -> int:
        """Number of unread bytes at the reader's end."""
        return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0"))[0])

    def settle(self) -> None:
        """Send what was put since the last call; return once it is at the reader's end."""
        if self._master < 0 or not (self._pending or self._unsent):
            return
        before = self._waiting_bytes()
        room = PTY_CAPACITY_BYTES - before - len(self._unsent)
        out = [self._unsent] if self._unsent else []
        for message in self._pending:
            if len(message) > room:
                self.counters.dropped_lines += 1
                room = 0  # later messages must not overtake it
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
        """Wait until the kernel has delivered the bytes; where another thread reads them meanwhile, until `_ARRIVAL_BOUND_S`."""
        deadline = time.monotonic() + _ARRIVAL_BOUND_S
        while self._waiting_bytes() < expected_bytes:
            if time.monotonic() > deadline:
                self.counters.late_arrivals += 1
                return
            os.sched_yield()
