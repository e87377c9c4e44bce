"""A CAN bus in simulated time: arbitration, exact frame lengths, and a master's port that python-can users can use.

The master holds a `WirePort`, an ordinary `can.BusABC`: waiting in its `recv` lets simulated time run
until a frame arrives, so a time-out costs simulated time and no real one, and a run depends on its seeds alone. Without a bit rate
frames take no time and are handled within `send`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import can
from support.can_bus_model import wire_time_ns

from sim_backends.clock import SimClock

OnFrame = Callable[[int, bytes, int], None]
"""on_frame(cob_id, data, now_ns)"""
FOREVER_NS = 1 << 62
_LOOK_NS = 10_000_000  # longest step of a waiting receiver when no frame is scheduled


@dataclass(frozen=True)
class Frame:
    """One base-format frame. remote: it asks for the data of its identifier."""

    cob_id: int
    data: bytes
    remote: bool = False


class Node:
    """One node's connection to the wire: frames out in order, frames in by callback."""

    def __init__(self, wire: SimWire) -> None:
        self._wire = wire
        self.outgoing: deque[Frame] = deque()
        self.on_frame: OnFrame = lambda _cob_id, _data, _now_ns: None
        self.on_remote: Callable[[int, int], None] = lambda _cob_id, _now_ns: None
        self.tick: Callable[[int], None] | None = None
        self.due_ns: Callable[[], int | None] = lambda: None

    def connect(self, on_frame: OnFrame, tick: Callable[[int], None], due_ns: Callable[[], int | None]) -> None:
        """Set the receiver of frames, the callback for advanced time, and the latest time at which it is needed."""
        self.on_frame, self.tick, self.due_ns = on_frame, tick, due_ns

    def send(self, cob_id: int, data: bytes, *, remote: bool = False) -> None:
        """Queue a frame; it is sent when the bus is free and no frame of higher priority waits."""
        self.outgoing.append(Frame(cob_id, data, remote))
        self._wire.pump()


class SimWire:
    """The medium. bitrate in bit/s; None for a bus on which frames take no time.

    Make it after the servos of its drives have been attached to the clock: they have to be advanced first.
    """

    def __init__(self, clock: SimClock, bitrate: int | None = None) -> None:
        self.clock = clock
        self.bitrate = bitrate
        self.busy_ns = 0  # time in which the bus has carried frames
        self.frames = 0
        self._nodes: list[Node] = []
        self._current: tuple[set[Node], Frame, int] | None = None  # on the wire now: senders, frame, end in ns
        self._free_ns = 0
        self._delivering = False
        self._event_ns = 0  # time of the event being handled, at or before the clock's
        clock.attach(self._advance, bearable=self._bearable)

    def add_node(self) -> Node:
        node = Node(self)
        self._nodes.append(node)
        return node

    def remove_node(self, node: Node) -> None:
        """Disconnect a node, if it is connected; a frame of it that is on the wire is still delivered."""
        if node in self._nodes:
            self._nodes.remove(node)

    def port(self) -> WirePort:
        """A python-can bus on this wire."""
        return WirePort(self)

    def load(self, since_busy_ns: int, since_ns: int) -> float:
        """Share of the time, 0…1, in which the bus was busy since a moment (with `busy_ns` of that moment)."""
        return (self.busy_ns - since_busy_ns) / max(1, self.clock.now_ns() - since_ns)

    # -- frames ------------------------------------------------------------------------------------------------------
    def pump(self) -> None:
        """Advance the frames up to the present time."""
        if self._delivering:
            return
        self._delivering = True
        try:
            if self.bitrate is None:
                self._pump_ideal()
            else:
                self._event_ns = max(self._event_ns, self.clock.now_ns())
                self._begin()
        finally:
            self._delivering = False

    def _pump_ideal(self) -> None:
        now_ns = self.clock.now_ns()
        while (node := self._winner()) is not None:
            frame = node.outgoing.popleft()
            self.frames += 1
            self._deliver({node}, frame, now_ns)

    def _winner(self) -> Node | None:
        """Arbitration: the node with the lowest identifier among those that wait."""
        best: Node | None = None
        for node in self._nodes:
            if node.outgoing and (best is None or node.outgoing[0].cob_id < best.outgoing[0].cob_id):
                best = node
        return best

    def _begin(self) -> None:
        if self._current is not None or self.bitrate is None:
            return
        node = self._winner()
        if node is None:
            return
        frame = node.outgoing.popleft()
        senders = {node}
        for other in self._nodes:
            if (
                other is not node and other.outgoing and other.outgoing[0] == frame
            ):  # identical frames sent at the same time count as one
                other.outgoing.popleft()
                senders.add(other)
        start_ns = max(self._free_ns, self._event_ns)
        duration_ns = wire_time_ns(frame.cob_id, frame.data, self.bitrate)
        self.busy_ns += duration_ns
        self._free_ns = start_ns + duration_ns
        self._current = (senders, frame, self._free_ns)

    def _deliver(self, senders: set[Node], frame: Frame, now_ns: int) -> None:
        for node in tuple(self._nodes):
            if node in senders:
                continue
            if frame.remote:
                node.on_remote(frame.cob_id, now_ns)
            else:
                node.on_frame(frame.cob_id, frame.data, now_ns)

    # -- time --------------------------------------------------------------------------------------------------------
    def _bearable(self, now_ns: int) -> int:
        return self.next_event_ns() - now_ns

    def next_event_ns(self) -> int:
        next_ns = FOREVER_NS if self._current is None else self._current[2]
        for node in self._nodes:
            due_ns = node.due_ns()
            if due_ns is not None and due_ns < next_ns:
                next_ns = due_ns
        return next_ns

    def _advance(self, now_ns: int, _dt_s: float) -> None:
        self._delivering = True
        try:
            while self._current is not None and self._current[2] <= now_ns:
                senders, frame, end_ns = self._current
                self._current = None
                self._event_ns = end_ns
                self.frames += 1
                self._deliver(senders, frame, end_ns)
                self._begin()
            self._event_ns = now_ns
            for node in self._nodes:
                if node.tick is not None:
                    node.tick(now_ns)
        finally:
            self._delivering = False
        self.pump()


