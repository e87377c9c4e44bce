"""The simulated Modbus device and server against requests that no client should send."""

import random
import socket
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_framing import Frame, pack_tcp
from sim_backends.modbus_registers import Face, answer
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo


def _faces() -> list[Face]:
    servo = SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=60_000))
    return [Cia402Registers(servo), VendorRegisters(servo, counts_per_rev=60_000)]


FACES = _faces()
likely = st.builds(
    lambda function, address, count, rest: (
        bytes((function,)) + address.to_bytes(2, "big") + count.to_bytes(2, "big") + rest
    ),
    st.sampled_from([1, 2, 3, 4, 5, 6, 15, 16]),
    st.one_of(st.integers(0, 300), st.integers(0x1FF0, 0x2600), st.integers(0, 0xFFFF)),
    st.one_of(st.integers(0, 130), st.integers(0, 0xFFFF)),
    st.binary(max_size=40),
)


@settings(max_examples=100, derandomize=True)
@given(pdu=st.one_of(st.binary(max_size=253), likely), which=st.integers(0, 1))
def test_every_request_is_answered_in_kind(pdu: bytes, which: int) -> None:
    reply = answer(FACES[which], pdu)
    assert len(reply) >= 2
    assert len(reply) <= 253
    if pdu:
        assert reply[0] & 0x7F == pdu[0] & 0x7F
        if reply[0] & 0x80:
            assert reply[1] in (1, 2, 3, 4)
    FACES[which].tick(0)


def _order(chance: random.Random, *, vendor: bool) -> bytes:
    """A write that may well make the drive do something: commands, modes, targets, speeds, with extreme values."""
    if vendor:
        places = [(0, 2), (2, 2), (4, 2), (100, 1), (101, 2), (103, 2), (105, 2), (107, 1), (109, 2)]
        if chance.random() < 0.4:
            return b"\5" + chance.randrange(4).to_bytes(2, "big") + chance.choice([b"\xff\0", b"\0\0"])
        if chance.random() < 0.3:
            return b"\6\0\6" + chance.randrange(3).to_bytes(2, "big")
    else:
        places = [(0x2102 + 2 * n, 2) for n in range(5)] + [(0x210C, 1), (0x2200, 1), (0x2400, 2)]
        places += [(0x2202, 2), (0x2204, 2), (0x2206, 2), (0x2402, 2), (0x2404, 2), (0x2406, 2), (0x2600, 1)]
        if chance.random() < 0.3:
            return b"\6\x21\0" + chance.choice([0, 2, 6, 7, 15, 31, 63, 0x80, 0x10F]).to_bytes(2, "big")
        if chance.random() < 0.3:
            return b"\6\x21\1" + chance.choice([0, 1, 3, 6, 8, 9, 10, 0x8000, 0xFFFF]).to_bytes(2, "big")
    address, words = chance.choice(places)
    size = 2 * words
    data = chance.choice([bytes(size), b"\xff" * size, bytes(size - 1) + b"\1", chance.randbytes(size)])
    return b"\x10" + address.to_bytes(2, "big") + words.to_bytes(2, "big") + bytes((size,)) + data


@pytest.mark.parametrize("seed", range(6))
def test_a_drive_under_power_bears_any_orders(seed: int) -> None:
    """A simulator that a master's nonsense kills is no use: nothing it is told may end it, whatever state it is in."""
    chance = random.Random(seed)
    servo = SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=60_000))
    vendor = seed % 2 == 0
    face: Face = VendorRegisters(servo, counts_per_rev=60_000) if vendor else Cia402Registers(servo)
    status = b"\4\0\0\0\x0c" if vendor else b"\3\x20\0\0\x0c"
    now_ns, powered = 0, 0
    for _ in range(400):
        now_ns += chance.choice([1, 5, 20]) * 1_000_000
        servo.advance(now_ns, 0.005)
        face.tick(now_ns)
        answer(face, _order(chance, vendor=vendor))
        assert answer(face, status)[0] == status[0]
        powered += servo.powered
    assert powered > 10


def test_clients_that_come_and_go_rudely_are_borne() -> None:
    request = pack_tcp(Frame(1, b"\4\0\0\0\1", 77))
    at_once = struct.pack("ii", 1, 0)  # close with a reset
    with tcp_server({1: FACES[1]}, SimClock()) as (_, port):
        for number in range(100):
            with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
                client.sendall((b"", request, request[:5], b"noise, no frame", request * 20)[number % 5])
                if number % 3 == 0:
                    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
        with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
            client.sendall(request)
            assert client.recv(100) == pack_tcp(Frame(1, b"\4\2\0\0", 77))


def test_a_server_whose_face_breaks_says_so_at_once() -> None:
    class Broken(VendorRegisters):
        @property
        def max_read(self) -> int:  # type: ignore[override]
            raise ZeroDivisionError("a bug of the face")

    servo = SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=60_000))
    with pytest.raises(ZeroDivisionError, match="a bug of the face"):
        _ask_once(Broken(servo, counts_per_rev=60_000))


def _ask_once(face: Face) -> None:
    clock = SimClock()
    with (
        tcp_server({1: face}, clock) as (server, port),
        socket.create_connection(("127.0.0.1", port), timeout=5) as client,
    ):
        client.sendall(pack_tcp(Frame(1, b"\4\0\0\0\1", 77)))
        server._thread.join(5.0)
        clock.sleep_s(0.001)
        pytest.fail("nobody was told")


def test_the_server_outlives_noise_and_closes_on_it() -> None:
    chance = random.Random(7)
    with tcp_server({1: FACES[1]}, SimClock()) as (_, port):
        for _ in range(30):
            with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
                client.sendall(b"\1\2\3\4" + chance.randbytes(chance.randint(3, 200)))  # no protocol 0: hung up on
                assert client.recv(100) == b""
        with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
            request = pack_tcp(Frame(1, b"\4\0\0\0\1", 77))
            for byte in request:
                client.sendall(bytes((byte,)))
            assert client.recv(100) == pack_tcp(Frame(1, b"\4\2\0\0", 77))
            client.sendall(request * 3)  # several in one segment
            reply = b""
            while len(reply) < 33:
                reply += client.recv(100)
            assert reply == pack_tcp(Frame(1, b"\4\2\0\0", 77)) * 3
