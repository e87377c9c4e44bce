"""A CANopen drive's own correction table: arrays of objects read and written one by one, or a domain in one block transfer."""

from __future__ import annotations

import struct

from drivers.canopen.abort_codes import ABORT_COMMAND
from drivers.canopen.node import Node
from drivers.canopen.table_map import TableMap
from drivers.cia402.objects import Entry
from drivers.correction_table import CorrectionTable, RawTable
from drivers.errors import AbortError, ProtocolError

_COMMIT_S = 2.0
"""Time a drive may take to accept a table that was transferred, s."""


class CanOpenCorrectionTable(CorrectionTable):
    """The correction table of one open drive, as its map describes it."""

    def __init__(self, node: Node, table_map: TableMap) -> None:
        self.drive = node.name
        self.description = table_map.description
        self.map = table_map
        self._node = node
        self._record = struct.Struct("<" + "".join(kind.format[1:] for _, kind in table_map.record))

    # -- contents ------------------------------------------------------------------------------------------------------
    def read(self) -> RawTable:
        columns = self._read_arrays() if self.map.domain is None else self._unpack(self._read_domain(self.map.domain))
        return RawTable(**columns, **{name: self._number(name) for name in self._places()})  # type: ignore[arg-type]

    def _places(self) -> list[str]:
        return [name for name in ("origin", "step", "backlash") if name in self.map.scalars]

    def _number(self, name: str) -> int:
        return self._node.sdo.read(self.map.scalars[name])

    def _read_arrays(self) -> dict[str, tuple[int, ...]]:
        sdo, count = self._node.sdo, self._number("count")
        if count > self.description.points:
            raise ProtocolError(
                f"drive {self.drive}: {self.description.name} says it holds {count} points, its map {self.description.points}"
            )
        return {
            column: tuple(sdo.read(_element(first, index)) for index in range(count))
            for column, first in self.map.columns.items()
        }

    def _unpack(self, data: bytes) -> dict[str, tuple[int, ...]]:
        if len(data) % self._record.size:
            raise ProtocolError(
                f"drive {self.drive}: {self.description.name} is {len(data)} bytes, expected a multiple of {self._record.size}"
            )
        rows = list(self._record.iter_unpack(data))
        return {column: tuple(int(row[place]) for row in rows) for place, (column, _) in enumerate(self.map.record)}

    def _write(self, table: RawTable, present: RawTable | None) -> None:
        sdo = self._node.sdo
        for name in self._places():
            if present is None or getattr(present, name) != getattr(table, name):
                sdo.write(self.map.scalars[name], getattr(table, name))
        if self.map.domain is not None:
            data = self.pack(table)
            if present is None or self.pack(present) != data:
                self._write_domain(self.map.domain, data)
            return
        for column, first in self.map.columns.items():
            before = () if present is None else getattr(present, column)
            for index, value in enumerate(getattr(table, column)):
                if index >= len(before) or before[index] != value:
                    sdo.write(_element(first, index), value)
        if present is None or len(present.plus) != len(table.plus):
            sdo.write(self.map.scalars["count"], len(table.plus))

    def pack(self, table: RawTable) -> bytes:
        """The bytes of a domain for this table."""
        rows = zip(*(getattr(table, column) for column, _ in self.map.record), strict=True)
        return b"".join(self._record.pack(*row) for row in rows)

    # -- the domain ----------------------------------------------------------------------------------------------------
    def _read_domain(self, domain: Entry) -> bytes:
        """Read the domain by block transfer; segmented from a drive without it."""
        try:
            return self._node.sdo.read_bytes(domain.index, domain.subindex, block=True)
        except AbortError as error:
            if error.code != ABORT_COMMAND:
                raise
            return self._node.sdo.read_bytes(domain.index, domain.subindex)

    def _write_domain(self, domain: Entry, data: bytes) -> None:
        place = domain.index, domain.subindex
        try:
            self._node.sdo.write_bytes(*place, data, block=True, timeout_s=max(_COMMIT_S, self._node.sdo.timeout_s))
        except AbortError as error:
            if error.code != ABORT_COMMAND:
                raise
            self._node.sdo.write_bytes(*place, data, timeout_s=max(_COMMIT_S, self._node.sdo.timeout_s))

    # -- the switch ------------------------------------------------------------------------------------------------------
    def enabled(self) -> bool:
        """Whether the switch object is on. Raises ProtocolError for a value that is neither on nor off."""
        found = self._node.sdo.read(self.map.enable)
        if found not in (self.map.on, self.map.off):
            raise ProtocolError(
                f"drive {self.drive}: the switch of {self.description.name} is {found},"
                f" expected {self.map.on} (on) or {self.map.off} (off)"
            )
        return found == self.map.on

    def _switch(self, on: bool) -> None:
        self._node.sdo.write(self.map.enable, self.map.on if on else self.map.off)

    def applied(self) -> int | None:
        return self._number("applied") if "applied" in self.map.scalars else None


def _element(first: Entry, index: int) -> Entry:
    return Entry(first.index, first.subindex + index, first.type, f"{first.name}[{index}]")
