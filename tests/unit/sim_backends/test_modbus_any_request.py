"""The simulated Modbus device and server against requests that no client should send."""

import random
import socket

from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_framing import Frame, pack_tcp
from sim_backends.modbus_registers import Face, answer
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo


class Shaft:
    friction_permille = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None: ...


def _faces() -> list[Face]:
    servo = SimulatedServo(Shaft(), ServoParameters(counts_per_rev=60_000))
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


@settings(max_examples=400, deadline=None, derandomize=True)
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
