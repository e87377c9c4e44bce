"""The registers of a Modbus drive's own correction table.

    [drive.correction_table]     name, points, nodes, interpolation, outside, directions, sign
                                 position, plus, minus: the register of the first value; the others follow it without a gap
                                 count, origin, step, backlash, applied: registers, where the drive has them
    [drive.correction_table.enable]   register, on, off

Units, scales, types, orders, limits and memory are those of the registers named; those of the first register hold for its column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from drivers.correction_table import COLUMNS, UNITS, RawFormat, TableDescription, TableHead
from drivers.modbus.map_roles import Named, Whole
from drivers.modbus.register_map import Memory, Register, RegisterMap
from drivers.toml_schema import Document
from drivers.toml_types import Limits, SchemaError


@dataclass(frozen=True)
class TableBlocks:
    """columns: the first register of each; scalars: count, origin, step, backlash and applied, by name."""

    description: TableDescription
    columns: Mapping[str, Register]
    scalars: Mapping[str, Register]
    enable: Register
    on: int
    off: int

    def names(self) -> frozenset[str]:
        """Names of all registers of the table; none of them is a parameter."""
        found = [*self.columns.values(), *self.scalars.values(), self.enable]
        return frozenset(register.name for register in found)


def quantity_of(register: Register) -> RawFormat:
    """Unit, scale and range of a register's raw numbers."""
    low, high = register.layout.type.bounds
    if register.minimum is not None:
        low = max(low, math.ceil(register.minimum / register.scale - 1e-9))
    if register.maximum is not None:
        high = min(high, math.floor(register.maximum / register.scale + 1e-9))
    return RawFormat(register.unit, register.scale, low, high)


@dataclass(frozen=True)
class _Switch:
    register: Whole
    on: int = 1
    off: int = 0

    def __post_init__(self) -> None:
        low, high = self.register.layout.type.bounds
        for key, value in (("on", self.on), ("off", self.off)):
            if not low <= value <= high:
                raise SchemaError(key, f"is {value}, expected a whole number {low} to {high}")
        if self.on == self.off or not self.register.writable or not self.register.readable:
            what = f"is {self.on}, off {self.off}, expected two values of a register that is read and written"
            raise SchemaError("on", what)


@dataclass(frozen=True, kw_only=True)
class TableSection(TableHead):
    """[drive.correction_table] as it is written."""

    points: Annotated[int, Limits(ge=1, le=32768)]
    enable: _Switch
    plus: Named
    minus: Named | None = None
    position: Named | None = None
    count: Named
    origin: Named | None = None
    step: Named | None = None
    backlash: Named | None = None
    applied: Named | None = None


def table_blocks(section: TableSection, document: Document) -> TableBlocks:
    """Check the registers of a table against each other and against neighbouring ones. Raises SchemaError."""
    named = section.named(section, "the name of a register")
    for key, register in named.items():
        if key != "applied":
            _check_numbers(key, register, in_length=key != "count")
    columns = {key: named.pop(key) for key in COLUMNS if key in named}
    for key, first in columns.items():
        _refuse_neighbours(document.context, key, first, section.points)
    for one, other in (("plus", "minus"), ("origin", "step")):
        first, second = getattr(section, one), getattr(section, other)
        if first and second and (first.unit, first.scale) != (second.unit, second.scale):
            raise SchemaError(other, f"is in another unit or scale than {one} ({first.name!r}), expected the same")
    description = section.description_of(
        position=quantity_of(section.position or named["origin"]),
        value=quantity_of(section.plus),
        step=section.step and quantity_of(section.step),
        backlash=section.backlash and quantity_of(section.backlash),
        wears=any(each.memory is Memory.EEPROM for each in (*columns.values(), *named.values())),
        shows_applied=section.applied is not None,
    )
    switch = section.enable
    return TableBlocks(description, columns, named, switch.register, switch.on, switch.off)


def _check_numbers(key: str, register: Register, *, in_length: bool) -> None:
    """Whole numbers to be read and written, in a unit of length where they stand for one."""
    if not register.layout.type.is_integer or not register.readable or not register.writable or register.offset:
        raise SchemaError(key, f"is {register.name!r}, expected whole numbers that are read and written, offset 0")
    if in_length and (register.unit not in UNITS or register.scale <= 0):
        unit = register.unit or "no unit"
        raise SchemaError(key, f"is {register.name!r} in {unit!r}, expected {', '.join(UNITS)}, scale > 0")


def _refuse_neighbours(registers: RegisterMap, column: str, first: Register, points: int) -> None:
    start, end = first.span.start, first.span.start + points * first.span.count
    if end > 0x10000:
        raise SchemaError(column, f"leaves the 65536 registers with {points} values from {first.name!r} on")
    for other in registers.registers.values():
        inside = other.span.start < end and start < other.span.end
        if other is not first and other.table is first.table and inside:
            raise SchemaError(column, f"overlaps {other.name!r}: {points} values from {first.name!r} on reach it")
