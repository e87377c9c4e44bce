"""Bytes on the wire, literally: examples of the Modbus specifications against our client and our simulated server.

Sources: Modbus application protocol V1.1b3 (section 6, the example of each function), Modbus over serial line V1.02 (6.2.2, CRC
example), Modbus messaging on TCP/IP V1.0b (3.1.3, header).
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import pytest

from drivers.errors import AbortError
from drivers.modbus.endpoint import TcpEndpoint
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.wire import PymodbusWire, Request
from sim_backends.modbus_framing import Frame, RtuDecoder, TcpDecoder, crc16, pack_rtu, pack_tcp
from sim_backends.modbus_registers import Bank, Cell, Space, answer

# (request PDU, reply PDU) as printed in section 6 of the application protocol
READ_COILS = ("01 00 13 00 13", "01 03 CD 6B 05")  # outputs 20 to 38
READ_DISCRETE = ("02 00 C4 00 16", "02 03 AC DB 35")  # inputs 197 to 218
READ_HOLDING = ("03 00 6B 00 03", "03 06 02 2B 00 00 00 64")  # registers 108 to 110
READ_INPUT = ("04 00 08 00 01", "04 02 00 0A")  # input register 9
WRITE_COIL = ("05 00 AC FF 00", "05 00 AC FF 00")  # output 173 on
WRITE_REGISTER = ("06 00 01 00 03", "06 00 01 00 03")  # register 2 := 3
WRITE_COILS = ("0F 00 13 00 0A 02 CD 01", "0F 00 13 00 0A")  # 10 outputs from 20
WRITE_REGISTERS = ("10 00 01 00 02 04 00 0A 01 02", "10 00 01 00 02")  # registers 2 and 3

COILS_20_TO_38 = (1, 0, 1, 1, 0, 0, 1, 1, 1, 1, 0, 1, 0, 1, 1, 0, 1, 0, 1)
INPUTS_197_TO_218 = (0, 0, 1, 1, 0, 1, 0, 1, 1, 1, 0, 1, 1, 0, 1, 1, 1, 0, 1, 0, 1, 1)


class Example:
    """The device of the specification's examples."""

    max_read = 125
    max_write = 123
    single_writes = True

    def __init__(self) -> None:
        self.coils = dict(enumerate(COILS_20_TO_38, start=0x13)) | {0xAC: 0}
        self.inputs = dict(enumerate(INPUTS_197_TO_218, start=0xC4))
        self.holding = {0x6B: 0x022B, 0x6C: 0, 0x6D: 0x0064, 1: 0, 2: 0}
        self.banks: Mapping[Space, Bank] = {
            Space.COILS: _bank("?", self.coils, writable=True),
            Space.DISCRETE_INPUTS: _bank("?", self.inputs),
            Space.HOLDING_REGISTERS: _bank("H", self.holding, writable=True),
            Space.INPUT_REGISTERS: _bank("H", {8: 0x000A}),
        }

    def tick(self, now_ns: int) -> None: ...

    def bearable(self, now_ns: int) -> int:
        return 1


def _bank(code: str, values: dict[int, int], *, writable: bool = False) -> Bank:
    def cell(address: int) -> Cell:
        def write(value: object) -> None:
            values[address] = int(value)  # type: ignore[call-overload]

        return Cell(address, code, lambda: values[address], write if writable else None)

    return Bank([cell(address) for address in values], gaps_readable=False)


@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT, WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS],
)
def test_the_simulated_server_answers_the_examples(request_hex: str, reply_hex: str) -> None:
    assert answer(Example(), bytes.fromhex(request_hex)).hex(" ").upper() == reply_hex


def test_the_simulated_server_does_what_the_examples_write() -> None:
    device = Example()
    answer(device, bytes.fromhex(WRITE_COIL[0]))
    answer(device, bytes.fromhex(WRITE_COILS[0]))
    answer(device, bytes.fromhex(WRITE_REGISTERS[0]))
    assert device.coils[0xAC] == 1
    assert [device.coils[0x13 + place] for place in range(10)] == [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]
    assert device.holding[1] == 0x000A
    assert device.holding[2] == 0x0102


@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [
        ("01 04 A1 00 01", "81 02"),  # the specification's example of an exception: no such output
        ("03 00 6B 00 00", "83 03"),  # quantity 0
        ("03 00 6B 00 7E", "83 03"),  # quantity 126
        ("03 00 6B", "83 03"),
        ("03 FF FF 00 02", "83 02"),  # runs over the end
        ("02 00 C4 07 D1", "82 03"),  # 2001 inputs
        ("05 00 AC 12 34", "85 03"),  # neither on nor off
        ("06 00 6A 00 01", "86 02"),
        ("10 00 01 00 02 03 00 0A 01", "90 03"),  # byte count does not fit
        ("10 00 01 00 7C 04 00 0A 01 02", "90 03"),
        ("0F 00 13 00 0A 01 CD", "8F 03"),
        ("2B 0E 01 00", "AB 01"),
        ("07", "87 01"),
    ],
)
def test_the_simulated_server_refuses_as_the_flow_charts_do(request_hex: str, reply_hex: str) -> None:
    device = Example()
    before = (dict(device.coils), dict(device.holding))
    assert answer(device, bytes.fromhex(request_hex)).hex(" ").upper() == reply_hex
    assert (device.coils, device.holding) == before


