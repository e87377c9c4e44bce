"""Drives on python-can's virtual bus without a thread: they run when the master looks for a frame, or lets time pass.

For simulated time, in which nothing happens between two actions of the one thread. The frames go through python-can's virtual bus all
the same, so any other bus object on the channel receives them; the switch of threads for each frame is avoided.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Any

import can
from can.interfaces.virtual import VirtualBus

from drivers.clock import NS_PER_S
from sim_backends.canopen_drive import SUPERVISION_NS, CanOpenSlave
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_station import Station
from sim_backends.clock import SimClock
from sim_backends.own_table import TableForm
from sim_backends.servo import SimulatedServo

_LOOK_NS = 10_000_000  # longest step of simulated time of a master that waits


class _Bus(VirtualBus):
    """An end of the virtual bus. A frame is copied once for all receivers, with data bytes of its own."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._check_if_open()
        copied = copy(msg)
        copied.data = bytearray(msg.data)
        copied.is_rx = True
        copied.channel = self.channel_id
        for listener in self.channel:
            if listener is not self.queue:
                listener.put(copied, timeout=timeout)


class _Asking(can.broadcastmanager.ModifiableCyclicTaskABC):
    """A remote frame, sent again and again in simulated time: node guarding asks in the time in which the node watches it."""

    def __init__(self, bus: MasterBus, messages: Sequence[can.Message], period_s: float, clock: SimClock) -> None:
        super().__init__(messages, period_s)
        self._bus = bus
        self._clock = clock
        self._period_ns = max(1, round(period_s * NS_PER_S))
        self._next_ns: int | None = None
        clock.attach(self._advance, bearable=self._bearable)

    def start(self) -> None:
        self._next_ns = self._clock.now_ns() + self._period_ns

    def stop(self) -> None:
        self._next_ns = None

    def _bearable(self, now_ns: int) -> int:
        return SUPERVISION_NS if self._next_ns is None else max(1, min(SUPERVISION_NS, self._next_ns - now_ns))

    def _advance(self, now_ns: int, _dt_s: float) -> None:
        if self._next_ns is not None and self._next_ns <= now_ns:
            self._next_ns = now_ns + self._period_ns
            self._bus.send(self.messages[0])


class MasterBus(_Bus):
    """The master's end. A `recv` that finds nothing lets the drives handle their frames, then looks once more.

    waits: whether it then lets simulated time pass, for drives that answer later, such as once their memory is written. Otherwise it
    never waits: without simulated time passing no other frame can come.
    """

    def __init__(self, channel: str, drives: list[_Drive], clock: SimClock, *, waits: bool = False) -> None:
        super().__init__(channel)
        self._drives = drives
        self._clock = clock
        self._waits = waits

    def _send_periodic_internal(
        self, msgs: Sequence[can.Message] | can.Message, period: float, *args: Any, **kwargs: Any
    ) -> Any:
        messages = [msgs] if isinstance(msgs, can.Message) else list(msgs)
        if not messages[0].is_remote_frame:
            return super()._send_periodic_internal(msgs, period, *args, **kwargs)
        task = _Asking(self, messages, period, self._clock)
        task.start()
        return task

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As the base class, which would look again and again until `timeout` has passed in real time, s."""
        message = super().recv(None if timeout is None else 0.0)
        if not (self._waits and timeout):
            return message
        now_ns = self._clock.now_ns()
        end_ns = now_ns + max(1, round(timeout * NS_PER_S))
        while message is None and now_ns < end_ns:
            self._clock.sleep_until_ns(min(end_ns, now_ns + _LOOK_NS))
            now_ns = self._clock.now_ns()
            message = super().recv(0.0)
        return message

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        del timeout
        self._check_if_open()
        if self.queue.empty():
            for drive in self._drives:
                drive.take_turn()
        try:
            return self.queue.get_nowait(), False
        except queue.Empty:
            return None, False


class _Drive:
    """One drive with its own end of the bus."""

    def __init__(self, station: Station, bus: _Bus, clock: SimClock) -> None:
        self._station = station
        self._bus = bus
        self._ended = False
        clock.attach(self._on_simulated_time, bearable=self._bearable)

    def close(self) -> None:
        self._ended = True
        self._bus.shutdown()

    def take_turn(self) -> None:
        """Handle every frame that has arrived."""
        frames = self._bus.queue
        while not frames.empty():
            self._station.deliver(frames.get_nowait())

    def _bearable(self, now_ns: int) -> int:
        return SUPERVISION_NS if self._ended else self._station.bearable(now_ns)

    def _on_simulated_time(self, now_ns: int, _dt_s: float) -> None:
        if not self._ended:
            self.take_turn()
            self._station.layer.tick(now_ns)


class DrivesInTurn:
    """A virtual bus with drives in simulated time. `master()` returns the bus for a `CanLink`, which closes it."""

    def __init__(self, clock: SimClock, channel: str) -> None:
        self.clock = clock
        self.channel = channel
        self._drives: list[_Drive] = []

    def add(
        self,
        servo: SimulatedServo,
        node_id: int = 1,
        *,
        parameters: Mapping[tuple[int, int], int] | None = None,
        faults: Iterable[CanFault] = (),
        table: TableForm | None = None,
        make: Callable[..., CanOpenSlave] = CanOpenSlave,
    ) -> CanOpenSlave:
        """Put a drive on the bus and boot it; its servo has to be attached to the clock before. make: the kind of drive."""
        bus = _Bus(self.channel)
        station = Station(bus, self.clock, servo, node_id, parameters=parameters, faults=faults, table=table, make=make)
        self._drives.append(_Drive(station, bus, self.clock))
        return station.slave

    def master(self, *, waits: bool = False) -> MasterBus:
        """The bus for a master, which closes it. waits: as for `MasterBus`."""
        return MasterBus(self.channel, self._drives, self.clock, waits=waits)

    def close(self) -> None:
        """Take the drives off the bus."""
        for drive in self._drives:
            drive.close()


@contextmanager
def drives_in_turn(clock: SimClock, channel: str) -> Iterator[DrivesInTurn]:
    """A bus whose drives are removed when the block ends."""
    bus = DrivesInTurn(clock, channel)
    try:
        yield bus
    finally:
        bus.close()
