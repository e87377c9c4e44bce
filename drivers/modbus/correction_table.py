"""A Modbus drive's own correction table: blocks of registers, read and written in as few requests as the model allows."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.correction_table import RawTable, TableOnWire
from drivers.modbus.codec import decode, encode
from drivers.modbus.link import Doubt
from drivers.modbus.plan import Span
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.modbus.register_map import Memory, Register
from drivers.modbus.table_map import TableBlocks
from drivers.modbus.wear import WearLedger


class ModbusCorrectionTable(TableOnWire):
    """The correction table of one open drive. wear: counts writes to EEPROM, one for each column and each change."""

    def __init__(self, drive: str, access: RegisterAccess, blocks: TableBlocks, wear: WearLedger) -> None:
        self.drive = drive
        self.description = blocks.description
        self._access = access
        self._blocks = blocks
        self.singles = {**blocks.scalars, "enable": blocks.enable}
        self.on, self.off = blocks.on, blocks.off
        self._wear = wear

    # -- reading -------------------------------------------------------------------------------------------------------
    def _numbers(self, names: Sequence[str]) -> dict[str, int]:
        raw = self._access.integers([self.singles[name].name for name in names])
        return {name: raw[self.singles[name].name] for name in names}

    def _read_columns(self, count: int | None) -> dict[str, tuple[int, ...]]:
        return {column: self._column(first, count or 0) for column, first in self._blocks.columns.items()}

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

    def _write_number(self, name: str, raw: int) -> None:
        register = self.singles[name]
        if name != "enable":
            self._charge(register)
        self._access.write({register.name: raw})

    def _write_columns(self, table: RawTable, present: RawTable | None) -> None:
        for column, first in self._blocks.columns.items():
            self._write_column(first, getattr(table, column), () if present is None else getattr(present, column))

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
