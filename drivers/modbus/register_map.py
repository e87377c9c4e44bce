"""The register map of one drive model: a TOML file, read once, checked, frozen.

    [map]                    name, description, how addresses are written (address_base, address_rules), what the model allows in one
                             request, and where what is said of it comes from (`drivers.modbus.map_facts`)
    [registers.NAME]         one value: address, table, type, scale, unit, orders, access, limits, memory, source, strength
    [bus]                    how the drive is set up from the factory: baud, parity, stop_bits, unit, port, and a note
    [[facts]]                what else is said of the model, each with its source and strength
    [drive] and below        which of them make it a servo drive (`drivers.modbus.drive_map`)

Addresses are written as in the drive's manual, and `address_base` states how that is; inside, every address is the
0-based PDU address. `drivers/modbus/maps` holds two complete examples; scale and offset mean value = raw · scale + offset.
Conditions and writes of the [drive] part are raw, before scale.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from drivers.errors import InputError
from drivers.facts import Strength
from drivers.files import named_file, shipped
from drivers.modbus.codec import Layout, Order, Raw, RegisterType, decode, encode
from drivers.modbus.map_facts import UNSTATED, Fact, Origin
from drivers.modbus.plan import MAX_READ_REGISTERS, MAX_WRITE_REGISTERS, AddressSpace, Span
from drivers.toml_schema import Document, either
from drivers.toml_types import Key, Limits, SchemaError, Text, Via, one_of

Value = int | float | str
"""A value after scale and offset; an int where the type is an integer, the scale 1 and the offset 0."""


class AddressBase(Enum):
    """How a manual writes addresses."""

    PDU0 = "pdu0"  # as on the wire, the first register is 0
    ONE = "one"  # the first register is 1
    MODICON5 = "modicon5"  # 00001 coils, 10001 discrete inputs, 30001 input registers, 40001 holding registers
    MODICON6 = "modicon6"  # the same with six digits: 400001 …, which reaches all 65536


class RegisterRights(Enum):
    RO = "ro"
    WO = "wo"
    RW = "rw"


class Memory(Enum):
    """The memory of a written value; an EEPROM cell bears about 100 000 writes."""

    RAM = "ram"
    EEPROM = "eeprom"


_MODICON_TABLES = {0: AddressSpace.COIL, 1: AddressSpace.DISCRETE, 3: AddressSpace.INPUT, 4: AddressSpace.HOLDING}


@dataclass(frozen=True)
class Register:
    """One value of the drive. `span.start` is the 0-based PDU address; minimum and maximum are in `unit`, None is unlimited.

    self_clearing: the drive clears the value when it has acted on it, so reading it back proves nothing.
    reads_state: what it reads is a state of the drive, not the value that was written.
    """

    name: str
    table: AddressSpace
    span: Span
    layout: Layout
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    access: RegisterRights = RegisterRights.RO
    minimum: float | None = None
    maximum: float | None = None
    memory: Memory = Memory.RAM
    wear_budget: int = 0
    self_clearing: bool = False
    bits: Mapping[str, int] = field(default_factory=dict)
    description: str = ""
    reads_state: bool = False
    origin: Origin = UNSTATED

    @property
    def shows_writes(self) -> bool:
        """Whether reading it back shows the value that was written."""
        return self.readable and not self.self_clearing and not self.reads_state

    @property
    def readable(self) -> bool:
        return self.access is not RegisterRights.WO

    @property
    def writable(self) -> bool:
        return self.access is not RegisterRights.RO

    @property
    def place(self) -> tuple[AddressSpace, Span]:
        return self.table, self.span

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Allowed range in its unit: the file's limits within those of its type."""
        if not self.layout.type.is_integer:
            return self.minimum, self.maximum
        low, high = sorted(raw * self.scale + self.offset for raw in self.layout.type.bounds)
        return (
            low if self.minimum is None else max(low, self.minimum),
            high if self.maximum is None else min(high, self.maximum),
        )

    def value_of(self, raw: Raw) -> Value:
        """Raw value -> engineering units, raw · scale + offset."""
        if isinstance(raw, str) or (self.scale == 1.0 and self.offset == 0.0):
            return raw
        return raw * self.scale + self.offset

    def raw_of(self, value: Value) -> Raw:
        """Engineering units -> raw, to the nearest step. Raises InputError outside the limits or the type."""
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if not isinstance(value, str) and math.isfinite(value) and not low <= value <= high:
            raise InputError(f"{self.name} cannot be {value:g} {self.unit}, allowed is {low:g} to {high:g}".rstrip())
        return self.raw_of_any(value)

    def raw_of_any(self, value: Value) -> Raw:
        """As `raw_of`, without the file's limits. Raises InputError outside the type."""
        layout = self.layout
        if isinstance(value, str) or layout.type is RegisterType.STRING:
            return self._encodable(value)
        if not math.isfinite(value):
            raise InputError(f"{self.name} cannot be {value!r}, expected a finite number")
        if self.scale == 1.0 and self.offset == 0.0:
            raw: Raw = value if layout.type.is_float else round(value)
        else:
            steps = (value - self.offset) / self.scale
            raw = steps if layout.type.is_float else round(steps)
        return self._encodable(raw)

    def _encodable(self, raw: Raw) -> Raw:
        try:
            encode(raw, self.layout)
        except InputError as error:
            raise InputError(f"{self.name}: {error.what}") from error
        return raw

    def decode(self, registers: tuple[int, ...]) -> Value:
        """Registers -> engineering units."""
        return self.value_of(decode(registers, self.layout))

    def encode(self, value: Value) -> tuple[int, ...]:
        """Engineering units -> registers, without the file's limits. Raises InputError outside the type."""
        return encode(self.raw_of_any(value), self.layout)


