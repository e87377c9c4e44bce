"""One Modbus request and its reply, through pymodbus; every failure becomes one typed error.

Repeats, waits and state are in `drivers.modbus.link`. This module covers what pymodbus leaves open: it reports failures as exceptions
*or* as replies for which isError() holds; it does not compare function code, count or echo of a reply with the request; it names the
unit differently from release to release. Its clients are not used, only its requests, replies and framers: their waits cannot be
interrupted, a stop from a second thread waits behind their lock (901 ms measured), and they repeat requests by themselves (a repeated
start bit is a second move). From 3.16 on they keep their time-outs under foreign traffic; before, they did not. A reply cut short on
TCP leaves its rest in the stream; the connection is then closed.
"""

from __future__ import annotations

import contextlib
import inspect
import itertools
import logging
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

from pymodbus.client.mixin import ModbusClientMixin
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from drivers.errors import (
    AbortError,
    CapabilityError,
    InputError,
    LinkLostError,
    NoAnswerError,
    OtherAnswerError,
    ProtocolError,
)
from drivers.listening import Listening
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.plan import MAX_READ_BITS, MAX_READ_REGISTERS, AddressSpace, Span
from drivers.modbus.ports import Check, Port, SerialPort, TcpPort
from drivers.system_errors import told_with_remedy


class Function(IntEnum):
    """Function codes (Modbus application protocol V1.1b3, section 6)."""

    READ_COILS = 1
    READ_DISCRETE = 2
    READ_HOLDING = 3
    READ_INPUT = 4
    WRITE_COIL = 5
    WRITE_REGISTER = 6
    WRITE_COILS = 15
    WRITE_REGISTERS = 16

    @property
    def is_write(self) -> bool:
        return self in (Function.WRITE_COIL, Function.WRITE_REGISTER, Function.WRITE_COILS, Function.WRITE_REGISTERS)

    @property
    def is_bits(self) -> bool:
        """Whether it accesses bits, not registers."""
        return self in (Function.READ_COILS, Function.READ_DISCRETE, Function.WRITE_COIL, Function.WRITE_COILS)


_READ = {
    AddressSpace.COIL: Function.READ_COILS,
    AddressSpace.DISCRETE: Function.READ_DISCRETE,
    AddressSpace.HOLDING: Function.READ_HOLDING,
    AddressSpace.INPUT: Function.READ_INPUT,
}
_METHODS = {
    Function.READ_COILS: "read_coils",
    Function.READ_DISCRETE: "read_discrete_inputs",
    Function.READ_HOLDING: "read_holding_registers",
    Function.READ_INPUT: "read_input_registers",
    Function.WRITE_COIL: "write_coil",
    Function.WRITE_REGISTER: "write_register",
    Function.WRITE_COILS: "write_coils",
    Function.WRITE_REGISTERS: "write_registers",
}
EXCEPTION_NAMES = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge, still working",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not respond",
}
ACKNOWLEDGE = 5
BUSY = 6
NO_PATH, NO_TARGET = 10, 11
"""Exceptions that a gateway answers in place of the unit: it did not pass the request on, or passed it on and got no answer."""


