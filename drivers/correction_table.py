"""CorrectionTable: the table by which a drive corrects its axis itself, whatever wire it is on.

Describes such a table (units, nodes, interpolation, directions, sign) and its contents, and reads, writes and switches it. All values
are raw and in the drive's frame: positions count as motor counts do, and the curve `plus` is for rising counts. Values at the load are
converted by `hil.drive_table`.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from typing import Annotated, Any

from drivers.errors import InputError, ProtocolError
from drivers.scaling import AxisScaling
from drivers.toml_types import Limits, SchemaError, Text, one_of

UNITS = ("counts", "rev", "um", "mm")
"""Allowed units of positions and values: encoder counts, motor revolutions, or travel of the load."""

COLUMNS = ("plus", "minus", "position")

_UM_PER_MM = 1000.0


class Nodes(Enum):
    """How the positions of the nodes are given."""

    EQUIDISTANT = "equidistant"  # by an origin and a step
    EXPLICIT = "explicit"  # by a position for each node


class Interpolation(Enum):
    """The value between two nodes."""

    LINEAR = "linear"
    STEP = "step"  # the value of the lower node, in the drive's frame


class Outside(Enum):
    """The value beyond the first and the last node."""

    HOLD = "hold"  # the value at the end
    ZERO = "zero"


class Directions(Enum):
    """Contents of the table for the two directions of motion."""

    BOTH = "both"  # a curve for each
    BACKLASH = "backlash"  # the curve for rising counts, and an amount to subtract for falling ones
    ONE = "one"  # one curve, whatever the direction


@dataclass(frozen=True)
class RawFormat:
    """The number format of positions or values: raw · scale is the value in `unit`; raw lies within low…high."""

    unit: str
    scale: float
    low: int
    high: int

    def um(self, scaling: AxisScaling) -> float:
        """Load travel of one raw step, µm, in the drive's frame. Raises InputError for a unit not in `UNITS`."""
        per_unit = {
            "counts": _UM_PER_MM / scaling.counts_per_load_mm,
            "rev": _UM_PER_MM / scaling.counts_per_load_mm * scaling.encoder_counts_per_motor_rev,
            "um": 1.0,
            "mm": _UM_PER_MM,
        }
        if self.unit not in per_unit:
            raise InputError(f"a correction table in {self.unit or 'no unit'}, expected {', '.join(UNITS)}")
        return self.scale * per_unit[self.unit]


@dataclass(frozen=True)
class TableDescription:
    """The properties of a drive's table.

    points: the largest number it holds. sign: 1 where a positive value is added to the commanded position, -1 where it is subtracted.
    step: of equidistant nodes; backlash: the amount of Directions.BACKLASH. wears: each change is written to a memory with a limited
    number of write cycles. shows_applied: the drive reports the value that it adds at present.
    """

    name: str
    points: int
    nodes: Nodes
    interpolation: Interpolation
    outside: Outside
    directions: Directions
    sign: int
    position: RawFormat
    value: RawFormat
    step: RawFormat | None = None
    backlash: RawFormat | None = None
    wears: bool = False
    shows_applied: bool = False

    def check(self, table: RawTable) -> None:
        """Raise InputError for contents that such a table cannot hold; an empty table is always accepted."""
        count = len(table.plus)
        if count > self.points:
            raise InputError(f"{self.name} holds {self.points} points, {count} were to be written")
        wanted = {
            "position": count if self.nodes is Nodes.EXPLICIT else 0,
            "minus": count if self.directions is Directions.BOTH else 0,
        }
        for column, length in wanted.items():
            found = len(getattr(table, column))
            if found != length:
                raise InputError(f"{self.name}: column {column} has {found} values, expected {length}")
        if any(second <= first for first, second in itertools.pairwise(table.position)):
            raise InputError(f"{self.name}: positions do not ascend")
        if self.nodes is Nodes.EQUIDISTANT and count > 1 and table.step <= 0:
            raise InputError(f"{self.name}: the step is {table.step}, expected more than 0")
        held: list[tuple[str, RawFormat | None, tuple[int, ...]]] = [
            ("position", self.position, table.position if self.nodes is Nodes.EXPLICIT else (table.origin,)),
            ("plus", self.value, table.plus),
            ("minus", self.value, table.minus),
            ("step", self.step, (table.step,)),
            ("backlash", self.backlash, (table.backlash,)),
        ]
        for column, quantity, values in held:
            for raw in values:
                if quantity is not None and not quantity.low <= raw <= quantity.high:
                    raise InputError(f"{self.name}: {column} {raw}, allowed is {quantity.low} to {quantity.high} (raw)")


_SIGNS = "1 (a positive value is added) or -1 (it is subtracted)"


