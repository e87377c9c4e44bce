"""Kinds of misbehaving Modbus server: a TCP proxy between the master and the simulated drive that rewrites whole frames or bytes.

A frame is transaction, protocol 0, length, unit (the MBAP header) and the PDU. The proxy runs in real time, as the line does.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hostile.peer import Kinds, Peer

from drivers.errors import (
    AbortError,
    DriveFaultError,
    LinkLostError,
    MeasurementLostError,
    NoAnswerError,
    ProtocolError,
    SafetyError,
    StateError,
)
from sim_backends.clock import SimClock
from sim_backends.modbus_drive import tcp_server

WIRE = (NoAnswerError, LinkLostError, ProtocolError)
MOTION = (SafetyError, ProtocolError, DriveFaultError, StateError, MeasurementLostError)
WRITES = (5, 6, 15, 16)
Bytes = list[tuple[float, bytes]]
"""Bytes sent instead of a frame: each part after a delay in s of real time."""


class ModbusPeer(Peer):
    """The proxy. reply(request, reply): bytes for the master; request(request): bytes for it without asking the drive."""

    def __init__(self, upstream: int, clock: SimClock) -> None:
        super().__init__(clock)
        self.reply: Callable[[bytes, bytes], Bytes | None] = lambda _request, _reply: None
        self.request: Callable[[bytes], Bytes | None] = lambda _request: None
        self.accepts = True
        self._upstream = upstream
        self._stopping = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._thread = threading.Thread(target=self._run, name="modbus proxy", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        while not self._stopping.is_set():
            if select.select([self._listener], [], [], 0.02)[0]:
                client = self._listener.accept()[0]
                with contextlib.suppress(OSError), client:
                    if self.accepts:
                        with socket.create_connection(("127.0.0.1", self._upstream)) as server:
                            self._serve(client, server)
                    else:
                        self.strike()

    def _serve(self, client: socket.socket, server: socket.socket) -> None:
        for each in (client, server):
            each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        server.settimeout(5.0)
        while not self._stopping.is_set():
            if not self.accepts:
                return
            if not select.select([client], [], [], 0.02)[0]:
                continue
            request = _frame(client)
            if not request:
                return
            parts = self.request(request)
            if parts is None:
                server.sendall(request)
                reply = _frame(server)
                parts = self.reply(request, reply)
                if parts is None:
                    client.sendall(reply)
                    continue
            self.strike()
            for delay_s, part in parts:
                if delay_s:
                    time.sleep(delay_s)
                client.sendall(part)


def _frame(connection: socket.socket) -> bytes:
    head = _exactly(connection, 6)
    return head + _exactly(connection, int.from_bytes(head[4:6], "big")) if head else b""


def _exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            return b""
        data += more
    return data


def stand_in(on_peer: Callable[[ModbusPeer], None]) -> Callable[..., Any]:
    """Replacement of `tcp_server`: the server behind a proxy, whose port is returned."""

    @contextmanager
    def served(faces: Any, clock: SimClock, **settings: Any) -> Iterator[tuple[Any, int]]:
        with tcp_server(faces, clock, **settings) as (server, port):
            proxy = ModbusPeer(port, clock)
            try:
                on_peer(proxy)
                yield server, proxy.port
            finally:
                proxy.close()

    return served


# -- the kinds -----------------------------------------------------------------------------------------------------------
MODBUS_KINDS = kinds = Kinds()


def _with_pdu(frame: bytes, pdu: bytes) -> bytes:
    return frame[:4] + (len(pdu) + 1).to_bytes(2, "big") + frame[6:7] + pdu


@kinds("the unit is silent", *WIRE, unreachable=True)
def _(peer: ModbusPeer) -> None:
    peer.request = lambda _request: []


@kinds("replies are lost", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, _reply: []


@kinds("replies dribble, a byte each 20 ms", *WIRE, *MOTION, passes=True)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.02, reply[i : i + 1]) for i in range(len(reply))]


@kinds("replies dribble and never end", *WIRE)
def _(peer: ModbusPeer) -> None:
    def dribble(_request: bytes, reply: bytes) -> Bytes:
        endless = reply[:4] + b"\0\xfe" + reply[6:8] + bytes(40)
        return [(0.03, endless[i : i + 1]) for i in range(len(endless))]

    peer.reply = dribble


@kinds("replies are garbage", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.0, peer.random.randbytes(len(reply)))]


@kinds("replies carry another transaction", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.0, bytes((reply[0], reply[1] ^ 0x55)) + reply[2:])]


@kinds("replies come from another unit", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.0, reply[:6] + bytes((reply[6] + 1,)) + reply[7:])]


@kinds("replies are of the request before", *WIRE, *MOTION, passes=True)
def _(peer: ModbusPeer) -> None:
    kept: list[bytes] = []

    def stale(request: bytes, reply: bytes) -> Bytes:
        kept.append(reply)
        return [(0.0, request[:2] + (kept.pop(0) if len(kept) > 1 else reply)[2:])]

    peer.reply = stale


@kinds("another reply comes before each", *WIRE, passes=True)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.0, bytes((reply[0] ^ 0x40,)) + reply[1:] + reply)]


@kinds("the length is oversized", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.0, reply[:4] + b"\xff\xff" + reply[6:])]


@kinds("the length is too small", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.0, reply[:4] + b"\0\2" + reply[6:])]


@kinds("the byte count lies", *WIRE)
def _(peer: ModbusPeer) -> None:
    def lie(_request: bytes, reply: bytes) -> Bytes | None:
        return [(0.0, reply[:8] + bytes((reply[8] ^ 2,)) + reply[9:])] if reply[7] in (3, 4) else None

    peer.reply = lie


@kinds("busy for ever", AbortError, *WIRE, unreachable=True)
def _(peer: ModbusPeer) -> None:
    peer.request = lambda request: [(0.0, _with_pdu(request, bytes((request[7] | 0x80, 6))))]


@kinds("every request is refused", AbortError, *WIRE, unreachable=True)
def _(peer: ModbusPeer) -> None:
    peer.request = lambda request: [(0.0, _with_pdu(request, bytes((request[7] | 0x80, 4))))]


@kinds("every write is refused", AbortError, *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.request = lambda request: (
        [(0.0, _with_pdu(request, bytes((request[7] | 0x80, 4))))] if request[7] in WRITES else None
    )


@kinds("writes are acknowledged and not carried out", *WIRE, *MOTION)
def _(peer: ModbusPeer) -> None:
    peer.request = lambda request: [(0.0, _with_pdu(request, request[7:12]))] if request[7] in WRITES else None


@kinds("the state is frozen", *WIRE, *MOTION)
def _(peer: ModbusPeer) -> None:
    kept: dict[bytes, bytes] = {}

    def freeze(request: bytes, reply: bytes) -> Bytes | None:
        if request[7] in WRITES:
            return None
        return [(0.0, reply[:2] + kept.setdefault(request[6:], reply)[2:])]

    peer.reply = freeze


@kinds("the connection is closed each time", *WIRE, unreachable=True)
def _(peer: ModbusPeer) -> None:
    def close(_request: bytes) -> Bytes:
        raise ConnectionResetError

    peer.strike()
    peer.request = close


@kinds("no connection is accepted any more", *WIRE, unreachable=True)
def _(peer: ModbusPeer) -> None:
    peer.strike()
    peer.accepts = False


@kinds("the unit answers after 50 ms", *WIRE, *MOTION, passes=True)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.05, reply)]


@kinds("the unit answers after the time-out", *WIRE)
def _(peer: ModbusPeer) -> None:
    peer.reply = lambda _request, reply: [(0.6, reply)]
