"""Parts of a register map's [drive]: registers in a role, conditions and writes.

The document's context is the `RegisterMap` with the registers. Refused: a name that does not exist, reading what is write-only,
writing what is read-only, a unit that a role cannot have, motion kept in EEPROM, a mask or value that does not fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from drivers.modbus.codec import RegisterType
from drivers.modbus.register_map import Memory, Register
from drivers.toml_schema import Document
from drivers.toml_types import Limits, SchemaError, Text, Via, not_empty, one_of


@dataclass(frozen=True)
class Condition:
    """Holds when (raw & mask) is one of the values; mask None means the whole value. `negate` inverts it."""

    register: str
    mask: int | None
    values: tuple[int, ...]
    negate: bool = False

    def holds(self, raw: int) -> bool:
        seen = raw if self.mask is None else raw & self.mask
        return (seen in self.values) is not self.negate


@dataclass(frozen=True)
class Write:
    """Write the raw value; with a mask, only the bits of the mask. pause_s: the drive is left alone for as long afterwards."""

    register: str
    mask: int | None
    value: int
    pause_s: float = 0.0


# -- roles -------------------------------------------------------------------------------------------------------------
def _named(name: str, document: Document) -> Register:
    if name not in document.context.registers:
        raise SchemaError("", f"is {name!r}, expected the name of a register in [registers]")
    return document.context[name]  # type: ignore[no-any-return]


Named = Annotated[Register, Via(Text, _named), Limits(description="the name of a register")]


def _usable(register: Register, *, written: bool, what: str) -> None:
    if not (register.writable if written else register.readable):
        raise SchemaError("", f"is {register.name!r}, which is {'read' if written else 'write'} only")
    if written and register.memory is Memory.EEPROM:
        raise SchemaError("", f"is {register.name!r}, which is kept in EEPROM; {what} would wear it out")


def role(units: tuple[str, ...] | None, *, written: bool = False, signed: bool = False) -> Via:
    """The name of a register with a number in one of these units (None: any), to be read or to be written while the axis moves.

    Its check raises SchemaError."""

    def check(register: Register, _: Document) -> str:
        _usable(register, written=written, what="motion")
        kind = register.layout.type
        if units is not None and register.unit not in units:
            unit = register.unit or "no unit"
            raise SchemaError("", f"is {register.name!r} in {unit!r}, expected a unit of {', '.join(units)}")
        if kind in (RegisterType.STRING, RegisterType.BIT):
            raise SchemaError("", f"is {register.name!r} of type {kind.value}, expected a number")
        if signed and kind.is_integer and kind.bounds[0] == 0:
            raise SchemaError("", f"is {register.name!r} of type {kind.value}, which has no sign")
        return register.name

    return Via(Named, check)


# -- conditions and writes -----------------------------------------------------------------------------------------
def _whole(written: bool) -> Callable[[Register, Document], Register]:
    def check(register: Register, _: Document) -> Register:
        if not register.layout.type.is_integer:
            what = f"is {register.name!r} of type {register.layout.type.value}, no whole number"
            raise SchemaError("", what)
        _usable(register, written=written, what="commands")
        return register

    return check


@dataclass(frozen=True, kw_only=True)
class _Masked:
    """A whole value, the bits of a mask, or one named bit."""

    register: Register
    bit: Text | None = None
    set: Annotated[int, one_of(0, 1)] | None = None
    mask: Annotated[int, Limits(ge=1, description="a mask")] | None = None

    def masked(self, key: str, value: int | None) -> tuple[str, int | None, int]:
        """(register, mask, value). Raises SchemaError."""
        register, mask = self.register, self.mask
        low, high = register.layout.type.bounds
        if self.bit is not None:
            if self.bit not in register.bits:
                names = ", ".join(register.bits) or "none"
                raise SchemaError("bit", f"is {self.bit!r}, expected a bit of {register.name} ({names})")
            if mask is not None or value is not None:
                raise SchemaError("bit", "stands beside a mask or value, expected one of them")
            bit = 1 << register.bits[self.bit]
            return register.name, bit, bit * (1 if self.set is None else self.set)
        if self.set is not None:
            raise SchemaError("set", "is for a named bit, and there is none")
        if value is None:
            raise SchemaError("", f"lacks {key}, expected a whole number {low} to {high}")
        if not low <= value <= high:
            raise SchemaError(key, f"is {value}, expected a whole number {low} to {high}")
        if mask is not None and (mask & ~high or low < 0):
            what = f"is {mask:#x}, which does not fit {register.name} ({register.layout.type.value})"
            raise SchemaError("mask", what)
        if mask is not None and value & ~mask:
            raise SchemaError(key, f"is {value:#x}, which has bits outside the mask {mask:#x}")
        return register.name, mask, value


Whole = Annotated[Named, _whole(False)]
"""A register of whole numbers that can be read."""


def _some(value: int | list[int], _: Document) -> tuple[int, ...]:
    values = tuple(value) if isinstance(value, list) else (value,)
    if not values:
        raise ValueError
    return values


SomeValues = Annotated[tuple[int, ...], Via(int | list[int], _some, "a whole number, or a list of them")]
"""One raw value or several, of which any will do."""


@dataclass(frozen=True, kw_only=True)
class ConditionRow(_Masked):
    """A condition as written in the file."""

    register: Whole
    value: SomeValues | None = None
    not_value: SomeValues | None = None

    def condition(self) -> Condition:
        """The condition. Raises SchemaError."""
        if self.not_value is not None and (self.value is not None or self.bit is not None):
            raise SchemaError("not_value", "stands beside a value or bit, expected one of them")
        key = "value" if self.not_value is None else "not_value"
        found = [self.masked(key, value) for value in self.not_value or self.value or (None,)]
        name, mask, _ = found[0]
        return Condition(name, mask, tuple(value for _, _, value in found), negate=self.not_value is not None)


@dataclass(frozen=True, kw_only=True)
class _WriteRow(_Masked):
    register: Annotated[Named, _whole(True)]
    value: int | None = None
    pause_s: Annotated[float, Limits(ge=0.0, le=10.0)] = 0.0

    def write(self) -> Write:
        name, mask, value = self.masked("value", self.value)
        if self.bit is None and mask is not None and not self.register.readable:
            raise SchemaError("mask", f"needs {name} to be readable, to keep its other bits")
        return Write(name, mask, value, self.pause_s)


@dataclass(frozen=True)
class _WriteTable:
    write: SomeWrites


Conditions = tuple[Annotated[Condition, Via(ConditionRow, lambda row, _: row.condition())], ...]
Writes = tuple[Annotated[Write, Via(_WriteRow, lambda row, _: row.write())], ...]
SomeConditions = Annotated[Conditions, not_empty]
SomeWrites = Annotated[Writes, not_empty]
WriteTable = Annotated[tuple[Write, ...], Via(_WriteTable, lambda table, _: table.write)]
"""A table with nothing but `write`."""