@dataclass(frozen=True)
class Request:
    """A request; `address` is the 0-based PDU address, `values` what is written (bits as 0 or 1)."""

    function: Function
    address: int
    count: int
    values: tuple[int, ...] = ()

    @classmethod
    def read(cls, table: AddressSpace, span: Span) -> Request:
        """A read request. Raises InputError for more values than one request may have (V1.1b3, 6.1 to 6.4)."""
        limit = MAX_READ_BITS if table.is_bits else MAX_READ_REGISTERS
        if span.count > limit:
            raise InputError(f"{span.count} values in one request, expected at most {limit}")
        return cls(_READ[table], span.start, span.count)

    @classmethod
    def write(cls, table: AddressSpace, start: int, values: tuple[int, ...], *, single: bool = True) -> Request:
        """A write request. single: one value goes with function 5 or 6 rather than 15 or 16. Raises InputError."""
        if not table.is_writable:
            raise InputError(f"table {table.value} cannot be written")
        if single and len(values) == 1:
            function = Function.WRITE_COIL if table.is_bits else Function.WRITE_REGISTER
        else:
            function = Function.WRITE_COILS if table.is_bits else Function.WRITE_REGISTERS
        return cls(function, start, len(values), values)

    @property
    def echo(self) -> tuple[object, ...]:
        """All of its reply that is known beforehand: two requests of one echo cannot be told apart by their replies."""
        if self.function in (Function.WRITE_COIL, Function.WRITE_REGISTER):
            return self.function, self.address, self.values
        if self.function.is_write:
            return self.function, self.address, self.count
        return self.function, (self.count + 7) // 8 if self.function.is_bits else self.count

    def __str__(self) -> str:
        verb = "write" if self.function.is_write else "read"
        what = "bit" if self.function.is_bits else "register"
        places = (
            f"{what} {self.address}"
            if self.count == 1
            else f"{what}s {self.address} to {self.address + self.count - 1}"
        )
        return f"{verb} of {places} (function {int(self.function)})"


class Wire(Protocol):
    """One connection that carries one request at a time."""

    @property
    def connected(self) -> bool: ...
    def connect(self, within_s: float = math.inf) -> None:
        """Connect. within_s: used instead of the time-out if it is less, s. Raises LinkLostError."""

    def disconnect(self) -> None: ...
    def discard(self, silence_s: float) -> None:
        """Discard what still comes in, until nothing has come for silence_s of real time. Does nothing on TCP."""

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        """The values read, () for a write. within_s: used instead of the time-out for the reply if it is less, s.

        Raises NoAnswerError, LinkLostError (the connection is then lost), AbortError (the device refused) and ProtocolError (a
        reply that does not belong to this request). After any other exception (the operator's stop) its reply may still come.
        """

    def post(self, unit: int, requests: Sequence[Request]) -> None:
        """Send without waiting for replies, during an exchange too; from any thread and from a signal handler."""


_MOST_BYTES = 8192
"""Bytes within which a reply has to come: 30 of the longest frames with other numbers before it. More is noise and not read."""

# errors of pymodbus for bytes that are no frame, besides the intended ones
_NO_FRAME: tuple[type[Exception], ...] = (ModbusException, IndexError, ValueError, KeyError, TypeError, struct.error)


class _Requests(ModbusClientMixin[ModbusPDU]):
    """pymodbus's requests, built and not sent."""

    def execute(self, no_response_expected: bool, request: ModbusPDU) -> ModbusPDU:
        """Return the request instead of sending it."""
        del no_response_expected
        return request


