"""Modbus peers of bare sockets and terminals that misbehave: every call ends in its time with the error that says why.

Times are real, so bounds are the stated ones with room for a busy machine; what is kept out is waiting for ever, or for as long as
the peer likes.
"""

from __future__ import annotations

import itertools
import os
import re
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest

from drivers.clock import IO_SLICE_S, WallClock
from drivers.errors import AbortError, BridgeError, LinkLostError, NoAnswerError, OtherAnswerError, ProtocolError
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import Doubt, LinkPolicy, ModbusLink
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.wire import PymodbusWire, Request
from hil.app.main import main
from sim_backends.modbus_framing import Frame, RtuDecoder, TcpDecoder, pack_rtu, pack_tcp

pytestmark = pytest.mark.outside

TIMEOUT_S = 0.4  # a peer is a Python thread: on a busy machine it answers in tenths of a second
PATIENT_S = 8.0  # a time-out that is not to be waited out
ROOM_S = 3.0  # for a machine that is busy with other things
HOLDING = AddressSpace.HOLDING
STOP = Request.write(HOLDING, 0x2100, (2,))
POLICY = LinkPolicy(read_retries=1, quiet_s=0.02)

Send = Callable[[bytes], None]
Peer = Callable[[Frame, Send], None]
"""peer(request, send): what it does about a request; may take its time, and raise OSError when the other side is gone."""


class Operator:
    """How time passes for a `WallClock`, until somebody presses the stop."""

    def __init__(self) -> None:
        self.pressed = threading.Event()
        self.pressed_s = 0.0

    def press(self) -> None:
        self.pressed_s = time.monotonic()
        self.pressed.set()

    def press_in(self, delay_s: float) -> None:
        threading.Timer(delay_s, self.press).start()

    def real(self, duration_s: float) -> None:
        if self.pressed.wait(duration_s):
            self.pressed.clear()
            raise KeyboardInterrupt

    def simulated(self, now_ns: int) -> None:
        raise NotImplementedError


class Seen:
    """Frames that a peer got, by when."""

    def __init__(self) -> None:
        self.frames: list[tuple[float, Frame]] = []
        self.more = threading.Condition()

    def note(self, frame: Frame) -> None:
        with self.more:
            self.frames.append((time.monotonic(), frame))
            self.more.notify_all()

    def first(self, pdu: bytes) -> float:
        """When the first frame with this PDU came; waits for it."""

        def times() -> list[float]:
            return [at for at, frame in self.frames if frame.pdu == pdu]

        with self.more:
            assert self.more.wait_for(times, ROOM_S), f"not among {[frame.pdu.hex() for _, frame in self.frames]}"
            return times()[0]


@contextmanager
def tcp_peer(peer: Peer, seen: Seen | None = None) -> Iterator[TcpEndpoint]:
    """Each connection in a thread of its own."""
    connections: list[socket.socket] = []
    threads: list[threading.Thread] = []
    listener = socket.create_server(("127.0.0.1", 0))

    def serve(connection: socket.socket) -> None:
        decoder = TcpDecoder()
        with connection, suppress(OSError):
            while data := connection.recv(4096):
                for frame in decoder.feed(data):
                    if seen is not None:
                        seen.note(frame)
                    peer(frame, connection.sendall)

    def accept() -> None:
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                connections.append(connection)
                threads.append(threading.Thread(target=serve, args=(connection,)))
                threads[-1].start()

    accepting = threading.Thread(target=accept)
    accepting.start()
    try:
        yield TcpEndpoint("127.0.0.1", listener.getsockname()[1], TIMEOUT_S)
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        accepting.join()
        listener.close()
        for connection in connections:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()


@contextmanager
def rtu_peer(peer: Peer, seen: Seen | None = None, timeout_s: float = TIMEOUT_S) -> Iterator[RtuEndpoint]:
    master, slave = os.openpty()
    tty.setraw(slave)
    over = threading.Event()

    def send(data: bytes) -> None:
        if over.is_set():
            raise OSError("over")
        with suppress(BlockingIOError):
            os.write(master, data)

    def serve() -> None:
        decoder = RtuDecoder()
        with suppress(OSError):
            while not over.is_set():
                try:
                    frames = decoder.feed(os.read(master, 4096))
                except BlockingIOError:
                    over.wait(0.001)
                    continue
                for frame in frames:
                    if seen is not None:
                        seen.note(frame)
                    peer(frame, send)

    os.set_blocking(master, False)
    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield RtuEndpoint(os.ttyname(slave), 115_200, "N", timeout_s=timeout_s)
    finally:
        over.set()
        thread.join()
        os.close(slave)
        os.close(master)