@dataclass(frozen=True)
class BusDefaults:
    """How the drive's port is set up from the factory. port: of Modbus TCP, None for a drive on a serial line."""

    baud: Annotated[int, Limits(ge=300, le=4_000_000)] = 19_200
    parity: Annotated[str, one_of("N", "E", "O")] = "E"
    stop_bits: Annotated[int, one_of(1, 2)] = 1
    unit: Annotated[int, Limits(ge=0, le=255)] = 1
    port: Annotated[int, Limits(ge=1, le=65535)] | None = None
    note: str = ""


FACTORY = BusDefaults()


@dataclass(frozen=True)
class RegisterMap:
    """All registers of a drive model. `path` names the file in errors.

    gaps_readable: a request may touch addresses that have no register. single_writes: function 6 is understood (else always 16).
    one_value_per_request: an address is the number of an object, not a place, so that neighbours are never read or written together.
    prove_writes: the drive acknowledges writes that it drops, so that every one is read back.
    """

    path: Path
    name: str
    description: str
    registers: Mapping[str, Register]
    gaps_readable: bool = True
    single_writes: bool = True
    max_read: int = MAX_READ_REGISTERS
    max_write: int = MAX_WRITE_REGISTERS
    one_value_per_request: bool = False
    prove_writes: bool = False
    origin: Origin = UNSTATED
    facts: tuple[Fact, ...] = ()
    bus: BusDefaults = FACTORY

    def __getitem__(self, name: str) -> Register:
        """The register of a name. Raises InputError for a name that the map does not have."""
        if name not in self.registers:
            raise InputError(f"has no register {name!r}", path=self.path)
        return self.registers[name]


def shipped_maps() -> dict[str, Path]:
    """The maps that come with the package, by name."""
    return shipped("drivers.modbus", "maps")


def find_map(name_or_path: str | Path) -> Path:
    """A file that exists, or the name of a shipped map. Raises InputError naming the shipped ones."""
    return named_file(name_or_path, shipped_maps(), "register map")


def _finite(value: float, _: Document) -> float:
    if not math.isfinite(value):
        raise ValueError
    return value


def _not_zero(value: float, _: Document) -> float:
    if value == 0:
        raise ValueError
    return value


def _written_address(value: int | str, _: Document) -> int | str:
    if isinstance(value, str) and not value.isdecimal():
        return value
    address = int(value)  # TOML has no number 00001
    if not 0 <= address <= 999_999:
        raise ValueError
    return address


