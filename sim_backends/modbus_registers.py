"""The registers of a simulated Modbus device: cells with address, format and access functions, and the Modbus functions over them.

Modbus functions 1 to 6, 15 and 16 of the application protocol V1.1b3 (section 6, with its exception codes).
Independent of drives. Values are packed here by separate code, not by the client's.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE, BUSY = 1, 2, 3, 4, 6
GATEWAY_NO_RESPONSE = 11

Value = int | float | bytes


class RefusedRequestError(Exception):
    """A request that is answered with an exception; `code` is the exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class Space(Enum):
    """The four address spaces, by their function for reading."""

    COILS = 1
    DISCRETE_INPUTS = 2
    HOLDING_REGISTERS = 3
    INPUT_REGISTERS = 4


@dataclass(frozen=True)
class Cell:
    """One value at an address (0-based).

    code: a letter of `struct` (H h I i Q q f d), "?" for a coil or input, or "8s" for text.
    low_word_first, low_byte_first: order of the words and bytes. low, high: allowed values; write None: read only.
    """

    address: int
    code: str
    read: Callable[[], Value]
    write: Callable[[Value], None] | None = None
    low: float | None = None
    high: float | None = None
    low_word_first: bool = False
    low_byte_first: bool = False
    write_only: bool = False

    @property
    def words(self) -> int:
        return 1 if self.code == "?" else struct.calcsize(f">{self.code}") // 2

    @property
    def end(self) -> int:
        return self.address + self.words

    def now(self) -> list[int]:
        value = self.read()
        if self.code == "?":
            return [int(bool(value))]
        if isinstance(value, int) and self.code in "HhIiQq":  # a counter that is full wraps, as in any firmware
            data = (value & (1 << 16 * self.words) - 1).to_bytes(2 * self.words, "big")
        else:
            data = struct.pack(f">{self.code}", value)
        words = list(struct.unpack(f">{self.words}H", data))
        return self._arranged(words)

    def value_of(self, words: Sequence[int]) -> Value:
        """Words as received -> the value. Raises RefusedRequestError outside the limits."""
        if self.code == "?":
            return words[0]
        data = struct.pack(f">{self.words}H", *self._arranged(list(words)))
        value: Value = struct.unpack(f">{self.code}", data)[0]
        if not isinstance(value, bytes) and (
            (self.low is not None and not value >= self.low) or (self.high is not None and not value <= self.high)
        ):
            raise RefusedRequestError(ILLEGAL_VALUE)
        return value

    def _arranged(self, words: list[int]) -> list[int]:
        """Conversion between the order of the wire and high word, high byte first; its own inverse."""
        if self.low_byte_first:
            words = [(word & 0xFF) << 8 | word >> 8 for word in words]
        return words[::-1] if self.low_word_first and not self.code.endswith("s") else words


class Bank:
    """One address space. gaps_readable: an address without a cell reads as 0 (else the request is refused). Raises ValueError."""

    def __init__(self, cells: Iterable[Cell], *, gaps_readable: bool) -> None:
        self._by_address: dict[int, Cell] = {}
        self._gaps_readable = gaps_readable
        for cell in cells:
            for address in range(cell.address, cell.end):
                if address in self._by_address:
                    raise ValueError(f"two cells at address {address}")
                self._by_address[address] = cell

    @property
    def addresses(self) -> frozenset[int]:
        """Every address that has a cell."""
        return frozenset(self._by_address)

    def read(self, address: int, count: int) -> list[int]:
        """Words (or bits); every cell is read once, so that its words are of one moment. Raises RefusedRequestError."""
        found: dict[int, list[int]] = {}
        words: list[int] = []
        for place in range(address, address + count):
            cell = self._by_address.get(place)
            if cell is None and self._gaps_readable and len(self._by_address) > 0:
                words.append(0)
            elif cell is None or cell.write_only:
                raise RefusedRequestError(ILLEGAL_ADDRESS)
            else:
                if cell.address not in found:
                    found[cell.address] = cell.now()
                words.append(found[cell.address][place - cell.address])
        return words

    def write(self, address: int, words: Sequence[int]) -> None:
        """Write all or nothing, as far as addresses and limits go; half a value is refused. Raises RefusedRequestError."""
        orders: list[tuple[Callable[[Value], None], Value]] = []
        place, end = address, address + len(words)
        while place < end:
            cell = self._by_address.get(place)
            if cell is None or cell.write is None or cell.address != place or cell.end > end:
                raise RefusedRequestError(ILLEGAL_ADDRESS)
            orders.append((cell.write, cell.value_of(words[place - address : cell.end - address])))
            place = cell.end
        for act, value in orders:
            act(value)