@contextmanager
def linked(endpoint: Endpoint, operator: Operator | None = None) -> Iterator[ModbusLink]:
    link = ModbusLink(endpoint, WallClock(operator), policy=POLICY)
    link.open()
    try:
        yield link
    finally:
        link.close()


# -- peers -------------------------------------------------------------------------------------------------------------
def reply_to(request: Frame, *registers: int) -> Frame:
    if request.pdu[0] == 3:
        return request.with_pdu(bytes((3, 2 * len(registers))) + b"".join(r.to_bytes(2, "big") for r in registers))
    return request.with_pdu(request.pdu[:5])


def honest(request: Frame) -> Frame:
    count = int.from_bytes(request.pdu[3:5], "big")
    return reply_to(request, *range(1, count + 1)) if request.pdu[0] == 3 else reply_to(request)


def packed(frame: Frame) -> bytes:
    return pack_tcp(frame) if frame.transaction else pack_rtu(frame)


def silent(request: Frame, send: Send) -> None: ...


def good(request: Frame, send: Send) -> None:
    send(packed(honest(request)))


def dribbling(request: Frame, send: Send) -> None:
    """One byte at a time, each well within the time-out; the whole reply not."""
    for byte in packed(honest(request)):
        send(bytes((byte,)))
        time.sleep(0.6 * TIMEOUT_S)


def garbage(request: Frame, send: Send) -> None:
    for number in itertools.count():
        send(bytes((number * 37 + place * 11) % 251 for place in range(50)))
        time.sleep(0.001)


def others_numbers(request: Frame, send: Send) -> None:
    reply = honest(request)
    for number in itertools.count(1):
        send(pack_tcp(Frame(reply.unit, reply.pdu, (request.transaction + number) % 0x7FFF + 0x8000)))
        time.sleep(0.004)  # always within a slice, and for longer than a stop may take


def unnumbered(request: Frame, send: Send) -> None:
    reply = honest(request)
    send(pack_tcp(Frame(reply.unit, reply.pdu, 0)))


def oversized(request: Frame, send: Send) -> None:
    """The header announces 65535 bytes, and they never end."""
    send(request.transaction.to_bytes(2, "big") + b"\0\0\xff\xff" + bytes((request.unit, 3, 4)))
    while True:
        send(b"\0")
        time.sleep(0.3 * TIMEOUT_S)


def other_protocol(request: Frame, send: Send) -> None:
    send(request.transaction.to_bytes(2, "big") + b"\0\x01\0\x07" + bytes((request.unit, 3, 4, 0, 1, 0, 2)))


def another_unit(request: Frame, send: Send) -> None:
    reply = honest(request)
    send(packed(Frame(reply.unit + 1, reply.pdu, reply.transaction)))


def another_function(request: Frame, send: Send) -> None:
    send(packed(request.with_pdu(bytes((4, 4, 0, 1, 0, 2)))))


def unknown_function(request: Frame, send: Send) -> None:
    send(packed(request.with_pdu(bytes((0x65, 4, 0, 1, 0, 2)))))


def busy(request: Frame, send: Send) -> None:
    send(packed(request.with_pdu(bytes((request.pdu[0] | 0x80, 6)))))


def acknowledging(request: Frame, send: Send) -> None:
    send(packed(request.with_pdu(bytes((request.pdu[0] | 0x80, 5)))))


def hanging_up(request: Frame, send: Send) -> None:
    raise ConnectionError("hangs up on every request")


TCP_PEERS: list[tuple[Peer, type[BridgeError]]] = [
    (silent, NoAnswerError),
    (dribbling, NoAnswerError),
    (garbage, NoAnswerError),
    (others_numbers, NoAnswerError),
    (unnumbered, NoAnswerError),
    (oversized, NoAnswerError),
    (other_protocol, NoAnswerError),
    (another_unit, OtherAnswerError),
    (another_function, ProtocolError),
    (unknown_function, ProtocolError),
    (busy, AbortError),
    (acknowledging, AbortError),
    (hanging_up, LinkLostError),
]
RTU_PEERS: list[tuple[Peer, tuple[type[BridgeError], ...]]] = [
    (silent, (NoAnswerError,)),
    (dribbling, (NoAnswerError,)),
    (garbage, (NoAnswerError, ProtocolError, AbortError)),  # two bytes of noise may stand for a refusal with its check
    (another_unit, (OtherAnswerError,)),
    (another_function, (ProtocolError,)),
    (busy, (AbortError,)),
    (acknowledging, (AbortError,)),
]
# a read and its repeat, each parted from a late reply by another exchange; the pauses of a busy unit
BOUND_S = 4 * (TIMEOUT_S + 256 * 11 / 115_200 + 0.1) + 6 * 0.1


