"""The register map of one drive model: a TOML file, read once, checked, frozen.

    [map]                    name, description, how addresses are written (address_base), what the model bears in one request
    [registers.NAME]         one value: address, table, type, scale, unit, orders, access, limits, memory
    [drive] and below        which of them make it a servo drive (`drivers.modbus.drive_map`)

Addresses are written the way the drive's manual writes them, and `address_base` says which way that is; inside, everything is the
0-based PDU address. `drivers/modbus/maps` holds two complete examples; scale and offset mean value = raw · scale + offset.
Conditions and writes of the [drive] part are raw, before scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

from drivers.errors import InputError
from drivers.modbus.codec import Layout, Order, Raw, RegisterType, decode, encode
from drivers.modbus.plan import MAX_READ_REGISTERS, MAX_WRITE_REGISTERS, Span, Table
from drivers.strict_toml import REQUIRED, Document, Section, flag, interval, number, text, whole

Value = int | float | str
"""A value after scale and offset; an int where the type is an integer, the scale 1 and the offset 0."""


class AddressBase(Enum):
    """How a manual writes addresses."""

    PDU0 = "pdu0"  # as on the wire, the first register is 0
    ONE = "one"  # the first register is 1
    MODICON5 = "modicon5"  # 00001 coils, 10001 discrete inputs, 30001 input registers, 40001 holding registers
    MODICON6 = "modicon6"  # the same with six digits: 400001 …, which reaches all 65536


class Access(Enum):
    RO = "ro"
    WO = "wo"
    RW = "rw"


class Memory(Enum):
    """Where a written value goes; an EEPROM cell bears some 100 000 writes in its life."""

    RAM = "ram"
    EEPROM = "eeprom"


_MODICON_TABLES = {0: Table.COIL, 1: Table.DISCRETE, 3: Table.INPUT, 4: Table.HOLDING}


@dataclass(frozen=True)
class Register:
    """One value of the drive. `span.start` is the 0-based PDU address; minimum and maximum are in `unit`, None is unlimited.

    self_clearing: the drive takes the value back when it has acted on it, so reading it back proves nothing.
    """

    name: str
    table: Table
    span: Span
    layout: Layout
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    access: Access = Access.RO
    minimum: float | None = None
    maximum: float | None = None
    memory: Memory = Memory.RAM
    wear_budget: int = 0
    self_clearing: bool = False
    bits: Mapping[str, int] = field(default_factory=dict)
    description: str = ""

    @property
    def readable(self) -> bool:
        return self.access is not Access.WO

    @property
    def writable(self) -> bool:
        return self.access is not Access.RO

    @property
    def place(self) -> tuple[Table, Span]:
        return self.table, self.span

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """What it may be, in its unit: the file's limits within those of its type."""
        if not self.layout.type.is_integer:
            return self.minimum, self.maximum
        low, high = sorted(raw * self.scale + self.offset for raw in self.layout.type.bounds)
        return (
            low if self.minimum is None else max(low, self.minimum),
            high if self.maximum is None else min(high, self.maximum),
        )

    def value_of(self, raw: Raw) -> Value:
        """Raw -> engineering units."""
        if isinstance(raw, str) or (self.scale == 1.0 and self.offset == 0.0):
            return raw
        return raw * self.scale + self.offset

    def raw_of(self, value: Value) -> Raw:
        """Engineering units -> raw, to the nearest step. Raises InputError outside the limits or the type."""
        layout = self.layout
        if isinstance(value, str) or layout.type is RegisterType.STRING:
            return self._encodable(value)
        if not math.isfinite(value):
            raise InputError(f"{self.name} cannot be {value!r}, expected a finite number")
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if not low <= value <= high:
            raise InputError(f"{self.name} cannot be {value:g} {self.unit}, allowed is {low:g} to {high:g}".rstrip())
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
        """Engineering units -> registers. Raises InputError outside the limits or the type."""
        return encode(self.raw_of(value), self.layout)


@dataclass(frozen=True)
class RegisterMap:
    """All registers of a drive model. `path` names the file in errors.

    gaps_readable: a request may touch addresses that have no register. single_writes: function 6 is understood (else always 16).
    """

    path: Path
    name: str
    description: str
    registers: Mapping[str, Register]
    gaps_readable: bool = True
    single_writes: bool = True
    max_read: int = MAX_READ_REGISTERS
    max_write: int = MAX_WRITE_REGISTERS
    response_s: float = 0.003

    def __getitem__(self, name: str) -> Register:
        """Raises InputError for a name the map does not have."""
        if name not in self.registers:
            raise InputError(f"has no register {name!r}", path=self.path)
        return self.registers[name]


def shipped_maps() -> dict[str, Path]:
    """The maps that come with the package, by name."""
    folder = resources.files("drivers.modbus") / "maps"
    return {Path(str(item)).stem: Path(str(item)) for item in folder.iterdir() if item.name.endswith(".toml")}


