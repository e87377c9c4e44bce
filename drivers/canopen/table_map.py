"""The map of a CANopen drive's own correction table: a TOML file with its properties and its objects.

    [table]              name, points, nodes, interpolation, outside, directions, sign, memory
    [table.position]     unit, scale: value of one raw step; [table.value] likewise, for the values
    [objects]            enable, and where the drive has them: count, origin, step, backlash, applied
                         form "array": plus, minus and position, each {object = first sub-index, type}
                         form "domain": domain = object, record = columns of one point in their order with their types
    [objects.enable]     object, type, on, off

`drivers/canopen/tables` holds two complete examples, which the simulated drive uses. Numbers are little-endian, as in CiA-301.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drivers.cia402.objects import DataType, Entry
from drivers.correction_table import COLUMNS, UNITS, RawFormat, TableDescription, TableHead
from drivers.errors import InputError
from drivers.files import named_file, shipped
from drivers.toml_schema import Document, either
from drivers.toml_types import Limits, Positive, SchemaError, Text, Via, one_of

SUBINDICES = 254
_OBJECT = re.compile(r"(?P<index>[0-9A-Fa-f]{4})h(:(?P<subindex>[0-9A-Fa-f]{2}))?")
_TYPES = {kind.name.lower(): kind for kind in DataType if kind.format and kind.name[0] in "IU"}
_MOST_POINTS = 1 << 16


@dataclass(frozen=True)
class TableMap:
    """The objects of a table. columns: the first sub-index of each array; record: (column, type) of a domain's point, in order.

    scalars: count, origin, step, backlash and applied, where the drive has them.
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
    return shipped("drivers.canopen", "tables")


def load_table_map(name_or_path: str | Path) -> TableMap:
    """A map from a file, or a shipped map by name. Raises InputError naming file, line and key."""
    path = named_file(name_or_path, shipped_tables(), "table map")
    document = Document.read(path)
    table, objects = document.load(_Table, "table"), document.load(_Objects, "objects")
    document.finish()
    with document.blaming("objects"):
        places = _places(table, objects)
    for column, first in places.columns.items():
        if (last := first.subindex + table.points - 1) > SUBINDICES:
            raise document.fail(f"objects.{column}", f"ends at sub-index {last}, expected {SUBINDICES} at most")
    scalars, types = places.scalars, places.types
    with document.blaming("table", "position"):
        position = table.position.quantity(types["position"] if "position" in types else scalars["origin"].type)
    with document.blaming("table", "value"):
        value = table.value.quantity(types["plus"])
    description = table.description_of(
        position=position,
        value=value,
        step=_as(position, scalars.get("step")),
        backlash=_as(value, scalars.get("backlash")),
        wears=table.memory == "eeprom",
        shows_applied="applied" in scalars,
    )
    switch, record = objects.enable, objects.record
    entry = switch.entry("enable")
    return TableMap(path, description, places.columns, places.domain, record, scalars, entry, switch.on, switch.off)


# -- the file ----------------------------------------------------------------------------------------------------------
def _object(written: str, _: Document) -> tuple[int, int]:
    match = _OBJECT.fullmatch(written)
    if match is None:
        raise ValueError
    index = int(match["index"], 16)
    if not 0x2000 <= index < 0x6000:
        raise InputError("expected an object of the maker's, 2000h to 5FFFh")
    return index, int(match["subindex"] or "0", 16)


def _type(name: str, _: Document) -> DataType:
    if name not in _TYPES:
        raise ValueError
    return _TYPES[name]


def _record(written: tuple[str, ...], document: Document) -> tuple[tuple[str, DataType], ...]:
    columns = (item.partition(":") for item in written)
    return tuple((name, _type(kind, document)) for name, _, kind in columns)


Number = Annotated[tuple[int, int], Via(Text, _object, "an object such as 2310h:01")]
Type = Annotated[DataType, Via(Text, _type, either(_TYPES))]
Switched = Annotated[int, Limits(ge=0, le=2**32)]