@pytest.mark.parametrize(("peer", "error"), TCP_PEERS, ids=[peer.__name__ for peer, _ in TCP_PEERS])
def test_a_read_from_a_server_that_misbehaves_ends(peer: Peer, error: type[BridgeError]) -> None:
    with tcp_peer(peer) as endpoint, linked(endpoint) as link:
        started_s = time.monotonic()
        with pytest.raises(error):
            link.read(1, HOLDING, Span(0, 2))
        assert time.monotonic() - started_s < BOUND_S + ROOM_S


@pytest.mark.parametrize(("peer", "errors"), RTU_PEERS, ids=[peer.__name__ for peer, _ in RTU_PEERS])
def test_a_read_from_a_unit_that_misbehaves_ends(peer: Peer, errors: tuple[type[BridgeError], ...]) -> None:
    with rtu_peer(peer) as endpoint, linked(endpoint) as link:
        started_s = time.monotonic()
        with pytest.raises(errors):
            link.read(1, HOLDING, Span(0, 2))
        assert time.monotonic() - started_s < BOUND_S + ROOM_S


@pytest.mark.parametrize("bit", [0, 11, 40], ids=["unit", "function", "value"])
def test_a_damaged_reply_on_a_serial_line_costs_one_request_that_is_repeated_or_read_back(bit: int) -> None:
    seen = Seen()

    def peer(request: Frame, send: Send) -> None:
        reply = bytearray(packed(reply_to(request, *(7, 8)[: request.pdu[4]])))
        if len(seen.frames) == 1:
            reply[bit // 8] ^= 1 << bit % 8
        send(bytes(reply))

    for order in (
        lambda link: link.read(1, HOLDING, Span(0, 2)) == (7, 8),
        lambda link: link.write(1, HOLDING, 0, (7, 8)) is None,
    ):
        seen.frames.clear()
        with rtu_peer(peer, seen) as endpoint, linked(endpoint) as link:
            assert order(link)
            assert (
                1 < len(seen.frames) <= 3
            )  # the first reply was not taken: one register to settle the line, and once more
        assert sum(frame.pdu[0] == 16 for _, frame in seen.frames) <= 1  # a write is sent once


def answering_as(unit: int) -> Peer:
    """Every request is answered, whatever unit it names, as this one."""

    def peer(request: Frame, send: Send) -> None:
        send(packed(Frame(unit, honest(request).pdu, request.transaction)))

    return peer


@pytest.mark.parametrize(("wire", "unit", "asked"), [("tcp", 0, 1), ("tcp", 1, 5), ("tcp", 255, 3), ("rtu", 2, 1)])
def test_a_reply_of_another_unit_names_both_and_what_to_try(wire: str, unit: int, asked: int) -> None:
    with (tcp_peer if wire == "tcp" else rtu_peer)(answering_as(unit)) as endpoint, linked(endpoint) as link:
        words = f"answered as unit {unit}, asked was unit {asked}: try unit = {unit}"
        with pytest.raises(OtherAnswerError, match=words):
            link.read(asked, HOLDING, Span(0, 2))
        with pytest.raises(NoAnswerError, match=words):
            link.write(asked, HOLDING, 0, (1, 2))
        assert link.read(unit, HOLDING, Span(0, 2)) == (1, 2)


@pytest.mark.parametrize(("unit", "also"), [(0, "1-16"), (1, "2-16"), (9, "1-8,10-16"), (255, "1-16")])
def test_a_scan_lists_a_server_that_answers_every_request_as_one_unit(
    unit: int, also: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with tcp_peer(answering_as(unit)) as endpoint:
        assert main(["scan", "--tcp", str(endpoint), "--timeout", "5"]) == 0
    said = capsys.readouterr().out
    assert f"unit {unit} answered when unit {also} was asked: give unit = {unit}" in said
    assert f"--unit {unit}," in said
    assert re.search(rf"(?m)^ +{unit} +registers", said)


def test_a_scan_of_a_line_says_when_one_unit_answers_for_another(capsys: pytest.CaptureFixture[str]) -> None:
    with rtu_peer(answering_as(2)) as endpoint:
        line = ["--serial", f"{endpoint.device}?parity=N", "--baud", "115200", "--units", "1-2"]
        assert main(["scan", *line, "--timeout", "0.2"]) == 0
    assert "unit 2 answered when unit 1 was asked: give unit = 2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (lambda request: reply_to(request, 7), "reply holds 1 values, expected 2: does it give fewer at once"),
        (lambda request: reply_to(request, 7, 8, 9), "reply holds 3 values, expected 2"),
        (lambda request: request.with_pdu(b"\x04\x04\0\1\0\2"), "reply to function 4"),
    ],
)
def test_a_reply_of_another_length_or_function_is_said(reply: Callable[[Frame], Frame], words: str) -> None:
    def peer(request: Frame, send: Send) -> None:
        send(packed(reply(request)))

    with tcp_peer(peer) as endpoint, linked(endpoint) as link, pytest.raises(ProtocolError, match=words):
        link.read(1, HOLDING, Span(0, 2))


