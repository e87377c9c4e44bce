"""Reads [drive.correction_table] of a register map, and refuses what cannot be a table."""

from __future__ import annotations

from drivers.correction_table import UNITS, Directions, Interpolation, Nodes, Outside, TableDescription
from drivers.modbus.map_roles import RoleReader
from drivers.modbus.register_map import Memory, Register, RegisterMap
from drivers.modbus.table_map import TableBlocks, quantity_of
from drivers.strict_toml import Document, Section, sign, take_enum, text, whole


class TableReader:
    """Against the registers that it speaks of."""

    def __init__(self, document: Document, registers: RegisterMap) -> None:
        self._document = document
        self._registers = registers
        self._roles = RoleReader(document, registers)

    def read(self, section: Section) -> TableBlocks:
        nodes = take_enum(section, "nodes", Nodes)
        directions = take_enum(section, "directions", Directions)
        columns = ["plus"]
        columns += ["minus"] if directions is Directions.BOTH else []
        columns += ["position"] if nodes is Nodes.EXPLICIT else []
        scalars = ["count"]
        scalars += ["origin", "step"] if nodes is Nodes.EQUIDISTANT else []
        scalars += ["backlash"] if directions is Directions.BACKLASH else []
        points = section.take("points", whole(1, 32768), "a whole number, 1 to 32768")
        found = {column: self._numbers(section, column, in_length=True) for column in columns}
        single = {name: self._numbers(section, name, in_length=name != "count") for name in scalars}
        if "applied" in section:
            single["applied"] = self._roles.register(section, "applied")
        for column, first in found.items():
            self._refuse_neighbours(section, column, first, points)
        for one, other in (("plus", "minus"), ("origin", "step")):
            self._require_alike(section, one, other, {**found, **single})
        switch = section.child("enable")
        enable = self._roles.register(switch, "register")
        low, high = enable.layout.type.bounds
        on = switch.take("on", whole(low, high), f"a whole number {low} to {high}", 1)
        off = switch.take("off", whole(low, high), f"a whole number {low} to {high}", 0)
        if on == off or not enable.writable or not enable.readable:
            raise switch.fail("on", f"is {on}, off {off}, expected two values of a register that is read and written")
        switch.finish()
        description = TableDescription(
            name=section.take("name", text, "a name"),
            points=points,
            nodes=nodes,
            interpolation=take_enum(section, "interpolation", Interpolation),
            outside=take_enum(section, "outside", Outside),
            directions=directions,
            sign=section.take("sign", sign, "1 (a positive value is added) or -1 (it is subtracted)"),
            position=quantity_of(found["position"] if nodes is Nodes.EXPLICIT else single["origin"]),
            value=quantity_of(found["plus"]),
            step=quantity_of(single["step"]) if "step" in single else None,
            backlash=quantity_of(single["backlash"]) if "backlash" in single else None,
            wears=any(each.memory is Memory.EEPROM for each in (*found.values(), *single.values())),
            shows_applied="applied" in single,
        )
        section.finish()
        return TableBlocks(description, found, single, enable, on, off)

    def _numbers(self, section: Section, key: str, *, in_length: bool) -> Register:
        """A register of whole numbers to be read and written, in a unit of length where it stands for one."""
        register = self._roles.register(section, key)
        kind = register.layout.type
        if not kind.is_integer or not register.readable or not register.writable or register.offset:
            raise section.fail(key, f"is {register.name!r}, expected whole numbers that are read and written, offset 0")
        if in_length and (register.unit not in UNITS or register.scale <= 0):
            raise section.fail(
                key, f"is {register.name!r} in {register.unit or 'no unit'!r}, expected {', '.join(UNITS)}, scale > 0"
            )
        return register

    def _refuse_neighbours(self, section: Section, column: str, first: Register, points: int) -> None:
        start, end = first.span.start, first.span.start + points * first.span.count
        if end > 0x10000:
            raise section.fail(column, f"leaves the 65536 registers with {points} values from {first.name!r} on")
        for other in self._registers.registers.values():
            inside = other.span.start < end and start < other.span.end
            if other is not first and other.table is first.table and inside:
                raise section.fail(column, f"overlaps {other.name!r}: {points} values from {first.name!r} on reach it")

    def _require_alike(self, section: Section, one: str, other: str, found: dict[str, Register]) -> None:
        if one in found and other in found:
            first, second = found[one], found[other]
            if (first.unit, first.scale) != (second.unit, second.scale):
                raise section.fail(other, f"is in another unit or scale than {one} ({first.name!r}), expected the same")