@dataclass(frozen=True, kw_only=True)
class TableHead:
    """The keys of a table that the maps of all wires share."""

    name: Text
    points: int
    nodes: Nodes
    interpolation: Interpolation
    outside: Outside
    directions: Directions
    sign: Annotated[int, one_of(1, -1), Limits(description=_SIGNS)]

    def needs(self) -> dict[str, bool]:
        """Columns, then single numbers: whether such a table has it."""
        return {
            "plus": True,
            "minus": self.directions is Directions.BOTH,
            "position": self.nodes is Nodes.EXPLICIT,
            "count": True,
            "origin": self.nodes is Nodes.EQUIDISTANT,
            "step": self.nodes is Nodes.EQUIDISTANT,
            "backlash": self.directions is Directions.BACKLASH,
        }

    def named(self, holder: Any, expected: str, without: Collection[str] = ()) -> dict[str, Any]:
        """The parts of the table by key. Raises SchemaError for a key that is missing, or that such a table cannot have."""
        found = {key: getattr(holder, key) for key in (*self.needs(), "applied")}
        for key, needed in self.needs().items():
            used = needed and key not in without
            if used and found[key] is None:
                raise SchemaError("", f"lacks {key}, expected {expected}")
            if not used and found[key] is not None:
                raise SchemaError(key, f"has no use with nodes {self.nodes.value}, directions {self.directions.value}")
        return {key: each for key, each in found.items() if each is not None}

    def description_of(self, **more: Any) -> TableDescription:
        """The description, with the fields that a subclass knows."""
        common = {field.name: getattr(self, field.name) for field in fields(TableHead)}
        return TableDescription(**common, **more)


@dataclass(frozen=True)
class RawTable:
    """The contents, raw, one value per point in use. position: of explicit nodes; origin and step: of equidistant ones."""

    plus: tuple[int, ...] = ()
    minus: tuple[int, ...] = ()
    position: tuple[int, ...] = ()
    origin: int = 0
    step: int = 0
    backlash: int = 0

    @property
    def nodes(self) -> tuple[int, ...]:
        """Positions of the nodes, raw, ascending."""
        return self.position or tuple(self.origin + index * self.step for index in range(len(self.plus)))


class CorrectionTable(ABC):
    """The table of one open drive. Its methods raise what reading or writing a parameter raises (`drivers.parameters`)."""

    drive: str
    description: TableDescription

    @abstractmethod
    def read(self) -> RawTable:
        """The contents that the drive holds now."""

    def changes_left(self) -> int | None:
        """How many changes the memory of the contents still allows; None where writing does not wear it."""
        return None

    def write(self, table: RawTable, present: RawTable | None = None) -> None:
        """Write what differs from `present`, everything without it. Does not read back: the caller does.

        Raises InputError, before anything is written, for what the table cannot hold.
        """
        self.description.check(table)
        self._write(table, present)

    @abstractmethod
    def _write(self, table: RawTable, present: RawTable | None) -> None: ...

    @abstractmethod
    def enabled(self) -> bool:
        """Whether the drive applies the table, read now. Raises ProtocolError for a switch value that is neither on nor off."""

    def switch(self, on: bool) -> None:
        """Switch the table on or off and read the switch back. Raises ProtocolError when it reads otherwise."""
        if self.enabled() is on:
            return
        self._switch(on)
        if self.enabled() is not on:
            raise ProtocolError(
                f"drive {self.drive}: {self.description.name} was switched {'on' if on else 'off'} and is not"
            )

    @abstractmethod
    def _switch(self, on: bool) -> None: ...

    def applied(self) -> int | None:
        """The value that the drive adds at present, raw in the table's value unit and sign; None where it does not report it."""
        return None


PLACES = ("origin", "step", "backlash")
"""Single numbers of the contents."""


class TableOnWire(CorrectionTable):
    """A table whose columns stand beside single numbers: of the contents, the number of points, the switch, the value applied.

    singles: those that the drive has, "enable" among them; on, off: values of the switch.
    """

    singles: Mapping[str, Any]
    on: int
    off: int

    @abstractmethod
    def _numbers(self, names: Sequence[str]) -> dict[str, int]:
        """Read single numbers."""

    @abstractmethod
    def _write_number(self, name: str, raw: int) -> None: ...

    @abstractmethod
    def _read_columns(self, count: int | None) -> dict[str, tuple[int, ...]]:
        """The columns of so many points; None where the columns say themselves how many there are."""

    @abstractmethod
    def _write_columns(self, table: RawTable, present: RawTable | None) -> None: ...

    def read(self) -> RawTable:
        """The contents, raw. Raises ProtocolError for an impossible number of points."""
        found = self._numbers([name for name in (*PLACES, "count") if name in self.singles])
        count = found.pop("count", None)
        if count is not None and not 0 <= count <= self.description.points:
            raise ProtocolError(
                f"drive {self.drive}: {self.description.name} says it holds {count} points, its map {self.description.points}"
            )
        return RawTable(**self._read_columns(count), **found)  # type: ignore[arg-type]

    def _write(self, table: RawTable, present: RawTable | None) -> None:
        for name in PLACES:
            if name in self.singles and (present is None or getattr(present, name) != getattr(table, name)):
                self._write_number(name, getattr(table, name))
        self._write_columns(table, present)
        if "count" in self.singles and (present is None or len(present.plus) != len(table.plus)):
            self._write_number("count", len(table.plus))

    def enabled(self) -> bool:
        found = self._numbers(["enable"])["enable"]
        if found not in (self.on, self.off):
            raise ProtocolError(
                f"drive {self.drive}: the switch of {self.description.name} ({self.singles['enable'].name}) is {found},"
                f" expected {self.on} (on) or {self.off} (off)"
            )
        return found == self.on

    def _switch(self, on: bool) -> None:
        self._write_number("enable", self.on if on else self.off)

    def applied(self) -> int | None:
        return self._numbers(["applied"])["applied"] if "applied" in self.singles else None