@pytest.mark.parametrize("place", [2, 4], ids=["address", "value or count"])
@pytest.mark.parametrize("values", [(1,), (1, 2)], ids=["function 6", "function 16"])
def test_a_write_whose_reply_names_another_place_or_value_is_read_back(values: tuple[int, ...], place: int) -> None:
    asked = []

    def wrong_echo(request: Frame, send: Send) -> None:
        reply = bytearray(honest(request).pdu)
        asked.append(reply[0])
        if reply[0] != 3:
            reply[place] ^= 8
        send(packed(request.with_pdu(bytes(reply))))

    with tcp_peer(wrong_echo) as endpoint, linked(endpoint) as link:
        link.write(1, HOLDING, 5, values)
    assert asked == [6 if len(values) == 1 else 16, 3]


@pytest.mark.parametrize("peer", [silent, dribbling, garbage, others_numbers, another_function, hanging_up])
def test_a_start_bit_to_a_server_that_misbehaves_is_sent_once(peer: Peer) -> None:
    seen = Seen()
    with tcp_peer(peer, seen) as endpoint, linked(endpoint) as link:
        with pytest.raises(NoAnswerError, match="whether it was carried out is unknown"):
            link.write(1, HOLDING, 30, (1,), doubt=Doubt.RAISE)
        assert [frame.pdu[0] for _, frame in seen.frames] == [6]


def test_a_write_that_is_acknowledged_for_ever_is_sent_once_and_looked_for() -> None:
    seen = Seen()

    def working(request: Frame, send: Send) -> None:
        (acknowledging if request.pdu[0] == 6 else good)(request, send)

    with tcp_peer(working, seen) as endpoint, linked(endpoint) as link:
        with pytest.raises(NoAnswerError, match=r"acknowledge, still working.*still reads 1, expected 77"):
            link.write(1, HOLDING, 5, (77,))
        link.write(1, HOLDING, 5, (1,))  # what it then reads: carried out
    assert [frame.pdu[0] for _, frame in seen.frames].count(6) == 2


def test_a_server_that_hangs_up_after_each_answer_is_dialled_again() -> None:
    def once(request: Frame, send: Send) -> None:
        good(request, send)
        raise ConnectionError("once")

    with tcp_peer(once) as endpoint, linked(endpoint) as link:
        for _ in range(3):
            assert link.read(1, HOLDING, Span(0, 2)) == (1, 2)


def test_a_reply_torn_into_bytes_is_read_when_it_comes_in_time() -> None:
    def torn(request: Frame, send: Send) -> None:
        for byte in packed(honest(request)):
            send(bytes((byte,)))

    with tcp_peer(torn) as endpoint, linked(endpoint) as link:
        assert link.read(1, HOLDING, Span(0, 3)) == (1, 2, 3)
    with rtu_peer(torn) as serial, linked(serial) as link:
        assert link.read(1, HOLDING, Span(0, 3)) == (1, 2, 3)


