"""Station: a simulated CANopen drive at its end of a bus of python-can."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

import can

from drivers.clock import Clock
from drivers.errors import LinkLostError
from sim_backends.canopen_drive import SUPERVISION_NS, CanOpenSlave
from sim_backends.canopen_faults import CanFault, FaultLayer
from sim_backends.own_table import TableForm
from sim_backends.servo import SimulatedServo


class Station:
    """Frames to the drive and from it, and its next time in simulated time. Raises LinkLostError when
    the bus does not take a frame."""

    def __init__(
        self,
        bus: can.BusABC,
        clock: Clock,
        servo: SimulatedServo,
        node_id: int,
        *,
        parameters: Mapping[tuple[int, int], int] | None,
        faults: Iterable[CanFault],
        table: TableForm | None = None,
        make: Callable[..., CanOpenSlave] = CanOpenSlave,
    ) -> None:
        self._bus = bus
        self._clock = clock
        made = partial(make, servo, node_id, parameters=parameters, table=table)
        self.layer = FaultLayer(faults, node_id, self._send, made)
        self.slave = self.layer.slave
        self.slave.boot(clock.now_ns())

    def _send(self, cob_id: int, data: bytes) -> None:
        try:
            self._bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))
        except (can.CanError, OSError) as error:
            raise LinkLostError(f"CAN bus {self._bus.channel_info} does not take a frame: {error}") from error

    def deliver(self, message: can.Message) -> None:
        """Pass a frame to the drive; extended and error frames are ignored."""
        if message.is_remote_frame and not message.is_extended_id:
            self.slave.on_remote(message.arbitration_id, self._clock.now_ns())
        elif not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
            self.layer.on_frame(message.arbitration_id, bytes(message.data), self._clock.now_ns())

    def bearable(self, now_ns: int) -> int:
        """For SimClock: ns until the next scheduled time, at most the interval of supervision."""
        due_ns = self.layer.due_ns()
        return SUPERVISION_NS if due_ns is None else min(SUPERVISION_NS, due_ns - now_ns)