class Face(Protocol):
    """The registers of one kind of device."""

    banks: Mapping[Space, Bank]
    max_read: int
    max_write: int
    single_writes: bool

    def tick(self, now_ns: int) -> None:
        """Time has advanced to now_ns."""

    def bearable(self, now_ns: int) -> int:
        """Longest time until the next tick, ns."""


def answer(face: Face, pdu: bytes) -> bytes:
    """A request's PDU -> the reply's PDU, an exception reply where it is refused."""
    if not pdu:
        return bytes((0x80, ILLEGAL_FUNCTION))
    try:
        return bytes(pdu[:1]) + _obey(face, pdu[0], pdu[1:])
    except RefusedRequestError as refusal:
        return bytes((pdu[0] | 0x80, refusal.code))


def _obey(face: Face, function: int, body: bytes) -> bytes:
    if function in (1, 2, 3, 4):
        return _read(face, Space(function), body)
    if function in (5, 6) and face.single_writes:
        return _write_one(face, Space.COILS if function == 5 else Space.HOLDING_REGISTERS, body)
    if function in (15, 16):
        return _write_many(face, Space.COILS if function == 15 else Space.HOLDING_REGISTERS, body)
    raise RefusedRequestError(ILLEGAL_FUNCTION)


def _read(face: Face, space: Space, body: bytes) -> bytes:
    if len(body) != 4:
        raise RefusedRequestError(ILLEGAL_VALUE)
    address, count = struct.unpack(">HH", body)
    bits = space in (Space.COILS, Space.DISCRETE_INPUTS)
    if not 1 <= count <= (2000 if bits else face.max_read):
        raise RefusedRequestError(ILLEGAL_VALUE)
    values = _bank(face, space, address, count).read(address, count)
    data = _pack_bits(values) if bits else struct.pack(f">{count}H", *values)
    return bytes((len(data),)) + data


def _write_one(face: Face, space: Space, body: bytes) -> bytes:
    if len(body) != 4:
        raise RefusedRequestError(ILLEGAL_VALUE)
    address, value = struct.unpack(">HH", body)
    if space is Space.COILS:
        if value not in (0x0000, 0xFF00):
            raise RefusedRequestError(ILLEGAL_VALUE)
        value = int(value == 0xFF00)
    _bank(face, space, address, 1).write(address, [value])
    return body


def _write_many(face: Face, space: Space, body: bytes) -> bytes:
    if len(body) < 6:
        raise RefusedRequestError(ILLEGAL_VALUE)
    address, count, size = struct.unpack(">HHB", body[:5])
    data = body[5:]
    bits = space is Space.COILS
    if not 1 <= count <= (1968 if bits else face.max_write):
        raise RefusedRequestError(ILLEGAL_VALUE)
    if size != len(data) or size != ((count + 7) // 8 if bits else 2 * count):
        raise RefusedRequestError(ILLEGAL_VALUE)
    values = (
        [data[place // 8] >> place % 8 & 1 for place in range(count)] if bits else struct.unpack(f">{count}H", data)
    )
    _bank(face, space, address, count).write(address, list(values))
    return body[:4]


def _bank(face: Face, space: Space, address: int, count: int) -> Bank:
    if address + count > 0x10000 or space not in face.banks:
        raise RefusedRequestError(ILLEGAL_ADDRESS)
    return face.banks[space]


def _pack_bits(values: Sequence[int]) -> bytes:
    data = bytearray((len(values) + 7) // 8)
    for place, value in enumerate(values):
        data[place // 8] |= (value & 1) << place % 8
    return bytes(data)