def test_a_port_that_takes_no_bytes_is_lost_in_time() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        wire = PymodbusWire(RtuEndpoint(os.ttyname(slave), 115_200, "N", timeout_s=TIMEOUT_S))
        wire.connect()
        os.set_blocking(slave, False)
        for _ in range(10):  # the kernel moves what was written on, which makes room for a while
            with suppress(BlockingIOError):
                while True:
                    os.write(slave, bytes(4096))
            time.sleep(0.01)
        started_s = time.monotonic()
        with pytest.raises(LinkLostError, match="accepts no bytes"):
            wire.exchange(1, Request.read(HOLDING, Span(0, 1)))
        assert time.monotonic() - started_s < TIMEOUT_S + ROOM_S
        wire.disconnect()
    finally:
        os.close(slave)
        os.close(master)


# -- the operator ------------------------------------------------------------------------------------------------------
HEARD_S = 0.5  # within 50 ms on a machine that is not busy; a time-out would be 16 times as long


def heard(operator: Operator, waiting: Callable[[], object]) -> None:
    operator.press_in(0.05)
    with pytest.raises(KeyboardInterrupt):
        waiting()
    assert time.monotonic() - operator.pressed_s < HEARD_S


def patient(endpoint: TcpEndpoint) -> TcpEndpoint:
    return TcpEndpoint(endpoint.host, endpoint.port, PATIENT_S)


@pytest.mark.parametrize("peer", [silent, dribbling, others_numbers])
def test_the_operator_is_heard_while_a_server_is_waited_for(peer: Peer) -> None:
    operator = Operator()
    with tcp_peer(peer) as endpoint, linked(patient(endpoint), operator) as link:
        heard(operator, lambda: link.read(1, HOLDING, Span(0, 2)))


def test_the_operator_is_heard_while_a_unit_on_a_serial_line_is_waited_for() -> None:
    operator = Operator()
    with rtu_peer(silent, timeout_s=PATIENT_S) as endpoint, linked(endpoint, operator) as link:
        heard(operator, lambda: link.read(1, HOLDING, Span(0, 2)))


def test_the_operator_is_heard_while_a_server_is_dialled() -> None:
    operator = Operator()
    with socket.create_server(("127.0.0.1", 0), backlog=0) as full:
        queued = [socket.socket() for _ in range(4)]  # nobody accepts: the next to connect waits
        for connection in queued:
            connection.setblocking(False)
            connection.connect_ex(full.getsockname())
        link = ModbusLink(TcpEndpoint("127.0.0.1", full.getsockname()[1], PATIENT_S), WallClock(operator))
        heard(operator, link.open)
        for connection in queued:
            connection.close()


def test_the_operator_is_heard_while_another_thread_has_the_line() -> None:
    operator, seen = Operator(), Seen()
    with rtu_peer(silent, seen, timeout_s=1.5) as endpoint:
        link = ModbusLink(endpoint, WallClock(), policy=LinkPolicy(read_retries=0))
        link.open()

        def hold() -> None:
            with suppress(BridgeError):
                link.read(1, HOLDING, Span(0, 2))

        holder = threading.Thread(target=hold)
        holder.start()
        while not seen.frames:
            time.sleep(0.001)
        link.clock = WallClock(operator)  # the second user's
        heard(operator, lambda: link.read(2, HOLDING, Span(0, 2)))
        holder.join()
        link.close()


def test_the_operator_is_heard_while_noise_is_discarded() -> None:
    operator = Operator()

    def noisy(request: Frame, send: Send) -> None:
        while request.pdu[0] != 0:
            send(b"\x55")
            time.sleep(0.002)

    with rtu_peer(noisy) as endpoint, linked(endpoint, operator) as link:
        link.post(1, [STOP])  # something comes in that nobody waits for
        heard(operator, lambda: link.read(1, HOLDING, Span(0, 2)))


def test_a_loop_of_quick_exchanges_hears_the_operator_too() -> None:
    operator = Operator()
    with tcp_peer(good) as endpoint, linked(patient(endpoint), operator) as link:

        def read_on() -> None:
            while True:
                link.read(1, HOLDING, Span(0, 2))

        heard(operator, read_on)


# -- stops -------------------------------------------------------------------------------------------------------------
STOP_PDU = bytes.fromhex("06 21 00 00 02")


