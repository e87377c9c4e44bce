"""Simulated drives on a real Modbus wire: a TCP server on loopback, a slave on a pseudo-terminal, or a `Line` in this process.

Ports, the one thread behind them, and the faults of the wire. Frames are in `modbus_framing`, registers in the faces.
One lock makes receive-and-handle one step, so that everything received before simulated time advances has been handled by then.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import os
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError, LinkLostError
from sim_backends.clock import Advance, SimClock
from sim_backends.faults import WireFaultKind
from sim_backends.modbus_faults import WireFault, WireFaultPlan
from sim_backends.modbus_framing import Frame, RtuDecoder, TcpDecoder, pack_rtu, pack_tcp
from sim_backends.modbus_registers import GATEWAY_NO_RESPONSE, Face, answer

_SILENCE_S = 0.02  # real time without a byte that ends an RTU frame whose length does not follow from its function, s
_FOREVER_NS = 3600 * NS_PER_S


@dataclass
class _Port:
    """A file descriptor on which requests come in; a negative one: a `Line`, which has none."""

    handle: int
    send: Callable[[bytes], None]
    hang_up: Callable[[], None]
    decoder: TcpDecoder | RtuDecoder
    held: bytes = b""  # sent before the next reply

    @property
    def serial(self) -> bool:
        return isinstance(self.decoder, RtuDecoder)


@dataclass(order=True)
class _Late:
    due_ns: int
    number: int
    port: _Port = field(compare=False)
    data: bytes = field(compare=False)


class ModbusServer:
    """Units on one wire. faces: unit id -> `Face`. Start it with `tcp_server` or `rtu_slave` below; a `line` needs no start.

    `faults.add(...)` arms a fault at any time; `requests` is the number received, `advance` is for the clock. remember: keep every
    request in `seen`. The next `advance`, or `stop`, raises an error of its thread.
    """

    def __init__(self, faces: Mapping[int, Face], faults: Iterable[WireFault] = (), *, remember: bool = True) -> None:
        self.faces = dict(faces)
        self.faults = WireFaultPlan(faults)
        self.requests = 0
        # in real time: advance the machine to the present before an answer; None: requests are handled whenever time advances
        self.catch_up: Callable[[], None] | None = None
        self.seen: list[tuple[int, bytes]] = []  # (unit, PDU) of every request, for tests
        self._remember = remember
        self._now_ns = 0
        self._lock = threading.RLock()
        self._ports: dict[int, _Port] = {}
        self._listener: socket.socket | None = None
        self._late: list[_Late] = []
        self._numbers = itertools.count()
        self._stopping = False
        self._error: BaseException | None = None
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        self._thread = threading.Thread(target=self._run, name="modbus server", daemon=True)

    # -- start and stop ------------------------------------------------------------------------------------------------
    def listen(self, host: str, port: int) -> int:
        """Serve TCP; returns the port. Raises LinkLostError."""
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise LinkLostError(f"Modbus TCP {host}:{port} cannot be served: {error.strerror}") from error
        self._listener.setblocking(False)
        self._start()
        return int(self._listener.getsockname()[1])

    def serve_terminal(self, master: int) -> None:
        """Serve RTU on the master side of a pseudo-terminal, which the caller closes."""
        os.set_blocking(master, False)

        def send(data: bytes) -> None:
            with contextlib.suppress(BlockingIOError):  # without a reader the bytes are lost
                os.write(master, data)

        self._ports[master] = _Port(master, send, lambda: None, RtuDecoder())
        self._start()

    def line(self, *, serial: bool) -> Line:
        """A new line to the units without a socket or thread: a request is handled while it is sent."""
        received = bytearray()
        decoder = RtuDecoder() if serial else TcpDecoder()
        port = _Port(-1 - next(self._numbers), received.extend, lambda: None, decoder)
        with self._lock:
            self._ports[port.handle] = port
        return Line(self, port, received)

    def _start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close everything open; raises an error of the thread."""
        self._stopping = True
        os.write(self._wake_write, b"x")
        if self._thread.ident is not None:
            self._thread.join()
        with self._lock:
            for port in list(self._ports.values()):
                port.hang_up()
            self._ports.clear()
            if self._listener is not None:
                self._listener.close()
                self._listener = None
        os.close(self._wake_read)
        os.close(self._wake_write)
        if self._error is not None:
            raise self._error

    # -- time ----------------------------------------------------------------------------------------------------------
    def advance(self, now_ns: int, _dt_s: float) -> None:
        """Advance the faces to now_ns, and send replies delayed until now. Requests received are handled before, except in real time:
        what arrives while the machine catches up with the present is not of the past. Raises an error of the thread."""
        if self._stopping:
            return
        if self._error is not None:
            raise self._error
        with self._lock:
            if self.catch_up is None:
                self._pump()
            self._now_ns = now_ns
            for face in self.faces.values():
                face.tick(now_ns)
            while self._late and self._late[0].due_ns <= now_ns:
                late = heapq.heappop(self._late)
                if late.port.handle in self._ports:
                    late.port.send(late.data)

    def bearable(self, now_ns: int) -> int:
        """For SimClock: longest next step, ns."""
        with self._lock:
            longest = self._late[0].due_ns - now_ns if self._late else _FOREVER_NS
            return max(1, min([longest, *(face.bearable(now_ns) for face in self.faces.values())]))

    def settle(self) -> None:
        """For SimClock: a sleep is over."""
        if not self._stopping and self.catch_up is None:
            with self._lock:
                self._pump()

    def guard(self, advance: Advance) -> Advance:
        """`advance` under this server's lock: for a servo that is advanced while other processes send requests."""

        def guarded(now_ns: int, dt_s: float) -> None:
            with self._lock:
                advance(now_ns, dt_s)

        return guarded

    # -- receiving -----------------------------------------------------------------------------------------------------
    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            os.write(self._wake_write, b"x")

    def _run(self) -> None:
        try:
            while not self._stopping:
                with self._lock:
                    handles = [self._wake_read, *(handle for handle in self._ports if handle >= 0)]
                    if self._listener is not None:
                        handles.append(self._listener.fileno())
                    waiting = any(
                        isinstance(port.decoder, RtuDecoder) and port.decoder.waiting for port in self._ports.values()
                    )
                try:
                    ready = select.select(handles, [], [], _SILENCE_S if waiting else None)[0]
                except (OSError, ValueError):
                    continue  # a port was closed between the two lines
                with self._lock:
                    if self.catch_up is not None:
                        self.catch_up()
                    if ready:
                        self._pump()
                    else:
                        self._silence()
        except BaseException as error:  # noqa: BLE001 - `advance` or `stop` raises it
            self._error = error

    def _pump(self) -> None:
        """Handle everything that has been received, without waiting."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 64)
        if self._listener is not None:
            with contextlib.suppress(
                BlockingIOError, ConnectionError
            ):  # no connection waits, or it was closed before it was accepted
                while True:
                    self._accept(self._listener.accept()[0])
        for port in list(self._ports.values()):
            self._receive(port)

    def _accept(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        with contextlib.suppress(OSError):  # it may be closed already: the next read handles that
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        handle = connection.fileno()

        def send(data: bytes) -> None:
            with contextlib.suppress(OSError):  # the peer is gone: the next read handles that
                connection.send(data)

        self._ports[handle] = _Port(handle, send, connection.close, TcpDecoder())
        self._wake()  # the thread has to watch it too, whichever thread accepted it

    def _receive(self, port: _Port) -> None:
        while port.handle >= 0 and port.handle in self._ports:
            try:
                data = os.read(port.handle, 4096)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._hang_up(port)
                return
            self._feed(port, data)

    def _feed(self, port: _Port, data: bytes) -> None:
        for frame in port.decoder.feed(data):
            self._handle(port, frame)
        if isinstance(port.decoder, TcpDecoder) and port.decoder.broken:
            self._hang_up(port)

    def _silence(self) -> None:
        for port in list(self._ports.values()):
            if isinstance(port.decoder, RtuDecoder):
                for frame in port.decoder.silence():
                    self._handle(port, frame)

    def _hang_up(self, port: _Port) -> None:
        if self._ports.pop(port.handle, None) is not None:
            port.hang_up()

    # -- answering -----------------------------------------------------------------------------------------------------
    def _handle(self, port: _Port, request: Frame) -> None:
        if port.handle not in self._ports:
            return
        self.requests += 1
        if self._remember:
            self.seen.append((request.unit, request.pdu))
        function = request.pdu[0] if request.pdu else 0
        fault = self.faults.hit_by(request.unit, function)
        face = self.faces.get(request.unit)
        if face is None:
            if not port.serial:  # a gateway answers for a missing unit; on a serial line there is no answer
                self._reply(port, request.with_pdu(bytes((function | 0x80, GATEWAY_NO_RESPONSE))), fault)
            return
        if fault is not None and fault.kind in (WireFaultKind.LOST_REQUEST, WireFaultKind.DROP_REQUEST):
            if fault.kind is WireFaultKind.DROP_REQUEST and not port.serial:
                self._hang_up(port)
            return
        if fault is not None and fault.kind is WireFaultKind.EXCEPTION:
            self._reply(port, request.with_pdu(bytes((function | 0x80, fault.code))), None)
            return
        self._reply(port, request.with_pdu(answer(face, request.pdu)), fault)

    def _reply(self, port: _Port, reply: Frame, fault: WireFault | None) -> None:
        pack = pack_rtu if port.serial else pack_tcp
        if port.held:
            port.send(port.held)
            port.held = b""
        if fault is None:
            port.send(pack(reply))
        elif fault.kind is WireFaultKind.DISPLACED:
            port.held = pack(reply)
        elif fault.kind is WireFaultKind.LATE_REPLY:
            due_ns = self._now_ns + round(fault.delay_s * NS_PER_S)
            heapq.heappush(self._late, _Late(due_ns, next(self._numbers), port, pack(reply)))
        elif fault.kind is WireFaultKind.BAD_CRC:
            data = bytearray(pack(reply))
            data[-1 if port.serial else 2] ^= 0x01
            port.send(bytes(data))
        elif fault.kind in (WireFaultKind.TRUNCATED, WireFaultKind.TORN):
            whole = pack(reply)
            half = len(whole) // 2 + 1
            port.send(whole[:half])
            port.held = whole[half:] if fault.kind is WireFaultKind.TORN else b""
        elif fault.kind is WireFaultKind.WRONG_UNIT:
            port.send(pack(Frame(reply.unit % 247 + 1, reply.pdu, reply.transaction)))
        elif fault.kind is WireFaultKind.WRONG_FUNCTION:
            other = b"\x04" if reply.pdu[:1] == b"\x03" else b"\x03"
            port.send(pack(reply.with_pdu(other + b"\x02\0\0")))
        elif fault.kind is WireFaultKind.WRONG_ECHO:
            port.send(pack(reply.with_pdu(_misplaced(reply.pdu))))
        elif fault.kind is WireFaultKind.SHORT_DATA:
            port.send(pack(reply.with_pdu(_shortened(reply.pdu))))
        elif fault.kind is WireFaultKind.DROP and not port.serial:
            self._hang_up(port)


class Line:
    """The master's end of a line in this process: `ModbusServer.line`. Bytes that were not sent when `send` returns come as simulated
    time passes, or never."""

    def __init__(self, server: ModbusServer, port: _Port, received: bytearray) -> None:
        self._server, self._port, self._received = server, port, received

    @property
    def is_open(self) -> bool:
        """False once either end has hung up."""
        return self._port.handle in self._server._ports

    def send(self, data: bytes) -> None:
        """Handle the requests in it. Raises ConnectionResetError for a line that is closed."""
        with self._server._lock:
            if not self.is_open:
                raise ConnectionResetError("connection lost")
            self._server._feed(self._port, data)

    def take(self) -> bytes:
        """What has come since the last call."""
        with self._server._lock:
            data = bytes(self._received)
            self._received.clear()
            return data

    def close(self) -> None:
        with self._server._lock:
            self._server._hang_up(self._port)


def _shortened(pdu: bytes) -> bytes:
    """A reply to a read with one register (or byte of bits) fewer."""
    less = 2 if pdu[0] in (3, 4) else 1
    if pdu[0] not in (1, 2, 3, 4) or pdu[1] < less:
        return pdu
    return bytes((pdu[0], pdu[1] - less)) + pdu[2:-less]


def _misplaced(pdu: bytes) -> bytes:
    """A reply to a write that names the next address."""
    if pdu[0] not in (5, 6, 15, 16):
        return pdu
    return pdu[:1] + ((int.from_bytes(pdu[1:3], "big") + 1) & 0xFFFF).to_bytes(2, "big") + pdu[3:]


def _attach(server: ModbusServer, clock: Clock) -> None:
    if isinstance(clock, SimClock):
        server.advance(clock.now_ns(), 0.0)
        clock.attach(server.advance, bearable=server.bearable, settle=server.settle)


@contextmanager
def tcp_server(
    faces: Mapping[int, Face],
    clock: Clock,
    *,
    faults: Iterable[WireFault] = (),
    remember: bool = True,
    host: str = "127.0.0.1",
    port: int = 0,
) -> Iterator[tuple[ModbusServer, int]]:
    """Serve units on a TCP address until the block ends; yields the server and its port (0: a free one is chosen).

    Raises LinkLostError.

    With a SimClock it advances the faces (attach the servo before); with another clock the code that advances the servo calls
    `advance`.
    """
    server = ModbusServer(faces, faults, remember=remember)
    try:
        number = server.listen(host, port)
        _attach(server, clock)
        yield server, number
    finally:
        server.stop()


@contextmanager
def rtu_slave(
    faces: Mapping[int, Face], clock: Clock, *, faults: Iterable[WireFault] = (), remember: bool = True
) -> Iterator[tuple[ModbusServer, str]]:
    """Serve units on a new pseudo-terminal until the block ends; yields the server and the path of the port. Raises InputError."""
    for unit in faces:
        if not 1 <= unit <= 247:
            raise InputError(f"unit id is {unit}, expected 1 to 247 on a serial line")
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        server = ModbusServer(faces, faults, remember=remember)
        server.serve_terminal(master)
        _attach(server, clock)
        try:
            yield server, os.ttyname(slave)
        finally:
            server.stop()
    finally:
        os.close(slave)
        os.close(master)
