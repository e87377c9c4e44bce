"""A Modbus drive's own correction table: blocks of registers, read and written in as few requests as the model allows."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.correction_table import CorrectionTable, RawTable
from drivers.errors import ProtocolError
from drivers.modbus.codec import decode, encode
from drivers.modbus.link import Doubt
from drivers.modbus.plan import Span
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.modbus.register_map import Memory, Register
from drivers.modbus.table_map import TableBlocks
from drivers.modbus.wear import WearLedger

_PLACES = ("origin", "step", "backlash")


class ModbusCorrectionTable(CorrectionTable):
    """The correction table of one open drive. wear: counts writes to EEPROM, one for each column and each change."""

    def __init__(self, drive: str, access: RegisterAccess, blocks: TableBlocks, wear: WearLedger) -> None:
        self.drive = drive
        self.description = blocks.description
        self._access = access
        self._blocks = blocks
        self._wear = wear

    # -- reading -------------------------------------------------------------------------------------------------------
    def read(self) -> RawTable:
        """The contents, raw. Raises ProtocolError for an impossible number of points."""
        scalars = {name: each for name, each in self._blocks.scalars.items() if name != "applied"}
        raw = self._access.integers([register.name for register in scalars.values()])
        found = {name: raw[register.name] for name, register in scalars.items()}
        count = found.pop("count")
        if not 0 <= count <= self.description.points:
            raise ProtocolError(
                f"drive {self.drive}: {self.description.name} says it holds {count} points, its map {self.description.points}"
            )
        columns = {column: self._column(first, count) for column, first in self._blocks.columns.items()}
        return RawTable(**columns, **found)  # type: ignore[arg-type]

    def _column(self, first: Register, count: int) -> tuple[int, ...]:
        words: list[int] = []
        width, access = first.span.count, self._access
        at_once = access.registers.max_read // width
        for index in range(0, count, at_once):
            span = Span(first.span.start + index * width, min(at_once, count - index) * width)
            words += access.link.read(access.unit, first.table, span)
        return tuple(
            whole(decode(words[place : place + width], first.layout), first.name)
            for place in range(0, len(words), width)
        )

    # -- writing -------------------------------------------------------------------------------------------------------
    def changes_left(self) -> int | None:
        blocks = self._blocks
        kept = [each for each in (*blocks.columns.values(), *blocks.scalars.values()) if each.memory is Memory.EEPROM]
        left = [each.wear_budget - self._wear.writes(self.drive, each.name) for each in kept]
        return min(left, default=None)

    def _write(self, table: RawTable, present: RawTable | None) -> None:
        scalars = {name: getattr(table, name) for name in _PLACES if name in self._blocks.scalars}
        before = {} if present is None else {name: getattr(present, name) for name in scalars}
        for name, value in scalars.items():
            if before.get(name) != value:
                self._write_one(self._blocks.scalars[name], value)
        for column, first in self._blocks.columns.items():
            self._write_column(first, getattr(table, column), () if present is None else getattr(present, column))
        if present is None or len(present.plus) != len(table.plus):
            self._write_one(self._blocks.scalars["count"], len(table.plus))

    def _write_one(self, register: Register, raw: int) -> None:
        self._charge(register)
        self._access.write({register.name: raw})

    def _write_column(self, first: Register, values: Sequence[int], before: Sequence[int]) -> None:
        """Write what differs from `before`, neighbouring registers in one request."""
        width, access = first.span.count, self._access
        differs = [index >= len(before) or before[index] != value for index, value in enumerate(values)]
        if any(differs):
            self._charge(first)
        at_once, start = access.registers.max_write // width, 0
        while start < len(values):
            end = start
            while end < len(values) and differs[end] and end - start < at_once:
                end += 1
            if end > start:
                words = tuple(word for value in values[start:end] for word in encode(value, first.layout))
                access.link.write(
                    access.unit,
                    first.table,
                    first.span.start + start * width,
                    words,
                    doubt=Doubt.READ_BACK,
                    single=access.registers.single_writes,
                )
            start = max(end, start + 1)

    def _charge(self, register: Register) -> None:
        if register.memory is Memory.EEPROM:
            self._wear.charge(self.drive, register.name, register.wear_budget)

    # -- the switch ----------------------------------------------------------------------------------------------------
    def enabled(self) -> bool:
        """Whether the switch register is on. Raises ProtocolError for a value that is neither on nor off."""
        blocks = self._blocks
        found = self._access.integers([blocks.enable.name])[blocks.enable.name]
        if found not in (blocks.on, blocks.off):
            raise ProtocolError(
                f"drive {self.drive}: the switch of {self.description.name} ({blocks.enable.name}) is {found},"
                f" expected {blocks.on} (on) or {blocks.off} (off)"
            )
        return found == blocks.on

    def _switch(self, on: bool) -> None:
        blocks = self._blocks
        self._access.write({blocks.enable.name: blocks.on if on else blocks.off})

    def applied(self) -> int | None:
        register = self._blocks.scalars.get("applied")
        return None if register is None else self._access.integers([register.name])[register.name]