def test_crc_of_the_serial_line_guide() -> None:
    assert crc16(bytes.fromhex("02 07")) == 0x1241  # sent as 41 12
    assert pack_rtu(Frame(2, b"\x07")) == bytes.fromhex("02 07 41 12")
    assert pack_rtu(Frame(1, bytes.fromhex("03 00 00 00 0A"))) == bytes.fromhex("01 03 00 00 00 0A C5 CD")


def test_tcp_header_and_streams_cut_anywhere() -> None:
    frame = Frame(0xFF, bytes.fromhex("03 00 04 00 01"), 0x1501)
    data = bytes.fromhex("15 01 00 00 00 06 FF 03 00 04 00 01")
    assert pack_tcp(frame) == data
    for cut in range(len(data)):
        decoder = TcpDecoder()
        assert decoder.feed(data[:cut]) == []
        assert decoder.feed(data[cut:] + data[:3]) == [frame]
        assert decoder.feed(data[3:]) == [frame]
    broken = TcpDecoder()
    assert broken.feed(bytes.fromhex("15 01 00 07 00 06 FF 03 00 04 00 01")) == []
    assert broken.broken


@pytest.mark.parametrize("pdu", ["03 00 6B 00 03", "06 00 01 00 03", "0F 00 13 00 0A 02 CD 01", WRITE_REGISTERS[0]])
def test_serial_requests_cut_anywhere_and_damaged_ones(pdu: str) -> None:
    data = pack_rtu(Frame(9, bytes.fromhex(pdu)))
    for cut in range(len(data)):
        decoder = RtuDecoder()
        assert decoder.feed(data[:cut]) == []
        assert decoder.feed(data[cut:]) == [Frame(9, bytes.fromhex(pdu))]
        assert not decoder.waiting
    for place in range(len(data)):
        for bit in range(8):
            damaged = bytearray(data)
            damaged[place] ^= 1 << bit
            decoder = RtuDecoder()
            assert decoder.feed(bytes(damaged)) + decoder.silence() == []
            assert decoder.feed(data) == [Frame(9, bytes.fromhex(pdu))]


def test_a_request_of_unknown_length_ends_with_silence() -> None:
    decoder = RtuDecoder()
    data = pack_rtu(Frame(9, bytes.fromhex("2B 0E 01 00")))
    assert decoder.feed(data) == []
    assert decoder.waiting
    assert decoder.silence() == [Frame(9, bytes.fromhex("2B 0E 01 00"))]


@contextmanager
def replaying(reply_pdu: str) -> Iterator[tuple[PymodbusWire, list[bytes]]]:
    """A server that notes what it gets and answers with given bytes."""
    seen: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                data = connection.recv(300)
                seen.append(data)
                pdu = bytes.fromhex(reply_pdu)
                connection.sendall(data[:4] + (len(pdu) + 1).to_bytes(2, "big") + data[6:7] + pdu)
                connection.recv(1)

        thread = threading.Thread(target=serve)
        thread.start()
        wire = PymodbusWire(TcpEndpoint("127.0.0.1", listener.getsockname()[1]))
        wire.connect()
        try:
            yield wire, seen
        finally:
            wire.disconnect()
            thread.join()


@pytest.mark.parametrize(
    ("request_", "vector", "values"),
    [
        (Request.read(AddressSpace.COIL, Span(0x13, 19)), READ_COILS, COILS_20_TO_38),
        (Request.read(AddressSpace.DISCRETE, Span(0xC4, 22)), READ_DISCRETE, INPUTS_197_TO_218),
        (Request.read(AddressSpace.HOLDING, Span(0x6B, 3)), READ_HOLDING, (0x022B, 0, 0x64)),
        (Request.read(AddressSpace.INPUT, Span(8, 1)), READ_INPUT, (10,)),
        (Request.write(AddressSpace.COIL, 0xAC, (1,)), WRITE_COIL, ()),
        (Request.write(AddressSpace.HOLDING, 1, (3,)), WRITE_REGISTER, ()),
        (Request.write(AddressSpace.COIL, 0x13, (1, 0, 1, 1, 0, 0, 1, 1, 1, 0)), WRITE_COILS, ()),
        (Request.write(AddressSpace.HOLDING, 1, (0x0A, 0x0102)), WRITE_REGISTERS, ()),
    ],
)
def test_our_client_sends_the_examples_and_reads_their_replies(
    request_: Request, vector: tuple[str, str], values: tuple[int, ...]
) -> None:
    with replaying(vector[1]) as (wire, seen):
        assert wire.exchange(0x11, request_) == values
        (sent,) = seen
    assert sent[2:4] == b"\0\0"
    assert int.from_bytes(sent[4:6], "big") == len(sent) - 6
    assert sent[6] == 0x11
    assert sent[7:].hex(" ").upper() == vector[0]


def test_our_client_reads_the_example_of_an_exception() -> None:
    with replaying("81 02") as (wire, _), pytest.raises(AbortError, match="illegal data address") as caught:
        wire.exchange(1, Request.read(AddressSpace.COIL, Span(0x04A1, 1)))
    assert caught.value.code == 2