class PymodbusWire:
    """`Wire` with pymodbus's framers over a port of this package. check: `Clock.check_interrupt`, called at least every `IO_SLICE_S`;
    port: used instead of the endpoint's.

    An exchange takes at most the endpoint's time-out and `_MOST_BYTES`, whatever comes in meanwhile; on a serial line a reply that
    has begun by then may take the time of the longest frame more.
    """

    def __init__(self, endpoint: Endpoint, check: Check = lambda: None, port: Port | None = None) -> None:
        self.endpoint = endpoint
        logger = logging.getLogger("pymodbus")
        if not logger.handlers:  # its messages come back as errors; without a handler they would also go to stderr
            logger.addHandler(logging.NullHandler())
        self._port: Port
        self._framer: FramerBase
        if isinstance(endpoint, TcpEndpoint):
            self._port = port or TcpPort(endpoint.host, endpoint.port, endpoint.timeout_s, check)
            self._framer = FramerSocket(DecodePDU(False))
            self._numbers, self._post_numbers = over_and_over(range(1, 0x8000)), over_and_over(range(0x8000, 0x10000))
        else:
            self._port = port or SerialPort(
                endpoint.device,
                endpoint.baud,
                parity=endpoint.parity,
                stop_bits=endpoint.stop_bits,
                timeout_s=endpoint.timeout_s,
                check=check,
            )
            self._framer = FramerRTU(DecodePDU(False))
            self._numbers = self._post_numbers = itertools.repeat(0)  # RTU has no numbers
        self._requests = _Requests()  # type: ignore[no-untyped-call]
        self._unit_keyword = unit_keyword(self._requests.read_holding_registers)
        self._rest = b""  # bytes received and not decoded yet: on TCP the beginning of a frame
        self._other: int | None = None  # another unit that a frame came from during this exchange

    @property
    def connected(self) -> bool:
        return self._port.is_open

    def connect(self, within_s: float = math.inf) -> None:
        if self._port.is_open:
            return
        self._rest = b""
        try:
            self._port.open(within_s)
        except OSError as error:
            raise LinkLostError(
                f"Modbus {self.endpoint} cannot be opened: {told_with_remedy(error, str(self.endpoint))}"
            ) from error

    def disconnect(self) -> None:
        self._port.close()

    def discard(self, silence_s: float) -> None:
        with contextlib.suppress(OSError):  # the next request reports a lost port
            self._port.discard(silence_s)

    def post(self, unit: int, requests: Sequence[Request]) -> None:
        self._port.post([self._frame(unit, request, next(self._post_numbers)) for request in requests])

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        """As `Wire.exchange`; raises NoAnswerError, LinkLostError, AbortError, ProtocolError."""
        what = f"Modbus {self.endpoint} unit {unit}, {request}"
        self.connect(within_s)
        try:
            with self._port.exchange():
                reply = self._reply(unit, request, what, min(self.endpoint.timeout_s, within_s))
        except OSError as error:
            self.disconnect()
            raise LinkLostError(f"{what}: {error}") from error
        if reply.isError():
            raise _refusal(what, request, reply)
        return _checked(what, request, reply)

    def _reply(self, unit: int, request: Request, what: str, timeout_s: float) -> Any:
        """The first frame from this unit (on TCP: with this number) that comes in time. Raises NoAnswerError, ProtocolError."""
        number, port = next(self._numbers), self._port
        self._other = None
        if isinstance(self.endpoint, RtuEndpoint):
            self._rest = b""
        frame = self._frame(unit, request, number)
        port.send(frame)
        within, received, head = Listening(timeout_s), 0, b""
        while received <= _MOST_BYTES:
            data = port.receive(within)
            if not data:
                break
            if not received:
                within.extend(port.rest_of_frame_s)
            received += len(data)
            self._rest += data
            head = (head + data)[: len(frame)]
            if head == frame and not request.function.is_write and isinstance(self.endpoint, RtuEndpoint):
                # the reply to a single write is the request itself: on such a line it would be believed without a drive
                raise ProtocolError(f"{what}: the line echoes what is sent, expected an adapter without local echo")
            if (reply := self._found(unit, number, what)) is not None:
                return reply
        if self._other is not None:
            raise _answered_as(self._other, unit, what)
        if not received:
            raise NoAnswerError(f"{what}: no answer within {timeout_s:.3g} s")
        self._drop_broken_stream()
        raise NoAnswerError(f"{what}: {received} bytes of a damaged or foreign reply, no answer to this request")

    def _found(self, unit: int, number: int, what: str) -> Any:
        """The reply among the bytes received so far; other frames before it are left out. Raises OtherAnswerError for one with the
        request's number and another unit; RTU has no numbers: there it may be a late reply to another request."""
        while True:
            try:
                used, from_unit, its_number, pdu = self._framer.decode(self._rest)
                frame, self._rest = self._rest[:used], self._rest[used:]
                if not pdu:
                    return None
                if (from_unit, its_number) == (unit, number):
                    return self._framer.handleFrame(frame, unit, number)[1]
            except _NO_FRAME as error:
                self._drop_broken_stream()
                raise ProtocolError(f"{what}: reply cannot be understood") from error
            if its_number == number:
                if isinstance(self.endpoint, TcpEndpoint):
                    raise _answered_as(from_unit, unit, what)
                self._other = from_unit

    def _drop_broken_stream(self) -> None:
        """Close a TCP connection after a broken reply, whose rest would be taken for the head of the next; on RTU silence ends a
        frame."""
        if isinstance(self.endpoint, TcpEndpoint):
            self.disconnect()

    def _frame(self, unit: int, request: Request, number: int) -> bytes:
        method = getattr(self._requests, _METHODS[request.function])
        to = {self._unit_keyword: unit}
        pdu: ModbusPDU
        if request.function.is_write:
            values = [bool(value) for value in request.values] if request.function.is_bits else list(request.values)
            one = request.function in (Function.WRITE_COIL, Function.WRITE_REGISTER)
            pdu = method(request.address, values[0] if one else values, **to)
        else:
            pdu = method(request.address, count=request.count, **to)
        pdu.transaction_id = number
        return self._framer.buildFrame(pdu)


