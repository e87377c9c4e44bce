"""Conversion between registers and values: types, word order and byte order; and finding the order from a known value.

Pure functions. A Modbus register is 16 bits, high byte first on the wire; wider values are laid out by each vendor. Two choices
describe all layouts met in practice: which 16-bit word of a wide value comes first, and whether the bytes inside each word are
swapped. `big`/`big` is ABCD, `little`/`big` CDAB, `big`/`little` BADC, `little`/`little` DCBA.
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from drivers.errors import InputError


class Order(Enum):
    """Order of words in a value, or of bytes in a word: which end comes first."""

    BIG = "big"
    LITTLE = "little"


class RegisterType(Enum):
    """Interpretation of the bits of one or more registers."""

    BIT = "bit"  # a coil or a discrete input
    BITS = "bits"  # a 16-bit field of named flags
    U16 = "u16"
    I16 = "i16"
    U32 = "u32"
    I32 = "i32"
    U64 = "u64"
    I64 = "i64"
    F32 = "f32"
    F64 = "f64"
    TEN_THOUSANDS = "ten_thousands"  # two words with signs of their own: high · 10000 + low
    STRING = "string"  # ASCII, two characters per register

    @property
    def words(self) -> int:
        """Number of registers of a value; 0 for a string, whose length the map states."""
        return _WORDS[self]

    @property
    def is_integer(self) -> bool:
        """Whether values are whole numbers."""
        return self in _INTEGER_CODES

    @property
    def is_float(self) -> bool:
        """Whether values are IEEE 754 numbers."""
        return self in _FLOAT_CODES

    @property
    def bounds(self) -> tuple[int, int]:
        """Least and greatest raw value of an integer type."""
        if self is RegisterType.TEN_THOUSANDS:
            return -(_TEN_THOUSAND**2) + 1, _TEN_THOUSAND**2 - 1
        bits = 1 if self is RegisterType.BIT else 16 * self.words
        if self in _SIGNED:
            return -(1 << (bits - 1)), (1 << (bits - 1)) - 1
        return 0, (1 << bits) - 1


_TEN_THOUSAND = 10_000
_INTEGER_CODES = {
    RegisterType.BIT: "",
    RegisterType.BITS: "H",
    RegisterType.U16: "H",
    RegisterType.I16: "h",
    RegisterType.U32: "I",
    RegisterType.I32: "i",
    RegisterType.U64: "Q",
    RegisterType.I64: "q",
    RegisterType.TEN_THOUSANDS: "hh",
}
_FLOAT_CODES = {RegisterType.F32: "f", RegisterType.F64: "d"}
_SIGNED = (RegisterType.I16, RegisterType.I32, RegisterType.I64)
_WORDS = {
    RegisterType.BIT: 1,
    RegisterType.BITS: 1,
    RegisterType.U16: 1,
    RegisterType.I16: 1,
    RegisterType.U32: 2,
    RegisterType.I32: 2,
    RegisterType.U64: 4,
    RegisterType.I64: 4,
    RegisterType.F32: 2,
    RegisterType.F64: 4,
    RegisterType.TEN_THOUSANDS: 2,
    RegisterType.STRING: 0,
}

Raw = int | float | str
"""A value before scale and offset: an int for integers and bits, a float for f32 and f64, a str for strings."""


@dataclass(frozen=True)
class Layout:
    """Type and orders of one value; length: number of registers of a string. Raises InputError for a length outside 1…123."""

    type: RegisterType
    word_order: Order = Order.BIG
    byte_order: Order = Order.BIG
    length: int = 0

    def __post_init__(self) -> None:
        if self.type is RegisterType.STRING and not 1 <= self.length <= 123:
            raise InputError(f"a string of {self.length} registers, expected 1 to 123")

    @property
    def words(self) -> int:
        """Number of registers (or coils) of the value."""
        return self.length if self.type is RegisterType.STRING else self.type.words


def decode(registers: Sequence[int], layout: Layout) -> Raw:
    """Registers, shape (layout.words,), each 0…65535, -> the raw value. Raises InputError for another number of registers."""
    if len(registers) != layout.words:
        raise InputError(f"{len(registers)} registers for a {layout.type.value}, expected {layout.words}")
    if layout.type is RegisterType.BIT:
        return int(bool(registers[0]))
    data = _to_bytes(registers, layout)
    if layout.type is RegisterType.STRING:
        return data.split(b"\0", 1)[0].decode("ascii", errors="replace").rstrip(" ")
    code = _INTEGER_CODES.get(layout.type) or _FLOAT_CODES[layout.type]
    if layout.type is RegisterType.TEN_THOUSANDS:
        high, low = struct.unpack(f">{code}", data)
        return int(high * _TEN_THOUSAND + low)
    value: int | float = struct.unpack(f">{code}", data)[0]
    return value


def encode(value: Raw, layout: Layout) -> tuple[int, ...]:
    """The raw value -> registers, shape (layout.words,).

    Raises InputError for a value outside the type: nothing is clipped or wrapped.
    """
    kind = layout.type
    if kind is RegisterType.STRING:
        return _from_bytes(_string_bytes(value, layout), layout)
    if isinstance(value, str):
        raise InputError(f"value {value!r} for a {kind.value}, expected a number")
    if kind.is_float:
        try:
            data = struct.pack(f">{_FLOAT_CODES[kind]}", value)
        except OverflowError as error:
            raise InputError(f"value {value:g} does not fit a {kind.value}") from error
        return _from_bytes(data, layout)
    low, high = kind.bounds
    if not math.isfinite(value) or value != int(value) or not low <= value <= high:
        raise InputError(f"value {value!r} does not fit a {kind.value}, expected a whole number {low} to {high}")
    if kind is RegisterType.BIT:
        return (int(value),)
    if kind is RegisterType.TEN_THOUSANDS:
        sign = -1 if value < 0 else 1
        high, low = divmod(abs(int(value)), _TEN_THOUSAND)
        return _from_bytes(struct.pack(f">{_INTEGER_CODES[kind]}", sign * high, sign * low), layout)
    return _from_bytes(struct.pack(f">{_INTEGER_CODES[kind]}", int(value)), layout)


def _string_bytes(value: Raw, layout: Layout) -> bytes:
    if not isinstance(value, str) or not value.isascii():
        raise InputError(f"value {value!r} for a string, expected ASCII text")
    if len(value) > 2 * layout.length:
        raise InputError(f"text of {len(value)} characters, expected at most {2 * layout.length}")
    return value.encode("ascii").ljust(2 * layout.length, b"\0")


def _to_bytes(registers: Sequence[int], layout: Layout) -> bytes:
    # a string runs in the order of its registers; only a number has a most significant word
    reverse = layout.word_order is Order.LITTLE and layout.type is not RegisterType.STRING
    order = "big" if layout.byte_order is Order.BIG else "little"
    words = reversed(registers) if reverse else registers
    return b"".join(int(word).to_bytes(2, order) for word in words)  # type: ignore[arg-type]


def _from_bytes(data: bytes, layout: Layout) -> tuple[int, ...]:
    order = ">" if layout.byte_order is Order.BIG else "<"
    words = struct.unpack(f"{order}{len(data) // 2}H", data)
    reverse = layout.word_order is Order.LITTLE and layout.type is not RegisterType.STRING
    return tuple(reversed(words)) if reverse else tuple(words)


@dataclass(frozen=True)
class OrderMatch:
    """One layout by which the registers give the known value; offset counts registers from the first one given."""

    offset: int
    layout: Layout
    value: int | float


_PROBED = (
    RegisterType.U16,
    RegisterType.I16,
    RegisterType.U32,
    RegisterType.I32,
    RegisterType.F32,
    RegisterType.U64,
    RegisterType.I64,
    RegisterType.F64,
    RegisterType.TEN_THOUSANDS,
)
_F32_RELATIVE = 2.0**-23  # a known value typed in decimals is not exactly a float


def probe_order(
    registers: Sequence[int], known_value: float, *, scale: float = 1.0, tolerance: float = 0.0
) -> tuple[OrderMatch, ...]:
    """All offsets, types and orders by which the registers give the known value.

    registers: raw registers as read, shape (n,); one or two more on either side of the documented address also reveal an
    address base that is off by one. known_value: what the drive's own display shows, in units of `scale` per count;
    tolerance: largest deviation in the same unit (for an axis that is not quite at rest).

    Signed and unsigned types are both returned where the value fits both; a value whose words are all alike (0, −1, 0x00010001) fits
    every word order, so choose a known value with four different bytes. Raises InputError for arguments that are not finite.
    """
    if not scale or not math.isfinite(scale):
        raise InputError(f"scale is {scale!r}, expected a finite number other than 0")
    if not math.isfinite(known_value) or not tolerance >= 0:
        raise InputError(f"known value {known_value!r} ± {tolerance!r}, expected finite numbers, tolerance >= 0")
    matches: list[OrderMatch] = []
    for kind in _PROBED:
        word_orders = tuple(Order) if kind.words > 1 else (Order.BIG,)
        for offset in range(len(registers) - kind.words + 1):
            part = registers[offset : offset + kind.words]
            for word_order, byte_order in itertools.product(word_orders, Order):
                layout = Layout(kind, word_order, byte_order)
                raw = decode(part, layout)
                if not isinstance(raw, str) and _agrees(raw, known_value, scale, tolerance):
                    matches.append(OrderMatch(offset, layout, raw if scale == 1.0 else raw * scale))
    return tuple(matches)


def _agrees(raw: int | float, known: float, scale: float, tolerance: float) -> bool:
    if isinstance(raw, int) and scale == 1.0 and tolerance == 0.0:
        return raw == known  # exact for 64 bits too
    if not math.isfinite(raw):
        return False
    slack = tolerance + (_F32_RELATIVE * abs(known) if isinstance(raw, float) else abs(scale) * 1e-6)
    return abs(raw * scale - known) <= slack
