"""The map of a CANopen drive's own correction table: a TOML file that says what it is like and in which objects it stands.

    [table]              name, points, nodes, interpolation, outside, directions, sign, memory
    [table.position]     unit, scale: what one of it stands for; [table.value] likewise, for the values
    [objects]            enable, and where the drive has them: count, origin, step, backlash, applied
                         form "array": plus, minus and position, each {object = first sub-index, type}
                         form "domain": domain = object, record = columns of one point in their order with their types
    [objects.enable]     object, type, on, off

`drivers/canopen/tables` holds two complete examples, which the simulated drive obeys. Numbers are little-endian, as CiA-301 has them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from drivers.canopen.objects import DataType, Entry
from drivers.correction_table import (
    UNITS,
    Directions,
    Interpolation,
    Nodes,
    Outside,
    Quantity,
    TableDescription,
)
from drivers.errors import InputError
from drivers.strict_toml import Document, Section, positive, sign, take_enum, text, whole

SUBINDICES = 254
_OBJECT = re.compile(r"(?P<index>[0-9A-Fa-f]{4})h(:(?P<subindex>[0-9A-Fa-f]{2}))?")
_TYPES = {kind.name.lower(): kind for kind in DataType if kind.is_number and kind.name[0] in "IU"}
_MOST_POINTS = 1 << 16


@dataclass(frozen=True)
class TableMap:
    """Where a table stands. columns: the first sub-index of each array; record: (column, type) of a domain's point, in order.

    scalars: count, origin, step, backlash and applied, as far as the drive has them.
    """

    path: Path
    description: TableDescription
    columns: Mapping[str, Entry]
    domain: Entry | None
    record: tuple[tuple[str, DataType], ...]
    scalars: Mapping[str, Entry]
    enable: Entry
    on: int
    off: int

    def holds(self, index: int, subindex: int) -> bool:
        """Whether an object belongs to the table, its switch included."""
        single = [self.enable, *self.scalars.values(), *([self.domain] if self.domain else [])]
        if any((index, subindex) == (entry.index, entry.subindex) for entry in single):
            return True
        return any(
            index == first.index and 0 <= subindex - first.subindex < self.description.points
            for first in self.columns.values()
        )


def shipped_tables() -> dict[str, Path]:
    """The table maps that come with the package, by name."""
    folder = resources.files("drivers.canopen") / "tables"
    return {Path(str(item)).stem: Path(str(item)) for item in folder.iterdir() if item.name.endswith(".toml")}


def load_table_map(name_or_path: str | Path) -> TableMap:
    """A file, or a shipped map by name. Raises InputError naming file, line and key."""
    path = Path(name_or_path)
    shipped = shipped_tables()
    if not path.is_file():
        if str(name_or_path) not in shipped:
            raise InputError(f"is neither a file nor a shipped table map ({', '.join(sorted(shipped))})", path=path)
        path = shipped[str(name_or_path)]
    document = Document.read(path)
    root = document.root()
    found = _Reader(document, root.child("table"), root.child("objects")).read()
    root.finish()
    return found


class _Reader:
    """Reads [table] and [objects] against each other."""

    def __init__(self, document: Document, table: Section, objects: Section) -> None:
        self._document = document
        self._table = table
        self._objects = objects

    def read(self) -> TableMap:
        table, objects = self._table, self._objects
        form = table.take("form", _one_of("array", "domain"), "array or domain")
        nodes = take_enum(table, "nodes", Nodes)
        directions = take_enum(table, "directions", Directions)
        wanted = ["plus"]
        wanted += ["minus"] if directions is Directions.BOTH else []
        wanted += ["position"] if nodes is Nodes.EXPLICIT else []
        columns: dict[str, Entry] = {}
        record: tuple[tuple[str, DataType], ...] = ()
        domain: Entry | None = None
        if form == "array":
            columns = {column: self._entry(objects.child(column), column) for column in wanted}
            types = {column: entry.type for column, entry in columns.items()}
        else:
            domain = Entry(*objects.take("domain", _object, "an object such as 2320h"), DataType.DOMAIN, "table")
            record = objects.take("record", _record, 'a list such as ["position:i32", "plus:i16"]')
            types = dict(record)
            if sorted(types) != sorted(wanted) or len(record) != len(wanted):
                raise objects.fail("record", f"has {', '.join(types)}, expected each of {', '.join(wanted)} once")
        scalars = self._scalars(form, nodes, directions)
        switch = objects.child("enable")
        on = switch.take("on", whole(0, 2**32), "a whole number", 1)
        off = switch.take("off", whole(0, 2**32), "a whole number", 0)
        if on == off:
            raise switch.fail("on", f"is {on}, as off is, expected two different values")
        enable = self._entry(switch, "enable")
        objects.finish()
        if types["plus"] is not types.get("minus", types["plus"]):
            raise self._document.fail("objects.minus", "is of another type than plus, expected the same")
        points = table.take("points", whole(1, _MOST_POINTS), f"a whole number, 1 to {_MOST_POINTS}")
        for column, first in columns.items():
            if first.subindex + points - 1 > SUBINDICES:
                raise self._document.fail(
                    f"objects.{column}",
                    f"ends at sub-index {first.subindex + points - 1}, expected {SUBINDICES} at most",
                )
        position = scalars["origin"].type if nodes is Nodes.EQUIDISTANT else types["position"]
        description = self._description(
            points, nodes, directions, {"position": position, "value": types["plus"]}, scalars
        )
        return TableMap(self._document.path, description, columns, domain, record, scalars, enable, on, off)

    def _description(
        self,
        points: int,
        nodes: Nodes,
        directions: Directions,
        types: Mapping[str, DataType],
        scalars: Mapping[str, Entry],
    ) -> TableDescription:
        table = self._table
        places = self._quantity("position", types["position"])
        values = self._quantity("value", types["value"])
        description = TableDescription(
            name=table.take("name", text, "a name"),
            points=points,
            nodes=nodes,
            interpolation=take_enum(table, "interpolation", Interpolation),
            outside=take_enum(table, "outside", Outside),
            directions=directions,
            sign=table.take("sign", sign, "1 (a positive value is added) or -1 (it is subtracted)"),
            position=places,
            value=values,
            step=_as(places, scalars.get("step")),
            backlash=_as(values, scalars.get("backlash")),
            wears=table.take("memory", _one_of("ram", "eeprom"), "ram or eeprom", "ram") == "eeprom",
            shows_applied="applied" in scalars,
        )
        table.take("description", text, "a sentence", "")
        table.finish()
        return description

    def _scalars(self, form: str, nodes: Nodes, directions: Directions) -> dict[str, Entry]:
        required = [
            *(["count"] if form == "array" else []),
            *(["origin", "step"] if nodes is Nodes.EQUIDISTANT else []),
            *(["backlash"] if directions is Directions.BACKLASH else []),
        ]
        optional = ["applied"] if "applied" in self._objects else []
        return {name: self._entry(self._objects.child(name), name) for name in required + optional}

    def _entry(self, section: Section, name: str) -> Entry:
        index, subindex = section.take("object", _object, "an object such as 2310h:01")
        kind = section.take("type", _type, " or ".join(_TYPES))
        section.finish()
        return Entry(index, subindex, kind, name)

    def _quantity(self, name: str, kind: DataType) -> Quantity:
        section = self._table.child(name)
        low, high = bounds(kind)
        quantity = Quantity(
            section.take("unit", _one_of(*UNITS), " or ".join(UNITS)),
            section.take("scale", positive, "a number > 0", 1.0),
            section.take("low", whole(low, high), f"a whole number {low} to {high}", low),
            section.take("high", whole(low, high), f"a whole number {low} to {high}", high),
        )
        section.finish()
        return quantity


def bounds(kind: DataType) -> tuple[int, int]:
    """Least and greatest value of a whole-number type."""
    bits = 8 * kind.size
    return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if kind.is_signed else (0, (1 << bits) - 1)


def _as(quantity: Quantity, entry: Entry | None) -> Quantity | None:
    """The same unit, in the range of another object."""
    return None if entry is None else Quantity(quantity.unit, quantity.scale, *bounds(entry.type))


def _one_of(*choices: str) -> Any:
    def convert(value: Any) -> str:
        if value not in choices:
            raise ValueError
        return str(value)

    return convert


def _object(value: Any) -> tuple[int, int]:
    match = _OBJECT.fullmatch(text(value))
    if match is None:
        raise ValueError
    index = int(match["index"], 16)
    if not 0x2000 <= index < 0x6000:
        raise InputError("expected an object of the maker's, 2000h to 5FFFh")
    return index, int(match["subindex"] or "0", 16)


def _type(value: Any) -> DataType:
    if text(value) not in _TYPES:
        raise ValueError
    return _TYPES[value]


def _record(value: Any) -> tuple[tuple[str, DataType], ...]:
    columns = []
    for item in value:
        name, _, kind = text(item).partition(":")
        columns.append((name, _type(kind)))
    return tuple(columns)