def in_the_middle(link: ModbusLink, seen: Seen) -> threading.Thread:
    """Another thread that waits for a reply."""

    def read() -> None:
        with suppress(BridgeError):
            link.read(1, HOLDING, Span(0, 2))

    thread = threading.Thread(target=read)
    thread.start()
    seen.first(bytes.fromhex("03 00 00 00 02"))
    return thread


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_a_stop_leaves_beside_the_exchange_of_another_thread(wire: str) -> None:
    """With a dead unit: otherwise it would wait for that thread's time-outs."""
    seen, over = Seen(), threading.Event()
    peer = tcp_peer(silent, seen) if wire == "tcp" else rtu_peer(silent, seen, timeout_s=2.0)
    with peer as endpoint:
        slow = TcpEndpoint(endpoint.host, endpoint.port, 2.0) if isinstance(endpoint, TcpEndpoint) else endpoint
        link = ModbusLink(slow, WallClock(), policy=LinkPolicy(read_retries=0))
        link.open()
        thread = in_the_middle(link, seen)
        started_s = time.monotonic()
        link.post(1, [STOP])
        assert time.monotonic() - started_s < 0.5
        assert seen.first(STOP_PDU) - started_s < 0.5
        thread.join()
        over.set()
        link.close()


def test_on_a_serial_line_the_stop_comes_once_more_when_the_line_is_free() -> None:
    seen = Seen()
    with rtu_peer(silent, seen, timeout_s=0.4) as endpoint, linked(endpoint) as link:
        thread = in_the_middle(link, seen)
        link.post(1, [STOP])
        thread.join()
        assert [frame.pdu for _, frame in seen.frames].count(STOP_PDU) == 2


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_the_answer_to_a_stop_is_taken_for_no_other(wire: str) -> None:
    with tcp_peer(good) if wire == "tcp" else rtu_peer(good) as endpoint, linked(endpoint) as link:
        for _ in range(5):
            link.post(1, [STOP, STOP])
            assert link.read(1, HOLDING, Span(0, 2)) == (1, 2)
            link.write(1, HOLDING, 0x2100, (1,))


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_a_stop_after_an_exchange_that_was_broken_off_leaves_at_once_and_old_replies_harm_nothing(wire: str) -> None:
    seen, operator, release = Seen(), Operator(), threading.Event()

    def late(request: Frame, send: Send) -> None:
        """The first reply waits for the stop, and comes before its answer."""
        if request.pdu == STOP_PDU:
            release.set()
            send(packed(reply_to(held[0], 7, 7)))
        elif not held:
            held.append(request)
            return
        good(request, send)

    held: list[Frame] = []
    with tcp_peer(late, seen) if wire == "tcp" else rtu_peer(late, seen, timeout_s=PATIENT_S) as endpoint:
        slow = patient(endpoint) if isinstance(endpoint, TcpEndpoint) else endpoint
        with linked(slow, operator) as link:
            heard(operator, lambda: link.read(1, HOLDING, Span(0, 2)))
            started_s = time.monotonic()
            link.post(1, [STOP])
            assert seen.first(STOP_PDU) - started_s < 0.5
            assert link.read(1, HOLDING, Span(0, 2)) == (1, 2)


def test_a_stop_to_a_server_that_hung_up_goes_over_a_new_connection() -> None:
    seen = Seen()

    def once(request: Frame, send: Send) -> None:
        good(request, send)
        if request.pdu[0] == 3:
            raise ConnectionError("once")

    with tcp_peer(once, seen) as endpoint, linked(endpoint) as link:
        link.read(1, HOLDING, Span(0, 2))
        time.sleep(10 * IO_SLICE_S)
        link.post(1, [STOP])
        seen.first(STOP_PDU)


def test_a_stop_to_a_server_that_is_gone_holds_nobody_up() -> None:
    with tcp_peer(good) as endpoint:
        link = ModbusLink(endpoint, WallClock(), policy=POLICY)
        link.open()
    started_s = time.monotonic()
    link.post(1, [STOP])
    assert time.monotonic() - started_s < 0.5
    link.close()
    link.post(1, [STOP])


def test_several_stops_on_a_serial_line_wait_for_each_others_answers() -> None:
    """One frame at a time, also where two drives of the line are stopped one after the other."""
    seen = Seen()
    gap_s: list[float] = []

    def slow(request: Frame, send: Send) -> None:
        time.sleep(0.005)
        gap_s.append(time.monotonic())
        good(request, send)

    with rtu_peer(slow, seen) as endpoint, linked(endpoint) as link:
        link.post(1, [STOP])
        link.post(2, [STOP])
        seen.first(STOP_PDU)
        with seen.more:
            assert seen.more.wait_for(lambda: len(seen.frames) == 2, ROOM_S)
        assert seen.frames[1][1].unit == 2
        assert seen.frames[1][0] - gap_s[0] >= 0.0015  # the answer, and the silent interval of 1.75 ms