@dataclass(frozen=True)
class AddressRule:
    """How a manual's parameter number becomes an address: first + group · page + step · index.

    groups: first and last group that it holds for. group_base, index_base: 10 or 16, their digits. high_word_before: a value of two
    registers begins one address lower (the number is that of its low word).
    """

    groups: tuple[int, int] = (0, 255)
    first: Annotated[int, Limits(ge=0, le=0xFFFF, description="an address")] = 0
    page: Annotated[int, Limits(ge=0, le=0xFFFF, description="addresses per group")] = 0x100
    step: Annotated[int, Limits(ge=1, le=16, description="addresses per parameter, 1 to 16")] = 1
    group_base: Annotated[int, one_of(10, 16)] = 10
    index_base: Annotated[int, one_of(10, 16)] = 10
    high_word_before: bool = False


_NUMBER = re.compile(r"(?:[A-Z][a-z]?)?([0-9A-Fa-f]+)[.-]([0-9A-Fa-f]+)")  # Pr8.02, P5-07, H0B.34, C0A.05


def _by_rule(number: str, words: int, rules: tuple[AddressRule, ...]) -> int:
    """The address of a parameter such as "P5-07". Raises SchemaError."""
    match = _NUMBER.fullmatch(number)
    for rule in rules:
        try:
            group, index = (int(match[1], rule.group_base), int(match[2], rule.index_base)) if match else (-1, 0)
        except ValueError:
            continue
        if rule.groups[0] <= group <= rule.groups[1]:
            return rule.first + group * rule.page + rule.step * index - (rule.high_word_before and words > 1)
    raise SchemaError("address", f"is {number[:40]!r}, which no rule of [map] address_rules makes an address of")


def _limits(value: tuple[float, float], _: Document) -> tuple[float, float]:
    if not value[0] <= value[1]:
        raise ValueError
    return value


Finite = Annotated[float, _finite, Limits(description="a number")]
Budget = Annotated[int, Limits(ge=0, le=10**9, description="a whole number >= 0")]


@dataclass(frozen=True)
class _Head:
    """[map]: frames, and what holds for all registers that do not say otherwise."""

    name: Text
    address_base: AddressBase
    word_order: Order
    byte_order: Order = Order.BIG
    description: str = ""
    eeprom_write_budget: Budget = 100
    gaps_readable: bool = True
    single_writes: bool = True
    max_read_registers: Annotated[int, Limits(ge=4, le=MAX_READ_REGISTERS)] = MAX_READ_REGISTERS
    max_write_registers: Annotated[int, Limits(ge=4, le=MAX_WRITE_REGISTERS)] = MAX_WRITE_REGISTERS
    table: AddressSpace | None = None
    address_rules: tuple[AddressRule, ...] = ()
    one_value_per_request: bool = False
    prove_writes: bool = False
    origin: Annotated[Origin, Key("")] = UNSTATED


@dataclass(frozen=True)
class _Row:
    """[registers.NAME] as it is written."""

    address: Annotated[
        int | str, Via(int | str, _written_address, "a whole number, or a number by [map] address_rules")
    ]
    table: AddressSpace | None = None
    type: RegisterType | None = None
    word_order: Order | None = None
    byte_order: Order | None = None
    length: Annotated[int, Limits(ge=1, le=MAX_WRITE_REGISTERS, description="1 to 123 registers")] | None = None
    scale: Annotated[float, _finite, _not_zero, Limits(description="a number other than 0")] = 1.0
    offset: Finite = 0.0
    unit: Text = ""
    access: RegisterRights | None = None
    limits: Annotated[tuple[float | None, float | None], Via(tuple[Finite, Finite], _limits, "[low, high]")] = (
        None,
        None,
    )
    memory: Memory = Memory.RAM
    wear_budget: Budget | None = None
    self_clearing: bool = False
    bits: dict[Text, Annotated[int, Limits(ge=0, le=15, description="a bit number, 0 to 15")]] = field(
        default_factory=dict
    )
    description: str = ""
    reads_state: bool = False
    source: Text | None = None
    strength: Strength | None = None


def parse_registers(document: Document) -> RegisterMap:
    """[map] and [registers] of an open document. Raises InputError naming file, line and key."""
    origin = document.load(Origin, "map", beside=[_Head])
    head = document.load(_Head, "map", beside=[Origin], usual={"origin": origin})
    facts = document.load(tuple[Fact, ...], "facts", required=False) if "facts" in document else ()
    registers: dict[str, Register] = {}
    for name, row in document.load(dict[str, _Row], "registers").items():
        with document.blaming("registers", name):
            registers[name] = _register(name, row, head)
    if not registers:
        raise document.fail("registers", "is empty, expected at least one register")
    if not head.one_value_per_request:
        _refuse_overlaps(document, registers)
    return RegisterMap(
        document.path,
        head.name,
        head.description,
        MappingProxyType(registers),
        gaps_readable=head.gaps_readable,
        single_writes=head.single_writes,
        max_read=head.max_read_registers,
        max_write=head.max_write_registers,
        one_value_per_request=head.one_value_per_request,
        prove_writes=head.prove_writes,
        origin=head.origin,
        facts=facts,
        bus=document.load(BusDefaults, "bus", required=False),
    )


