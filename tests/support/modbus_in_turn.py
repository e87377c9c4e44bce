"""Simulated Modbus drives without a socket, a terminal or a thread: a request is handled while it is sent.

Nothing is waited for: what has not come by then comes when simulated time passes, or never, so that a lost answer costs no time-out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from drivers.listening import Listening
from drivers.modbus.endpoint import Endpoint, RtuEndpoint
from drivers.modbus.ports import Port
from drivers.modbus.wire import PymodbusWire, Wire
from sim_backends.clock import SimClock
from sim_backends.modbus_drive import Line, ModbusServer
from sim_backends.modbus_faults import WireFault
from sim_backends.modbus_registers import Face


class InTurnPort(Port):
    """The driver's end of a line to a server in this process."""

    def __init__(self, server: ModbusServer, *, serial: bool) -> None:
        self._server, self._serial = server, serial
        self._line: Line | None = None

    @property
    def is_open(self) -> bool:
        return self._line is not None and self._line.is_open

    def open(self, within_s: float) -> None:
        self._line = self._server.line(serial=self._serial)

    def close(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _opened(self) -> Line:
        if self._line is None:
            raise ConnectionError("not connected")
        return self._line

    def send(self, frame: bytes) -> None:
        if self._serial:
            self._opened().take()
        self._opened().send(frame)

    def receive(self, within: Listening) -> bytes:
        data = self._opened().take()
        if not data and not self.is_open:
            raise ConnectionResetError("connection lost")
        return data

    def discard(self, silence_s: float) -> None:
        if self._serial:
            self._opened().take()

    def post(self, frames: Sequence[bytes]) -> None:
        with suppress(OSError):
            self._opened().send(b"".join(frames))


@contextmanager
def in_turn(
    faces: Mapping[int, Face], clock: SimClock, *, faults: Iterable[WireFault] = ()
) -> Iterator[tuple[ModbusServer, Callable[[Endpoint], Wire]]]:
    """Units on one wire until the block ends; yields the server and what makes a `ModbusLink` its wire to them."""
    server = ModbusServer(faces, faults)
    server.advance(clock.now_ns(), 0.0)
    clock.attach(server.advance, bearable=server.bearable, settle=server.settle)

    def wire(endpoint: Endpoint) -> Wire:
        port = InTurnPort(server, serial=isinstance(endpoint, RtuEndpoint))
        return PymodbusWire(endpoint, clock.check_interrupt, port)

    try:
        yield server, wire
    finally:
        server.stop()
