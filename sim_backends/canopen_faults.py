"""Faults of a CANopen drive and their times, as data; and the layer between drive and bus that applies them.

Faults of the wire, of the drive's communication and of its firmware; those of motor and mechanics are in
`sim_backends.faults`. Nothing is random here: a test draws its schedule from a seed and passes it in.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.clock import NS_PER_S
from sim_backends.canopen_drive import CanOpenSlave, Send
from sim_backends.faults import CanFaultKind


@dataclass(frozen=True)
class CanFault:
    """In force from at_s for duration_s (s; 0: permanently), for the first `count` occasions (0: all), after skipping `skip` of
    them."""

    kind: CanFaultKind
    at_s: float = 0.0
    duration_s: float = 0.0
    size: float = 0.0
    count: int = 0
    skip: int = 0


_K = CanFaultKind
_DEAD = (_K.NODE_DEAD, _K.POWER_CUT)
_EVENTS = (_K.EMCY_BURST, _K.REBOOT, _K.NMT_STOPPED, _K.NMT_PRE_OPERATIONAL, _K.FOREIGN_CONTROLWORD, _K.DRIVE_FAULT)

SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x580, 0x600, 0x700
TPDOS = (0x180, 0x280, 0x380, 0x480)
RPDOS = (0x200, 0x300, 0x400, 0x500)


@dataclass
class _Armed:
    """A fault with its state."""

    fault: CanFault
    seen: int = 0
    began: bool = False
    ended: bool = False

    @property
    def start_ns(self) -> int:
        return round(self.fault.at_s * NS_PER_S)

    @property
    def end_ns(self) -> int | None:
        return round((self.fault.at_s + self.fault.duration_s) * NS_PER_S) if self.fault.duration_s else None

    def in_force(self, now_ns: int) -> bool:
        end_ns = self.end_ns
        return now_ns >= self.start_ns and (end_ns is None or now_ns < end_ns)

    def strikes(self, now_ns: int) -> bool:
        """Whether the fault applies to this occasion; counts it."""
        if not self.in_force(now_ns):
            return False
        self.seen += 1
        after = self.seen - self.fault.skip
        return after > 0 and (not self.fault.count or after <= self.fault.count)


class FaultLayer:
    """Layer between one drive and its bus. send: onto the bus; make(send): the drive, with its way out.

    `on_frame` takes frames of the bus, `from_drive` those of the drive; `tick` and `due_ns` pass the time.
    """

    def __init__(
        self, faults: Iterable[CanFault], node_id: int, send: Send, make: Callable[[Send], CanOpenSlave]
    ) -> None:
        self._faults = [_Armed(fault) for fault in faults]
        self._node_id = node_id
        self._now_ns = 0
        self._delayed: list[tuple[int, int, int, bytes]] = []
        self._order = 0
        self._dead = False  # cut off from the bus
        self._unpowered = False
        self._send = send
        self.slave = make(self.from_drive)

    def add(self, faults: Iterable[CanFault]) -> None:
        """Add faults to those there are, from the thread that passes the time."""
        self._faults += [_Armed(fault) for fault in faults]

    def _strikes(self, *kinds: CanFaultKind) -> _Armed | None:
        for armed in self._faults:
            if armed.fault.kind in kinds and armed.strikes(self._now_ns):
                return armed
        return None

    # -- frames --------------------------------------------------------------------------------------------------------
    def on_frame(self, cob_id: int, data: bytes, now_ns: int) -> None:
        """A frame from the bus on its way to the drive."""
        self._advance(now_ns)
        if self._dead:
            return
        node_function = cob_id - self._node_id
        if cob_id == 0x080 and self._strikes(_K.SYNC_LOST):
            return
        if node_function in RPDOS and self._strikes(_K.RPDO_LOST):
            return
        if node_function == SDO_REQUEST and data:
            if self._strikes(_K.SDO_REQUEST_LOST):
                return
            refused = self._strikes(_K.SDO_ABORTED)
            if refused is None and data[0] >> 5 == 1:
                refused = self._strikes(_K.SDO_WRITE_ABORTED)
            if refused is not None:
                code = int(refused.fault.size).to_bytes(4, "little")
                self._send(SDO_ANSWER + self._node_id, b"\x80" + data[1:4] + code)
                return
        self.slave.on_frame(cob_id, data, now_ns)

    def from_drive(self, cob_id: int, data: bytes) -> None:
        """A frame of the drive on its way to the bus."""
        if self._dead:
            return
        node_function = cob_id - self._node_id
        delay_s = 0.0
        if node_function == SDO_ANSWER:
            if self._strikes(_K.SDO_LOST):
                return
            data = self._alter_sdo(data)
            late = self._strikes(_K.SDO_LATE)
            delay_s = late.fault.size if late is not None else 0.0
        elif node_function in TPDOS:
            if self._strikes(_K.TPDO_LOST):
                return
            if self._strikes(_K.TPDO_SHORT):
                data = data[:-1]
            late = self._strikes(_K.TPDO_LATE)
            delay_s = late.fault.size if late is not None else 0.0
        elif node_function == HEARTBEAT and self._strikes(_K.HEARTBEAT_STOPS):
            return
        copies = 2 if self._strikes(_K.DUPLICATES) else 1
        for _ in range(copies):
            if delay_s:
                self._order += 1
                heapq.heappush(self._delayed, (self._now_ns + round(delay_s * NS_PER_S), self._order, cob_id, data))
            else:
                self._send(cob_id, data)

    def _alter_sdo(self, data: bytes) -> bytes:
        if self._strikes(_K.SDO_WRONG_INDEX):
            return data[:1] + bytes((data[1] ^ 0x01,)) + data[2:]
        if self._strikes(_K.SDO_GARBAGE):
            return b"\xe0" + data[1:]
        if self._strikes(_K.SDO_SHORT):
            return data[:5]
        if data[0] >> 5 == 2 and data[0] & 0x02 and self._strikes(_K.SDO_WRONG_VALUE):  # an expedited upload's
            return data[:4] + bytes((data[4] ^ 0x01,)) + data[5:]
        return data

    # -- time ----------------------------------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        """Advance the faults and the drive behind them to now_ns (ns)."""
        self._advance(now_ns)
        if not self._unpowered:
            self.slave.tick(now_ns)

    def _advance(self, now_ns: int) -> None:
        self._now_ns = max(now_ns, self._now_ns)
        for armed in self._faults:
            if not armed.began and self._now_ns >= armed.start_ns:
                armed.began = True
                self._begin(armed)
            end_ns = armed.end_ns
            if armed.began and not armed.ended and end_ns is not None and self._now_ns >= end_ns:
                armed.ended = True
                self._end(armed)
        while self._delayed and self._delayed[0][0] <= self._now_ns:
            _, _, cob_id, data = heapq.heappop(self._delayed)
            if not self._dead:
                self._send(cob_id, data)

    def due_ns(self) -> int | None:
        """Latest time of the next `tick`, ns; None when nothing is scheduled."""
        times = [] if self._unpowered else [self.slave.due_ns()]
        if self._delayed:
            times.append(self._delayed[0][0])
        for armed in self._faults:
            if not armed.began:
                times.append(armed.start_ns)
            elif not armed.ended:
                times.append(armed.end_ns)
        return min((time_ns for time_ns in times if time_ns is not None), default=None)

    def _begin(self, armed: _Armed) -> None:
        fault = armed.fault
        self.slave.profile.defects.add(fault.kind)
        if fault.kind in _DEAD:
            self._dead = True
            self._delayed.clear()
            if fault.kind is _K.POWER_CUT:
                self._unpowered = True
                self.slave.lose_power(self._now_ns)
        elif fault.kind in _EVENTS:
            self._happen(fault)

    def _happen(self, fault: CanFault) -> None:
        if fault.kind is _K.EMCY_BURST:
            for number in range(int(fault.size)):
                self.slave.emergency(0xFF00 | number & 0xFF)
        elif fault.kind is _K.REBOOT:
            self.slave.boot(self._now_ns)
        elif fault.kind is _K.NMT_STOPPED:
            self.slave.on_frame(0x000, bytes((0x02, self._node_id)), self._now_ns)
        elif fault.kind is _K.NMT_PRE_OPERATIONAL:
            self.slave.on_frame(0x000, bytes((0x80, self._node_id)), self._now_ns)
        elif fault.kind is _K.DRIVE_FAULT:
            self.slave.servo.raise_fault(int(fault.size))
        else:
            word = int(fault.size).to_bytes(2, "little")
            request = b"\x2b\x40\x60\x00" + word + b"\0\0"
            self.slave.on_frame(SDO_REQUEST + self._node_id, request, self._now_ns)

    def _end(self, armed: _Armed) -> None:
        self.slave.profile.defects.discard(armed.fault.kind)
        if armed.fault.kind in _DEAD:
            self._dead = self._unpowered = False
            if armed.fault.kind is _K.POWER_CUT:
                self.slave.boot(self._now_ns)
