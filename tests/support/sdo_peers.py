"""SDO servers that misbehave, and masters that disturb, on a simulated wire. They share no code with the drivers."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator

from support.can_bench import CanBench
from support.can_wire import SimWire

Answers = Iterable[tuple[float, bytes]]
"""(delay after the frame before, s; frame): an answer to one request. An endless sequence is sent for as long as time runs."""


class Peer:
    """An SDO server. answer(request) returns its answers; `requests` are those received."""

    def __init__(self, wire: SimWire, node_id: int, answer: Callable[[bytes], Answers]) -> None:
        self.requests: list[bytes] = []
        self._wire = wire
        self._place = wire.add_node()
        self._place.connect(self._hear, self._send_due, self._due_ns)
        self._node_id = node_id
        self._answer = answer
        self._pending: list[tuple[int, int, bytes, Iterator[tuple[float, bytes]]]] = []
        self._count = 0

    def _hear(self, cob_id: int, data: bytes, now_ns: int) -> None:
        if cob_id == 0x600 + self._node_id:
            self.requests.append(data)
            self._next(iter(self._answer(data)), now_ns)

    def _next(self, answers: Iterator[tuple[float, bytes]], now_ns: int) -> None:
        for delay_s, frame in answers:
            self._count += 1
            heapq.heappush(self._pending, (now_ns + round(delay_s * 1e9), self._count, frame, answers))
            return

    def _due_ns(self) -> int | None:
        return self._pending[0][0] if self._pending else None

    def _send_due(self, now_ns: int) -> None:
        while self._pending and self._pending[0][0] <= now_ns:
            due_ns, _, frame, answers = heapq.heappop(self._pending)
            self._place.send(0x580 + self._node_id, frame)
            self._next(answers, due_ns)


class Flood:
    """Frames (identifier, data) in turn at equal intervals, from `start_s` on, permanently."""

    def __init__(
        self, wire: SimWire, frames: list[tuple[int, bytes]], period_s: float, *, start_s: float = 0.0
    ) -> None:
        self._place = wire.add_node()
        self._place.connect(lambda *_: None, self._tick, lambda: self._next_ns)
        self._frames = frames
        self._period_ns = round(period_s * 1e9)
        self._next_ns = wire.clock.now_ns() + round(start_s * 1e9)
        self.sent = 0

    def _tick(self, now_ns: int) -> None:
        while self._next_ns <= now_ns:
            self._next_ns += self._period_ns
            if len(self._place.outgoing) > 64:  # a controller with a full queue drops further frames
                continue
            self._place.send(*self._frames[self.sent % len(self._frames)])
            self.sent += 1


def bare_bus(bitrate: int | None = None) -> CanBench:
    """A wire without any drive."""
    return CanBench((), bitrate)
