"""Endpoints from text, requests told apart by their replies, and the name this pymodbus has for the unit id."""

import socket
import threading
import time
import tracemalloc
from contextlib import nullcontext, suppress
from unittest.mock import Mock

import pytest
from pymodbus.client import ModbusTcpClient

from drivers.clock import IO_SLICE_S
from drivers.errors import CapabilityError, InputError, LinkLostError, NoAnswerError
from drivers.listening import Listening
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint, parse_endpoint
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.ports import slices
from drivers.modbus.wire import Function, PymodbusWire, Request, over_and_over, unit_keyword


@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("tcp://drive.local", TcpEndpoint("drive.local", 502)),
        ("tcp://127.0.0.1:1502?timeout_s=0.25", TcpEndpoint("127.0.0.1", 1502, 0.25)),
        ("tcp://[::1]:502", TcpEndpoint("::1", 502)),
        ("/dev/ttyUSB0", RtuEndpoint("/dev/ttyUSB0", 115_200, "E", 1)),
        ("rtu:/dev/ttyS1?parity=n&stop_bits=2&timeout_s=0.1", RtuEndpoint("/dev/ttyS1", 115_200, "N", 2, 0.1)),
        ("COM3", RtuEndpoint("COM3", 115_200)),
    ],
)
def test_endpoints_from_text(url: str, endpoint: Endpoint) -> None:
    assert parse_endpoint(url, baud=115_200) == endpoint


@pytest.mark.parametrize(
    ("url", "what"),
    [
        ("tcp://", "lacks a host"),
        ("tcp://host:70000", "port is not a number"),
        ("tcp://host?parity=N", "unknown option parity"),
        ("udp://host", "expected tcp://host:port or a serial device"),
        ("", "expected tcp://host:port or a serial device"),
        ("/dev/ttyS0?parity=X", "expected N, E or O"),
        ("/dev/ttyS0?stop_bits=1.5", "expected 1 or 2"),
        ("/dev/ttyS0?timeout_s=0", "expected seconds > 0"),
        ("/dev/ttyS0?timeout_s=nan", "expected seconds > 0"),
        ("/dev/ttyS0?speed=9600", "unknown option speed"),
    ],
)
def test_bad_endpoints_are_refused(url: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        parse_endpoint(url)


def test_replies_tell_requests_apart_as_far_as_modbus_lets_them() -> None:
    read = Request.read
    assert read(AddressSpace.HOLDING, Span(0, 2)).echo == read(AddressSpace.HOLDING, Span(50, 2)).echo
    assert read(AddressSpace.HOLDING, Span(0, 2)).echo != read(AddressSpace.INPUT, Span(0, 2)).echo
    assert read(AddressSpace.COIL, Span(0, 3)).echo == read(AddressSpace.COIL, Span(9, 8)).echo
    write = Request.write
    assert write(AddressSpace.HOLDING, 5, (1,)).echo != write(AddressSpace.HOLDING, 5, (2,)).echo
    assert write(AddressSpace.HOLDING, 5, (1, 1)).echo == write(AddressSpace.HOLDING, 5, (2, 2)).echo
    assert write(AddressSpace.HOLDING, 5, (1, 1)).echo != write(AddressSpace.HOLDING, 6, (1, 1)).echo


def test_the_unit_id_has_had_three_names() -> None:
    """pymodbus renamed the keyword twice; a release that renames it again is found here and not at the machine."""
    assert unit_keyword(ModbusTcpClient("nowhere").read_holding_registers) == "device_id"

    def with_slave(address: int, count: int = 1, slave: int = 0) -> None: ...
    def with_unit(address: int, count: int = 1, unit: int = 0) -> None: ...
    def with_other(address: int, count: int = 1, station: int = 0) -> None: ...

    assert unit_keyword(with_slave) == "slave"
    assert unit_keyword(with_unit) == "unit"
    with pytest.raises(CapabilityError, match="no known name for the unit id among address, count, station"):
        unit_keyword(with_other)


def test_every_function_has_its_method() -> None:
    client = ModbusTcpClient("nowhere")
    for function in Function:
        wire = PymodbusWire(TcpEndpoint("127.0.0.1", 9, 0.05))
        values = (1,) if function.is_write else ()
        with pytest.raises(LinkLostError):  # nothing listens there; a missing method would be an AttributeError
            wire.exchange(1, Request(function, 0, 1, values))
    client.close()


def test_a_port_that_cannot_be_opened_says_why() -> None:
    with pytest.raises(LinkLostError, match=r"Modbus /dev/no-such-port cannot be opened: .*No such file"):
        PymodbusWire(RtuEndpoint("/dev/no-such-port")).connect()


def test_traffic_that_never_pauses_keeps_nobody_from_being_heard() -> None:
    """Whoever receives something in each first slice asks for the next receive, and never for a second slice."""
    check = Mock()
    for _ in range(3):
        assert 0.0 < next(slices(Listening(60.0), check)) <= IO_SLICE_S
    assert check.call_count == 3


def test_after_the_last_slice_there_is_a_last_look() -> None:
    assert list(slices(Listening(-1.0), lambda: None)) == [0.0]


def test_numbers_come_again_and_none_is_kept() -> None:
    """A screen polls 20 times a second for months; what went by is not held."""
    numbers = over_and_over(range(1, 0x8000))
    assert [next(numbers), next(numbers)] == [1, 2]
    tracemalloc.start()
    try:
        for _ in range(3, 0x8000):
            last = next(numbers)
        held_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held_bytes < 10_000
    assert (last, next(numbers), next(numbers)) == (0x7FFF, 1, 2)


@pytest.mark.outside
@pytest.mark.parametrize("held_up_s", [0.0, 0.03])
def test_a_process_that_is_held_up_gives_the_reply_as_much_longer(held_up_s: float) -> None:
    """A time-out of 50 ms, of 5 ms slices; the server answers after 150 ms, which only a process that ran meanwhile calls late."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with server.accept()[0] as connection:
                request = connection.recv(64)
                time.sleep(0.15)
                with suppress(OSError):
                    connection.sendall(request[:5] + bytes((5, 1, 3, 2, 0, 42)))
                connection.recv(64)  # until the client hangs up

        thread = threading.Thread(target=answer)
        thread.start()
        wire = PymodbusWire(TcpEndpoint("127.0.0.1", server.getsockname()[1], 1.0), lambda: time.sleep(held_up_s))
        try:
            expected = nullcontext() if held_up_s else pytest.raises(NoAnswerError, match=r"no answer within 0\.05 s")
            with expected:
                assert wire.exchange(1, Request.read(AddressSpace.HOLDING, Span(0, 1)), 0.05) == (42,)
        finally:
            wire.disconnect()
            thread.join()
