"""Reads what every part of a register map's [drive] consists of: names of registers in a role, conditions and writes.

Refused with file, line and key: a name that does not exist, reading what is write-only, writing what is read-only, a unit that a role
cannot have, motion kept in EEPROM, a mask or value that does not fit.
"""

from __future__ import annotations

from drivers.modbus.codec import RegisterType
from drivers.modbus.drive_map import Condition, Write
from drivers.modbus.register_map import Memory, Register, RegisterMap
from drivers.strict_toml import Document, Section, text, whole


class RoleReader:
    """Reads sections of [drive] against the registers they speak of."""

    def __init__(self, document: Document, registers: RegisterMap) -> None:
        self.document = document
        self.registers = registers

    # -- roles -------------------------------------------------------------------------------------------------------
    def register(self, section: Section, key: str) -> Register:
        name = section.take(key, text, "the name of a register")
        if name not in self.registers.registers:
            raise section.fail(key, f"is {name!r}, expected the name of a register in [registers]")
        return self.registers.registers[name]

    def _checked(self, section: Section, key: str, register: Register, units: tuple[str, ...] | None) -> str:
        if units is not None and register.unit not in units:
            raise section.fail(
                key, f"is {register.name!r} in {register.unit or 'no unit'!r}, expected a unit of {', '.join(units)}"
            )
        if register.layout.type in (RegisterType.STRING, RegisterType.BIT):
            raise section.fail(key, f"is {register.name!r} of type {register.layout.type.value}, expected a number")
        return register.name

    def role(self, section: Section, key: str, units: tuple[str, ...] | None, *, written: bool = False) -> str:
        register = self.register(section, key)
        if written and not register.writable:
            raise section.fail(key, f"is {register.name!r}, which is read only")
        if not written and not register.readable:
            raise section.fail(key, f"is {register.name!r}, which is write only")
        if written and register.memory is Memory.EEPROM:
            raise section.fail(key, f"is {register.name!r}, which is kept in EEPROM; motion would wear it out")
        return self._checked(section, key, register, units)

    def optional_role(
        self, section: Section, key: str, units: tuple[str, ...] | None, *, written: bool = False
    ) -> str | None:
        return self.role(section, key, units, written=written) if key in section else None

    # -- conditions and writes -----------------------------------------------------------------------------------------
    def _masked(
        self, section: Section, *, value_key: str = "value", writing: bool = False
    ) -> tuple[Register, int | None, int]:
        register = self.register(section, "register")
        if writing and not register.writable:
            raise section.fail("register", f"is {register.name!r}, which is read only")
        if not writing and not register.readable:
            raise section.fail("register", f"is {register.name!r}, which is write only")
        if not register.layout.type.is_integer:
            raise section.fail(
                "register", f"is {register.name!r} of type {register.layout.type.value}, no whole number"
            )
        if writing and register.memory is Memory.EEPROM:
            raise section.fail("register", f"is {register.name!r}, which is kept in EEPROM; commands would wear it out")
        low, high = register.layout.type.bounds
        if "bit" in section:
            bit = section.take("bit", text, "the name of a bit")
            if bit not in register.bits:
                names = ", ".join(register.bits) or "none"
                raise section.fail("bit", f"is {bit!r}, expected a bit of {register.name} ({names})")
            mask = 1 << register.bits[bit]
            value = mask * section.take("set", whole(0, 1), "0 or 1", 1)
            return register, mask, value
        masked = section.take("mask", whole(1, (1 << 64) - 1), "a mask", None)
        value = section.take(value_key, whole(low, high), f"a whole number {low} to {high}")
        if masked is not None and (masked & ~high or low < 0):
            raise section.fail(
                "mask", f"is {masked:#x}, which does not fit {register.name} ({register.layout.type.value})"
            )
        if masked is not None and value & ~masked:
            raise section.fail(value_key, f"is {value:#x}, which has bits outside the mask {masked:#x}")
        if masked is not None and writing and not register.readable:
            raise section.fail("mask", f"needs {register.name} to be readable, to keep its other bits")
        return register, masked, value

    def _condition(self, section: Section) -> Condition:
        negate = "not_value" in section
        register, mask, value = self._masked(section, value_key="not_value" if negate else "value")
        section.finish()
        return Condition(register.name, mask, value, negate)

    def conditions(self, section: Section, key: str, *, required: bool = False) -> tuple[Condition, ...]:
        return tuple(self._condition(each) for each in section.children(key, required=required))

    def _write(self, section: Section) -> Write:
        register, mask, value = self._masked(section, writing=True)
        section.finish()
        return Write(register.name, mask, value)

    def writes(self, section: Section, key: str, *, required: bool = False) -> tuple[Write, ...]:
        return tuple(self._write(each) for each in section.children(key, required=required))

    def writes_of(self, section: Section, key: str) -> tuple[Write, ...]:
        child = section.child(key)
        writes = self.writes(child, "write", required=True)
        child.finish()
        return writes
