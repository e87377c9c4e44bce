"""A simulated serial instrument: a pseudo-terminal that loses messages when it is full, a line that delays them, faults of its lines.

Messages put during a sleep of simulated time are on the wire when it ends: written, and waited for until the kernel shows them
at the reader's end. A missing reader never blocks it: when the terminal is full, whole messages are lost.
"""

from __future__ import annotations

import fcntl
import os
import random
import struct
import termios
import time
import tty
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.errors import InputError
from sim_backends.faults import Fault, FaultKind, FaultSchedule

PTY_CAPACITY_BYTES = 4000  # a terminal's line discipline holds 4095; beyond that order and loss are the kernel's choice
_ARRIVAL_BOUND_S = 0.25  # longest real time to wait for the kernel to deliver bytes, s


@dataclass(slots=True)
class WireCounters:
    """Numbers of samples, and of those that were not delivered."""

    samples: int = 0
    dropped_lines: int = 0


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
                return
            os.sched_yield()


_NS = 1_000_000_000
_FAR_NS = 1 << 62


class DelayedLine:
    """Messages go on the wire `latency_s` after their time, and up to `jitter_s` later, evenly distributed; s. Raises InputError."""

    def __init__(self, wire: InstrumentTerminal, latency_s: float = 0.0, jitter_s: float = 0.0, seed: int = 0) -> None:
        if not (latency_s >= 0.0 and jitter_s >= 0.0):
            raise InputError(f"latency {latency_s:g} s with jitter {jitter_s:g} s, expected neither below 0")
        self._wire = wire
        self._latency_ns = round(latency_s * _NS)
        self._jitter_ns = jitter_s * _NS
        self._rng = random.Random(seed)
        self._waiting: deque[tuple[int, bytes]] = deque()

    @property
    def next_ns(self) -> int:
        """Time of the next message, ns; far in the future when none waits."""
        return self._waiting[0][0] if self._waiting else _FAR_NS

    def put(self, message: bytes, time_ns: int) -> None:
        due_ns = time_ns + self._latency_ns
        if self._jitter_ns:
            due_ns += round(self._rng.uniform(0.0, self._jitter_ns))
        if self._waiting:
            due_ns = max(due_ns, self._waiting[-1][0])
        if due_ns <= time_ns and not self._waiting:
            self._wire.put(message)
        else:
            self._waiting.append((due_ns, message))

    def release(self, now_ns: int) -> None:
        """Put the messages that are due at now_ns (ns) on the wire."""
        while self._waiting and self._waiting[0][0] <= now_ns:
            self._wire.put(self._waiting.popleft()[1])


class TerminalInstrument(ABC):
    """An instrument that sends lines. `path` is what a reader opens; `close` it at the end.

    Attach `advance`, `bearable` and `settle` to the clock after what moves the axis. first_ns: when `_act` is called first, ns; pulse:
    its trigger output, called at the exact time of each sample.
    """

    pulse: Callable[[], None] | None = None

    def __init__(
        self,
        faults: tuple[Fault, ...],
        *,
        first_ns: int,
        latency_s: float,
        jitter_s: float,
        seed: int,
        wait_for_arrival: bool,
    ) -> None:
        self._wire = InstrumentTerminal(wait_for_arrival=wait_for_arrival)
        self.path = self._wire.path
        self.counters = self._wire.counters
        self._line = DelayedLine(self._wire, latency_s, jitter_s, seed)
        self._faults = FaultSchedule(faults)
        self._next_ns = first_ns

    def close(self) -> None:
        """Close the terminal; readers then see the port vanish."""
        self._wire.close()

    @property
    def is_open(self) -> bool:
        return self._wire.is_open

    # -- time ----------------------------------------------------------------------------------------------------------
    def bearable(self, now_ns: int) -> int:
        """For SimClock: ns until something is due, so that it happens at its time."""
        return min(self._next_ns, self._line.next_ns) - now_ns if self._wire.is_open else _NS

    def advance(self, now_ns: int, dt_s: float) -> None:
        """Do what is due."""
        if not self._wire.is_open:
            return
        while self._next_ns <= now_ns:
            self._next_ns = self._act(self._next_ns)
        self._line.release(now_ns)

    def settle(self) -> None:
        """Send what is due; return once it is at the reader's end."""
        self._wire.settle()

    @abstractmethod
    def _act(self, time_ns: int) -> int:
        """Do what is due at this time (ns); returns the time of the next, ns."""

    # -- lines -----------------------------------------------------------------------------------------------------------
    def _begin_sample(self, time_ns: int) -> dict[FaultKind, float]:
        """Count a sample, and send the trigger pulse; returns the faults in force and their sizes."""
        self.counters.samples += 1
        if self.pulse is not None:
            self.pulse()
        sizes: dict[FaultKind, float] = {}
        for fault in self._faults.active(time_ns / _NS):
            sizes[fault.kind] = sizes.get(fault.kind, 0.0) + fault.size
        return sizes

    def _send(
        self, text: bytes, end: bytes, time_ns: int, faults: Mapping[FaultKind, float], noise: random.Random
    ) -> None:
        """Send a line, with the faults of lines among those given."""
        if FaultKind.HALF_LINE in faults:
            text = text[: len(text) * 2 // 3]
        text += (b"\n", b"\r", b"\r\n")[self.counters.samples % 3] if FaultKind.LINE_ENDS in faults else end
        if FaultKind.GARBAGE in faults:
            text += noise.randbytes(int(faults[FaultKind.GARBAGE]) or 8)
        if FaultKind.SILENCE not in faults:
            self._line.put(text, time_ns)
