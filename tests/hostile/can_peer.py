"""CanPeer: sits between a simulated CANopen drive and its bus and drops, alters, doubles, delays and injects frames.

`HostileBus` replaces `drives_in_turn` of the wiring, on a simulated wire with a bit rate, so that waiting costs simulated time.
A kind of misbehaviour is data: rules for frames in both directions, repeated actions, changes to the drive's firmware.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from random import Random
from typing import Any

from hostile.peer import Peer
from support.can_wire import SimWire, WirePort

from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.clock import SimClock
from sim_backends.faults import CanFaultKind
from sim_backends.servo import SimulatedServo

NMT, SYNC, EMCY, TPDO1, TPDO2, RPDO1, RPDO4, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = (
    0x000, 0x080, 0x080, 0x180, 0x280, 0x200, 0x500, 0x580, 0x600, 0x700
)  # fmt: skip
TPDOS, RPDOS = (0x180, 0x280, 0x380, 0x480), (0x200, 0x300, 0x400, 0x500)

Frames = list[tuple[float, int, bytes]]
"""Frames sent instead of one: delay in s, identifier, data."""
Rule = Callable[[int, bytes], Frames | None]
"""rule(identifier, data): the replacement, None for a frame that it does not change."""


class CanPeer(Peer):
    """One drive with its interceptor."""

    def __init__(
        self,
        bus: HostileBus,
        servo: SimulatedServo,
        node_id: int,
        *,
        make: Callable[..., CanOpenSlave] = CanOpenSlave,
        **settings: Any,
    ) -> None:
        wire = bus.wire
        self.bus = bus
        super().__init__(wire.clock, servo)
        self.node_id = node_id
        self.node, self.foreign = wire.add_node(), wire.add_node()
        self._from_rules: list[Rule] = []
        self._to_rules: list[Rule] = []
        self._every: list[list[Any]] = []  # due ns, period ns, what
        self._delayed: list[tuple[int, int, Callable[[], None]]] = []
        self._order = 0
        self._armed: tuple[int, Callable[[Any], None]] | None = None
        self.slave = make(servo, node_id, self._from_drive, **settings)
        self.node.connect(self._to_drive, self._tick, self._due_ns)
        self.slave.boot(self.clock.now_ns())

    def arm(self, at_ns: int, begin: Callable[[Any], None], seed: int) -> None:
        self._armed, self.random = (at_ns, begin), Random(seed)

    # -- parts of a kind -------------------------------------------------------------------------------------------------
    def answers(self, rule: Callable[[bytes], Frames], *functions: int) -> None:
        """A rule for frames of these function codes from the drive; it returns delay, identifier and data of the frames sent
        instead."""
        self._from_rules.append(lambda cob, data: rule(data) if cob - self.node_id in functions else None)

    def requests(self, rule: Callable[[bytes], Frames | None], *functions: int) -> None:
        """A rule for frames to the drive; None leaves the frame unchanged."""
        self._to_rules.append(lambda cob, data: rule(data) if cob - self.node_id in functions else None)

    def serve_sdo(self, server: Callable[[bytes], list[bytes] | None]) -> None:
        """Answer SDO requests instead of the drive, where `server` does not return None."""

        def rule(data: bytes) -> Frames | None:
            answers = server(data)
            if answers is None:
                return None
            self.strike()
            for answer in answers:
                self.node.send(SDO_ANSWER + self.node_id, answer)
            return []

        self.requests(rule, SDO_REQUEST)

    def shows(self, index: int, change: Callable[[int], int]) -> None:
        """Change the value of an object in every TPDO and SDO answer that carries it."""

        def rule(cob: int, data: bytes) -> Frames | None:
            spot = self._place(cob, data, index)
            if spot is None:
                return None
            start, size, signed = spot
            was = int.from_bytes(data[start : start + size], "little", signed=signed)
            now = change(was)
            if now == was:
                return None
            wrapped = now & (1 << 8 * size) - 1
            return [(0.0, cob, data[:start] + wrapped.to_bytes(size, "little") + data[start + size :])]

        self._from_rules.append(rule)

    def every(self, period_s: float, act: Callable[[], None]) -> None:
        """Call this from now on, once in each period (s)."""
        self._every.append([self.clock.now_ns(), round(period_s * 1e9), act])

    def after(self, delay_s: float, act: Callable[[], None]) -> None:
        """Call this once, after delay_s seconds."""
        self._order += 1
        heapq.heappush(self._delayed, (self.clock.now_ns() + round(delay_s * 1e9), self._order, act))

    def defect(self, defect: CanFaultKind) -> None:
        """Enable a defect of the simulated firmware."""
        self.strike()
        self.slave.profile.defects.add(defect)

    def speak(self, cob_id: int, data: bytes) -> None:
        """Another node on the bus sends a frame; master and drive receive it."""
        self.strike()
        self.foreign.send(cob_id, data)

    def own(self, function: int, data: bytes) -> None:
        """Send a frame as if from the drive."""
        self.strike()
        self.node.send(function + self.node_id, data)

    # -- frames and time -----------------------------------------------------------------------------------------------
    def _place(self, cob: int, data: bytes, index: int) -> tuple[int, int, bool] | None:
        """Position of an object in a frame of the drive: offset, size, whether it is signed."""
        signed = index in (0x6064, 0x606C, 0x6077, 0x60F4)
        function = cob - self.node_id
        if (
            function == SDO_ANSWER
            and len(data) == 8
            and data[0] & 0xE2 == 0x42
            and data[1:3] == index.to_bytes(2, "little")
        ):
            return 4, 4 - (data[0] >> 2 & 3), signed
        if function in TPDOS:
            number, start = self.slave.dictionary.number, 0
            mapping = 0x1A00 + TPDOS.index(function)
            for subindex in range(1, number(mapping, 0) + 1):
                mapped = number(mapping, subindex)
                size = (mapped & 0xFF) // 8
                if mapped >> 16 == index and start + size <= len(data):
                    return start, size, signed
                start += size
        return None

    def _from_drive(self, cob: int, data: bytes) -> None:
        self._pass(self._from_rules, cob, data, self.node.send)

    def _to_drive(self, cob: int, data: bytes, now_ns: int) -> None:
        self._pass(self._to_rules, cob, data, lambda c, d: self.slave.on_frame(c, d, max(now_ns, self.clock.now_ns())))

    def _pass(self, rules: list[Rule], cob: int, data: bytes, on: Callable[[int, bytes], None]) -> None:
        frames: Frames = [(0.0, cob, data)]
        for rule in rules:
            passed: Frames = []
            for delay_s, other, content in frames:
                changed = rule(other, content)
                if changed is not None:
                    self.strike()
                passed += [(delay_s, other, content)] if changed is None else changed
            frames = passed
        for delay_s, other, content in frames:
            if delay_s > 0.0:
                self.after(delay_s, lambda other=other, content=content: on(other, content))
            else:
                on(other, content)

    def _tick(self, now_ns: int) -> None:
        if self._armed is not None and now_ns >= self._armed[0]:
            kind, self._armed = self._armed[1], None
            kind(self)
        while self._delayed and self._delayed[0][0] <= now_ns:
            heapq.heappop(self._delayed)[2]()
        for regular in self._every:
            while regular[0] <= now_ns:
                regular[0] += regular[1]
                regular[2]()
        self.slave.tick(now_ns)

    def _due_ns(self) -> int | None:
        times = [self.slave.due_ns(), *(regular[0] for regular in self._every)]
        times += [] if self._armed is None else [self._armed[0]]
        times += [self._delayed[0][0]] if self._delayed else []
        return min((time for time in times if time is not None), default=None)


class HostileBus:
    """The interface of `drives_in_turn`, with an interceptor before each drive; the first one misbehaves."""

    def __init__(self, clock: SimClock, on_peer: Callable[[CanPeer], None] | None) -> None:
        self.wire = SimWire(clock, 1_000_000)
        self._on_peer = on_peer
        self.ports: list[WirePort] = []

    def add(self, servo: SimulatedServo, node_id: int = 1, **settings: Any) -> CanOpenSlave:
        peer = CanPeer(self, servo, node_id, **settings)
        if self._on_peer is not None:
            self._on_peer(peer)
        return peer.slave

    def master(self) -> WirePort:
        port = self.wire.port()
        self.ports.append(port)
        return port


def stand_in(on_peer: Callable[[CanPeer], None] | None) -> Callable[..., Any]:
    """Replacement of `drives_in_turn`; on_peer is called with each drive's interceptor."""

    @contextmanager
    def drives(clock: SimClock, _channel: str) -> Iterator[HostileBus]:
        yield HostileBus(clock, on_peer)

    return drives