@dataclass(frozen=True)
class _Object:
    object: Number
    type: Type

    def entry(self, name: str) -> Entry:
        return Entry(*self.object, self.type, name)


@dataclass(frozen=True)
class _Switch(_Object):
    on: Switched = 1
    off: Switched = 0

    def __post_init__(self) -> None:
        if self.on == self.off:
            raise SchemaError("on", f"is {self.on}, as off is, expected two different values")


@dataclass(frozen=True)
class _Objects:
    """[objects]"""

    enable: _Switch
    plus: _Object | None = None
    minus: _Object | None = None
    position: _Object | None = None
    count: _Object | None = None
    origin: _Object | None = None
    step: _Object | None = None
    backlash: _Object | None = None
    applied: _Object | None = None
    domain: Number | None = None
    record: Annotated[
        tuple[tuple[str, DataType], ...], Via(tuple[Text, ...], _record, 'a list such as ["position:i32", "plus:i16"]')
    ] = ()


@dataclass(frozen=True)
class _Quantity:
    """[table.position] and [table.value]"""

    unit: Annotated[str, one_of(*UNITS)]
    scale: Positive = 1.0
    low: int | None = None
    high: int | None = None

    def quantity(self, kind: DataType) -> RawFormat:
        """The quantity, in the range of a type or within the limits given. Raises SchemaError."""
        low, high = kind.range
        for key, value in (("low", self.low), ("high", self.high)):
            if value is not None and not low <= value <= high:
                raise SchemaError(key, f"is {value}, expected a whole number {low} to {high}")
        return RawFormat(
            self.unit, self.scale, low if self.low is None else self.low, high if self.high is None else self.high
        )


@dataclass(frozen=True, kw_only=True)
class _Table(TableHead):
    """[table]"""

    points: Annotated[int, Limits(ge=1, le=_MOST_POINTS)]
    form: Annotated[str, one_of("array", "domain")]
    position: _Quantity
    value: _Quantity
    memory: Annotated[str, one_of("ram", "eeprom")] = "ram"
    description: str = ""


@dataclass(frozen=True)
class _Places:
    """The objects of the parts of a table, and the types of its columns."""

    columns: dict[str, Entry]
    domain: Entry | None
    scalars: dict[str, Entry]
    types: dict[str, DataType]


def _places(table: _Table, objects: _Objects) -> _Places:
    """Check [table] and [objects] against each other. Raises SchemaError."""
    in_domain = table.form == "domain"
    named = table.named(objects, "a table", without=(*COLUMNS, "count") if in_domain else ())
    scalars = {key: each.entry(key) for key, each in named.items()}
    columns = {key: scalars.pop(key) for key in COLUMNS if key in scalars}
    types = {key: entry.type for key, entry in columns.items()}
    domain: Entry | None = None
    if in_domain:
        if objects.domain is None:
            raise SchemaError("", "lacks domain, expected an object such as 2320h")
        domain = Entry(*objects.domain, DataType.DOMAIN, "table")
        types = dict(objects.record)
        wanted = [key for key, needed in table.needs().items() if needed and key in COLUMNS]
        if sorted(types) != sorted(wanted) or len(objects.record) != len(wanted):
            what = f"has {', '.join(types)}, expected each of {', '.join(wanted)} once"
            raise SchemaError("record", what)
    elif objects.domain is not None or objects.record:
        raise SchemaError("domain" if objects.domain else "record", "has no use in a table of form array")
    if types["plus"] is not types.get("minus", types["plus"]):
        raise SchemaError("minus", "is of another type than plus, expected the same")
    return _Places(columns, domain, scalars, types)


def _as(quantity: RawFormat, entry: Entry | None) -> RawFormat | None:
    """The same unit, in the range of another object."""
    return None if entry is None else RawFormat(quantity.unit, quantity.scale, *entry.type.range)