def _register(name: str, row: _Row, head: _Head) -> Register:
    table, start = _address(row, head)
    kind = row.type or (RegisterType.BIT if table.is_bits else None)
    if kind is None:
        raise SchemaError("", f"lacks type, expected {either(each.value for each in RegisterType)}")
    if table.is_bits is not (kind is RegisterType.BIT):
        raise SchemaError("type", f"is {kind.value}, which table {table.value} cannot hold")
    if row.length is not None and kind is not RegisterType.STRING:
        raise SchemaError("length", f"belongs to the type string, this is {kind.value}")
    if row.bits and kind is not RegisterType.BITS:
        raise SchemaError("bits", f"belongs to the type bits, this is {kind.value}")
    access = row.access or (RegisterRights.RW if table.is_writable else RegisterRights.RO)
    if access is not RegisterRights.RO and not table.is_writable:
        raise SchemaError("access", f"is {access.value}, but table {table.value} is read only")
    length = (row.length or 1) if kind is RegisterType.STRING else 0
    layout = Layout(kind, row.word_order or head.word_order, row.byte_order or head.byte_order, length)
    if start + layout.words > 0x10000:
        what = f"leaves the 65536 registers, it takes {layout.words} from {start} (0-based)"
        raise SchemaError("address", what)
    return Register(
        name=name,
        table=table,
        span=Span(start, layout.words),
        layout=layout,
        scale=row.scale,
        offset=row.offset,
        unit=row.unit,
        access=access,
        minimum=row.limits[0],
        maximum=row.limits[1],
        memory=row.memory,
        wear_budget=head.eeprom_write_budget if row.wear_budget is None else row.wear_budget,
        self_clearing=row.self_clearing,
        bits=MappingProxyType(row.bits),
        description=row.description,
        reads_state=row.reads_state,
        origin=head.origin.but(row.source, row.strength),
    )


def _address(row: _Row, head: _Head) -> tuple[AddressSpace, int]:
    """The table and the 0-based PDU address of the manual's `address`. Raises SchemaError."""
    table, base = row.table or head.table, head.address_base
    words = 1 if row.type is None else row.type.words
    written = row.address if isinstance(row.address, int) else _by_rule(row.address, words, head.address_rules)
    if base in (AddressBase.PDU0, AddressBase.ONE):
        if table is None:
            raise SchemaError("", f"lacks table, expected {either(each.value for each in AddressSpace)}")
        start = written - (base is AddressBase.ONE)
        if not 0 <= start <= 0xFFFF:
            raise SchemaError("address", f"is {written}, expected {written - start} to {0xFFFF + written - start}")
        return table, start
    digits = 10_000 if base is AddressBase.MODICON5 else 100_000
    leading, within = divmod(written, digits)
    highest = 9_999 if base is AddressBase.MODICON5 else 65_536
    if leading not in _MODICON_TABLES or not 1 <= within <= highest:
        raise SchemaError("address", f"is {written}, expected a {base.value} address such as {4 * digits + 1}")
    stated = _MODICON_TABLES[leading]
    if table not in (None, stated):
        raise SchemaError("table", f"is {table.value}, but address {written} is of table {stated.value}")
    return stated, within - 1


def _refuse_overlaps(document: Document, registers: Mapping[str, Register]) -> None:
    """Raise InputError for two names on one address, which is nearly always a typing error."""
    furthest: dict[AddressSpace, Register] = {}
    for register in sorted(registers.values(), key=lambda each: each.span):
        before = furthest.get(register.table)
        if before is not None and register.span.start < before.span.end:
            raise document.fail(
                ("registers", register.name, "address"),
                f"overlaps {before.name}: both take the {register.table.value} at {register.span.start} (0-based)",
            )
        furthest[register.table] = register