def over_and_over(numbers: range) -> Iterator[int]:
    """The numbers without end, for several threads. `itertools.cycle` keeps all that it has given: a megabyte for each connection."""

    def number(turn: int) -> int:
        return numbers[turn % len(numbers)]

    return map(number, itertools.count())


def unit_keyword(method: Callable[..., object]) -> str:
    """The keyword of the unit id in this release of pymodbus: device_id, earlier slave, earlier unit. Raises CapabilityError."""
    parameters = inspect.signature(method).parameters
    for name in ("device_id", "slave", "unit"):
        if name in parameters:
            return name
    raise CapabilityError(f"this pymodbus has no known name for the unit id among {', '.join(parameters)}")


def _answered_as(other: int, unit: int, what: str) -> OtherAnswerError:
    return OtherAnswerError(f"{what}: answered as unit {other}, asked was unit {unit}: try unit = {other}", other)


def _refusal(what: str, request: Request, reply: Any) -> AbortError | ProtocolError:
    if reply.function_code & 0x7F != request.function:
        return ProtocolError(f"{what}: exception reply to function {reply.function_code & 0x7F}")
    code = int(reply.exception_code)
    return AbortError(f"{what}: {EXCEPTION_NAMES.get(code, 'unknown exception')} (exception {code})", code)


def _checked(what: str, request: Request, reply: Any) -> tuple[int, ...]:
    """The reply's values, once everything in it that repeats the request has been compared. Raises ProtocolError."""
    if reply.function_code != request.function:
        raise ProtocolError(f"{what}: reply to function {reply.function_code}")
    if request.function.is_write:
        if reply.address != request.address:
            raise ProtocolError(f"{what}: reply names address {reply.address}, expected {request.address}")
        if request.function is Function.WRITE_REGISTER and tuple(reply.registers) != request.values:
            raise ProtocolError(f"{what}: reply echoes {reply.registers[0]}, expected {request.values[0]}")
        if request.function is Function.WRITE_COIL and tuple(map(int, reply.bits)) != request.values:
            raise ProtocolError(f"{what}: reply echoes {int(reply.bits[0])}, expected {request.values[0]}")
        if request.function in (Function.WRITE_COILS, Function.WRITE_REGISTERS) and reply.count != request.count:
            raise ProtocolError(f"{what}: reply counts {reply.count}, expected {request.count}")
        return ()
    values = reply.bits if request.function.is_bits else reply.registers
    expected = (request.count + 7) // 8 * 8 if request.function.is_bits else request.count
    if len(values) != expected:
        fewer = ": does it give fewer at once? (max_read_registers in its register map)" if values else ""
        raise ProtocolError(f"{what}: reply holds {len(values)} values, expected {expected}{fewer}")
    return tuple(int(value) for value in values[: request.count])