def find_map(name_or_path: str | Path) -> Path:
    """A file that exists, or the name of a shipped map. Raises InputError naming the shipped ones."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = shipped_maps()
    if str(name_or_path) in shipped:
        return shipped[str(name_or_path)]
    raise InputError(f"is neither a file nor a shipped register map ({', '.join(sorted(shipped))})", path=path)


def parse_registers(document: Document, root: Section) -> RegisterMap:
    """[map] and [registers] of an open document; takes both out of `root`."""
    head = root.child("map")
    name = head.take("name", text, "a name")
    description = head.take("description", text, "a sentence", "")
    defaults = _Defaults(
        base=head.take("address_base", AddressBase, _choices(AddressBase)),
        word_order=head.take("word_order", Order, _choices(Order)),
        byte_order=head.take("byte_order", Order, _choices(Order), Order.BIG),
        wear_budget=head.take("eeprom_write_budget", whole(0, 10**9), "a whole number >= 0", 100),
    )
    frame = {
        "gaps_readable": head.take("gaps_readable", flag, "true or false", True),
        "single_writes": head.take("single_writes", flag, "true or false", True),
        "max_read": head.take("max_read_registers", whole(4, MAX_READ_REGISTERS), "4 to 125", MAX_READ_REGISTERS),
        "max_write": head.take("max_write_registers", whole(4, MAX_WRITE_REGISTERS), "4 to 123", MAX_WRITE_REGISTERS),
        "response_s": head.take("response_time_s", number, "seconds", 0.003),
    }
    head.finish()
    registers: dict[str, Register] = {}
    holder = root.child("registers")
    for each, section in holder.named():
        registers[each] = _register(each, section, defaults)
    if not registers:
        raise document.fail("registers", "is empty, expected at least one register")
    _refuse_overlaps(document, registers)
    return RegisterMap(document.path, name, description, MappingProxyType(registers), **frame)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Defaults:
    """What [map] says for all registers that do not say otherwise."""

    base: AddressBase
    word_order: Order
    byte_order: Order
    wear_budget: int


def _register(name: str, section: Section, defaults: _Defaults) -> Register:
    table = section.take("table", Table, _choices(Table), None)
    table, start = _address(section, defaults.base, table)
    kind = section.take("type", RegisterType, _choices(RegisterType), RegisterType.BIT if table.is_bits else REQUIRED)
    if table.is_bits is not (kind is RegisterType.BIT):
        raise section.fail("type", f"is {kind.value}, which table {table.value} cannot hold")
    layout = Layout(
        kind,
        section.take("word_order", Order, _choices(Order), defaults.word_order),
        section.take("byte_order", Order, _choices(Order), defaults.byte_order),
        section.take("length", whole(1, MAX_WRITE_REGISTERS), "1 to 123 registers", 1)
        if kind is RegisterType.STRING
        else 0,
    )
    default = Access.RW if table.is_writable else Access.RO
    access = section.take("access", Access, _choices(Access), default)
    if access is not Access.RO and not table.is_writable:
        raise section.fail("access", f"is {access.value}, but table {table.value} is read only")
    memory = section.take("memory", Memory, _choices(Memory), Memory.RAM)
    limits = section.take("limits", interval, "[low, high]", (None, None))
    register = Register(
        name=name,
        table=table,
        span=_span(section, start, layout.words),
        layout=layout,
        scale=section.take("scale", _not_zero, "a number other than 0", 1.0),
        offset=section.take("offset", number, "a number", 0.0),
        unit=section.take("unit", text, "a unit", ""),
        access=access,
        minimum=limits[0],
        maximum=limits[1],
        memory=memory,
        wear_budget=section.take("wear_budget", whole(0, 10**9), "a whole number >= 0", defaults.wear_budget),
        self_clearing=section.take("self_clearing", flag, "true or false", False),
        bits=section.take("bits", _bit_names, "a table of name = bit number, 0 to 15", MappingProxyType({})),
        description=section.take("description", text, "a sentence", ""),
    )
    if register.bits and kind is not RegisterType.BITS:
        raise section.fail("bits", f"belongs to the type bits, this is {kind.value}")
    section.finish()
    return register


def _address(section: Section, base: AddressBase, table: Table | None) -> tuple[Table, int]:
    """The table and the 0-based PDU address of what the manual calls `address`."""
    written = section.take("address", _written_address, "a whole number")
    if base in (AddressBase.PDU0, AddressBase.ONE):
        if table is None:
            raise section.document.fail(section.place, f"lacks table, expected {_choices(Table)}")
        start = written - (base is AddressBase.ONE)
        if not 0 <= start <= 0xFFFF:
            raise section.fail("address", f"is {written}, expected {written - start} to {0xFFFF + written - start}")
        return table, start
    digits = 10_000 if base is AddressBase.MODICON5 else 100_000
    leading, within = divmod(written, digits)
    highest = 9_999 if base is AddressBase.MODICON5 else 65_536
    if leading not in _MODICON_TABLES or not 1 <= within <= highest:
        raise section.fail("address", f"is {written}, expected a {base.value} address such as {4 * digits + 1}")
    stated = _MODICON_TABLES[leading]
    if table not in (None, stated):
        raise section.fail("table", f"is {table.value}, but address {written} is of table {stated.value}")
    return stated, within - 1


def _written_address(value: Any) -> int:
    if isinstance(value, str):  # TOML has no number 00001
        return int(value, 10)
    return whole(0, 999_999)(value)


def _span(section: Section, start: int, words: int) -> Span:
    if start + words > 0x10000:
        raise section.fail("address", f"leaves the 65536 registers, it takes {words} from {start} (0-based)")
    return Span(start, words)


def _not_zero(value: Any) -> float:
    if number(value) == 0:
        raise ValueError
    return float(value)


def _bit_names(value: Any) -> Mapping[str, int]:
    if not isinstance(value, dict):
        raise TypeError
    bits = {text(name): whole(0, 15)(bit) for name, bit in value.items()}
    return MappingProxyType(bits)


def _choices(kind: type[Enum]) -> str:
    return " or ".join(member.value for member in kind)


def _refuse_overlaps(document: Document, registers: Mapping[str, Register]) -> None:
    """Two names on one address are nearly always a slip of the pen."""
    furthest: dict[Table, Register] = {}
    for register in sorted(registers.values(), key=lambda each: each.span):
        before = furthest.get(register.table)
        if before is not None and register.span.start < before.span.end:
            raise document.fail(
                f"registers.{register.name}.address",
                f"overlaps {before.name}: both take the {register.table.value} at {register.span.start} (0-based)",
            )
        furthest[register.table] = register