class WirePort(can.BusABC):
    """A python-can bus over a `SimWire`. `recv` lets simulated time pass; only the thread that owns the time may call it."""

    def __init__(self, wire: SimWire) -> None:
        super().__init__(channel="simulated")
        self.channel_info = "simulated wire"
        self._wire = wire
        self._node = wire.add_node()
        self._node.connect(self._take, self._send_periodic_due, self._next_periodic_ns)
        self._received: deque[can.Message] = deque()
        self._periodic: list[_PeriodicTask] = []
        self._bus_off: tuple[int, int] | None = None

    def schedule_bus_off(self, start_s: float, duration_s: float) -> None:
        """Set this controller bus-off from start_s for duration_s seconds: nothing is sent or received, and every call raises."""
        self._bus_off = (round(start_s * 1e9), round((start_s + duration_s) * 1e9))

    def _is_off(self) -> bool:
        if self._bus_off is None:
            return False
        start_ns, end_ns = self._bus_off
        return start_ns <= self._wire.clock.now_ns() < end_ns

    def _check(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("the port is closed")
        if self._is_off():
            raise can.CanOperationError("bus-off")

    def _take(self, cob_id: int, data: bytes, now_ns: int) -> None:
        if self._is_off():
            return
        self._received.append(
            can.Message(timestamp=now_ns * 1e-9, arbitration_id=cob_id, data=data, is_extended_id=False, is_rx=True)
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._check()
        self._node.send(msg.arbitration_id, bytes(msg.data), remote=msg.is_remote_frame)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; simulated time advances by at most `timeout` seconds."""
        self._check()
        received = self._received
        if received:
            return received.popleft()
        if timeout == 0:
            return None
        clock = self._wire.clock
        # a wait shorter than the clock's resolution lasts 1 ns: a caller that waits for the rest of a time-out would wait for ever
        end_ns = FOREVER_NS if timeout is None else clock.now_ns() + max(1, round(timeout * 1e9))
        while not received and clock.now_ns() < end_ns:
            now_ns = clock.now_ns()  # events that are due already are handled when time advances
            clock.sleep_until_ns(max(now_ns + 1, min(end_ns, self._wire.next_event_ns(), now_ns + _LOOK_NS)))
        return received.popleft() if received else None

    def shutdown(self) -> None:
        super().shutdown()
        self._periodic.clear()
        self._wire.remove_node(self._node)

    # -- periodic frames in simulated time -------------------------------------------------------------------------------
    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> Any:
        messages = [msgs] if isinstance(msgs, can.Message) else list(msgs)
        task = _PeriodicTask(self, messages, period)
        if autostart:
            task.start()
        return task

    def _next_periodic_ns(self) -> int | None:
        return min((task.next_ns for task in self._periodic), default=None)

    def _send_periodic_due(self, now_ns: int) -> None:
        for task in tuple(self._periodic):
            while task.next_ns <= now_ns:
                task.next_ns += task.period_ns
                if self._is_off():
                    continue
                cob_id, data = task.message.arbitration_id, bytes(task.message.data)
                self._node.send(cob_id, data, remote=task.message.is_remote_frame)
                if task.message.is_remote_frame:
                    continue
                self._take(
                    cob_id, data, now_ns
                )  # SocketCAN delivers its broadcast manager's frames to the sockets of this host

    def add_periodic(self, task: _PeriodicTask) -> None:
        task.next_ns = self._wire.clock.now_ns() + task.period_ns
        self._periodic.append(task)

    def drop_periodic(self, task: _PeriodicTask) -> None:
        if task in self._periodic:
            self._periodic.remove(task)


class _PeriodicTask(can.broadcastmanager.ModifiableCyclicTaskABC):
    """One periodic frame of a port."""

    def __init__(self, port: WirePort, messages: Sequence[can.Message], period_s: float) -> None:
        super().__init__(messages, period_s)
        self._port = port
        self.message = messages[0]
        self.period_ns = max(1, round(period_s * 1e9))
        self.next_ns = 0

    def start(self) -> None:
        self._port.add_periodic(self)

    def stop(self) -> None:
        self._port.drop_periodic(self)

    def modify_data(self, messages: Sequence[can.Message] | can.Message) -> None:
        self.message = messages if isinstance(messages, can.Message) else messages[0]
