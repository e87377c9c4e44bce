"""What pymodbus leaves to its users, reproduced with pymodbus alone, and the same line under our link surviving it.

Each test first shows the trap with the library's own client, so that it also tells when a release has closed it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusIOException

from drivers.errors import AbortError, BridgeError, NoAnswerError, ProtocolError
from drivers.modbus.endpoint import RtuEndpoint, TcpEndpoint
from drivers.modbus.link import Doubt, LinkPolicy, ModbusLink
from drivers.modbus.map_loader import load_register_map
from drivers.modbus.plan import Span, Table
from sim_backends.clock import SimClock
from sim_backends.modbus_drive import ModbusServer, rtu_slave, tcp_server
from sim_backends.modbus_faults import WireFault, WireFaultKind
from sim_backends.modbus_registers import Bank, Cell, Space, Value

pytestmark = pytest.mark.outside

TIMEOUT_S = 0.4  # where it is waited out
AMPLE_S = 10.0  # where it is not
HOLDING = Table.HOLDING
TRIGGER = 30
COUNTER = 38


class Registers:
    """Register n holds 1000 + n, but 20 and 21 hold 0x12345678, low word first, and 38 how often it was read.

    `triggered` counts how often 30 was written.
    """

    max_read = 125
    max_write = 123
    single_writes = True

    def __init__(self) -> None:
        self.values = {address: 1000 + address for address in range(40)}
        self.triggered = 0
        self.reads = 0
        cells = [Cell(address, "H", self._reader(address), self._writer(address)) for address in self.values]
        self.values[20], self.values[21] = 0x5678, 0x1234
        self.banks: Mapping[Space, Bank] = {Space.HOLDING_REGISTERS: Bank(cells, gaps_readable=False)}

    def _reader(self, address: int) -> Callable[[], Value]:
        def read() -> Value:
            self.reads += address == COUNTER
            return self.reads if address == COUNTER else self.values[address]

        return read

    def _writer(self, address: int) -> Callable[[Value], None]:
        def write(value: Value) -> None:
            self.values[address] = int(value)
            self.triggered += address == TRIGGER

        return write

    def tick(self, now_ns: int) -> None: ...

    def bearable(self, now_ns: int) -> int:
        return 1_000_000_000


@contextmanager
def tcp(timeout_s: float = AMPLE_S) -> Iterator[tuple[ModbusServer, Registers, TcpEndpoint, SimClock]]:
    clock, face = SimClock(), Registers()
    with tcp_server({1: face, 2: Registers()}, clock) as (server, port):
        yield server, face, TcpEndpoint("127.0.0.1", port, timeout_s), clock


@contextmanager
def rtu() -> Iterator[tuple[ModbusServer, Registers, RtuEndpoint, SimClock]]:
    clock, face = SimClock(), Registers()
    with rtu_slave({1: face}, clock) as (server, path):
        yield server, face, RtuEndpoint(path, 115_200, "N", 1, TIMEOUT_S), clock


@contextmanager
def library(endpoint: TcpEndpoint | RtuEndpoint, retries: int = 0) -> Iterator[ModbusTcpClient | ModbusSerialClient]:
    client: ModbusTcpClient | ModbusSerialClient
    if isinstance(endpoint, TcpEndpoint):
        client = ModbusTcpClient(endpoint.host, port=endpoint.port, timeout=endpoint.timeout_s, retries=retries)
    else:
        client = ModbusSerialClient(
            endpoint.device, baudrate=endpoint.baud, parity="N", timeout=endpoint.timeout_s, retries=retries
        )
    assert client.connect()
    try:
        yield client
    finally:
        client.close()  # type: ignore[no-untyped-call]


@contextmanager
def ours(
    endpoint: TcpEndpoint | RtuEndpoint, clock: SimClock, policy: LinkPolicy | None = None
) -> Iterator[ModbusLink]:
    link = ModbusLink(endpoint, clock, policy=policy)
    link.open()
    try:
        yield link
    finally:
        link.close()


def test_errors_come_in_two_ways_and_leave_as_one() -> None:
    with tcp(TIMEOUT_S) as (server, _, endpoint, clock):
        with library(endpoint) as client:
            assert client.read_holding_registers(500, device_id=1).isError()  # a refusal is returned, and easily missed
            server.faults.add(WireFault(WireFaultKind.NO_REPLY))
            with pytest.raises(ModbusIOException):  # silence is raised
                client.read_holding_registers(0, device_id=1)
        server.faults.clear()
        with ours(endpoint, clock) as link:
            with pytest.raises(AbortError) as refused:
                link.read(1, HOLDING, Span(500, 1))
            assert refused.value.code == 2
            server.faults.add(WireFault(WireFaultKind.NO_REPLY, count=9))
            with pytest.raises(NoAnswerError) as silent:
                link.read(1, HOLDING, Span(0, 1))
            assert isinstance(silent.value, BridgeError)
            assert "no answer within 0.4 s" in str(silent.value)


def test_a_request_is_repeated_behind_the_callers_back_even_a_start_bit() -> None:
    with tcp(TIMEOUT_S) as (server, face, endpoint, clock):
        server.faults.add(WireFault(WireFaultKind.NO_REPLY, count=2))
        with library(endpoint, retries=1) as client, pytest.raises(ModbusIOException):
            client.write_register(TRIGGER, 1, device_id=1)
        assert face.triggered == 2  # two moves for one order; four with its default of three retries
        server.faults.clear()
        face.triggered = 0
        server.faults.add(WireFault(WireFaultKind.NO_REPLY, count=4))
        with ours(endpoint, clock) as link, pytest.raises(NoAnswerError, match="unknown"):
            link.write(1, HOLDING, TRIGGER, (1,), doubt=Doubt.RAISE)
        assert face.triggered == 1


def test_a_late_reply_is_taken_for_that_of_the_next_request_on_a_serial_line() -> None:
    with rtu() as (server, _, endpoint, clock):
        server.faults.add(WireFault(WireFaultKind.DISPLACED))
        with library(endpoint) as client:
            with pytest.raises(ModbusIOException):
                client.read_holding_registers(3, count=2, device_id=1)
            assert client.read_holding_registers(7, count=2, device_id=1).registers == [1003, 1004]  # of another place
        server.faults.clear()
        server.faults.add(WireFault(WireFaultKind.DISPLACED))
        with ours(endpoint, clock, LinkPolicy(read_retries=0)) as link:
            with pytest.raises(NoAnswerError):
                link.read(1, HOLDING, Span(3, 2))
            assert link.read(1, HOLDING, Span(7, 2), urgent=True) == (1007, 1008)
            assert link.statistics.discarded_replies == 1


def test_a_late_reply_cannot_make_a_repeated_read_stale() -> None:
    with rtu() as (server, face, endpoint, clock), ours(endpoint, clock) as link:
        server.faults.add(WireFault(WireFaultKind.DISPLACED))
        assert link.read(1, HOLDING, Span(COUNTER, 1)) != (1,)  # what the first request read, and whose reply came late
        assert face.reads > 1


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        (WireFaultKind.WRONG_FUNCTION, "reply to function 4"),
        (WireFaultKind.SHORT_DATA, "reply holds 1 values, expected 2"),
    ],
)
def test_a_reply_that_is_none_is_handed_over_as_if_it_were(kind: WireFaultKind, what: str) -> None:
    with tcp() as (server, _, endpoint, clock):
        server.faults.add(WireFault(kind))
        with library(endpoint) as client:
            reply = client.read_holding_registers(3, count=2, device_id=1)
            assert not reply.isError()
            assert len(reply.registers) == 1
        server.faults.add(WireFault(kind, count=3))
        with ours(endpoint, clock) as link:
            with pytest.raises(ProtocolError, match=what):
                link.read(1, HOLDING, Span(3, 2))
            assert link.read(1, HOLDING, Span(3, 2)) == (1003, 1004)


def test_the_echo_of_a_write_is_not_compared() -> None:
    with tcp() as (server, face, endpoint, clock):
        server.faults.add(WireFault(WireFaultKind.WRONG_ECHO))
        with library(endpoint) as client:
            assert not client.write_register(5, 55, device_id=1).isError()
        server.faults.add(WireFault(WireFaultKind.WRONG_ECHO))
        with ours(endpoint, clock) as link:
            link.write(1, HOLDING, 5, (56,))  # doubted, read back, found done
            assert link.statistics.resolved_writes == 1
        assert face.values[5] == 56


def test_the_rest_of_a_torn_reply_spoils_the_next_one() -> None:
    with tcp(TIMEOUT_S) as (server, _, endpoint, clock):
        server.faults.add(WireFault(WireFaultKind.TORN))
        with library(endpoint) as client:
            with pytest.raises(ModbusIOException):
                client.read_holding_registers(3, count=2, device_id=1)
            with pytest.raises(ModbusIOException):  # answered in full, and lost
                client.read_holding_registers(3, count=2, device_id=1)
        server.faults.clear()
        server.faults.add(WireFault(WireFaultKind.TORN))
        with ours(endpoint, clock) as link:
            assert link.read(1, HOLDING, Span(3, 2)) == (1003, 1004)
            assert link.statistics.connects == 2


def test_one_dead_unit_stalls_the_others() -> None:
    rounds = 2
    with tcp(TIMEOUT_S) as (server, _, endpoint, clock):
        server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, unit=1, count=10**6))
        with library(endpoint, retries=1) as client:
            for _ in range(rounds):
                with pytest.raises(ModbusIOException):
                    client.read_holding_registers(0, device_id=1)
                assert not client.read_holding_registers(0, device_id=2).isError()
        to_the_dead = sum(unit == 1 for unit, _ in server.seen)
        assert to_the_dead == 2 * rounds  # each of them waited for
        server.seen.clear()
        with ours(endpoint, clock) as link:
            for _ in range(rounds):
                with pytest.raises(NoAnswerError):
                    link.read(1, HOLDING, Span(0, 1))
                assert link.read(2, HOLDING, Span(0, 1)) == (1000,)
        assert sum(unit == 1 for unit, _ in server.seen) == 3  # once and two repeats, then back-off


def test_word_order_and_address_base_are_left_to_the_caller(tmp_path: Path) -> None:
    """The drive's manual: "40021, 32 bit, low word first", holding 0x12345678."""
    with tcp() as (_, _, endpoint, clock):
        with library(endpoint) as client:
            off_by_one = client.read_holding_registers(21, count=2, device_id=1).registers
            assert off_by_one == [0x1234, 1022]
            right_place = client.read_holding_registers(20, count=2, device_id=1).registers
            guessed = client.convert_from_registers(right_place, client.DATATYPE.INT32)
            assert guessed == 0x56781234
        path = tmp_path / "model.toml"
        path.write_text(
            '[map]\nname = "m"\naddress_base = "modicon5"\nword_order = "little"\n'
            '[registers.position]\naddress = 40021\ntype = "i32"\n',
            encoding="utf-8",
        )
        register = load_register_map(path)["position"]
        with ours(endpoint, clock) as link:
            assert register.decode(link.read(1, register.table, register.span)) == 0x12345678
