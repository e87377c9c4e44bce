"""A CANopen drive's own correction table: arrays of objects read and written one by one, or a domain in one block transfer."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.canopen.abort_codes import ABORT_COMMAND
from drivers.canopen.node import Node
from drivers.canopen.table_map import TableMap
from drivers.cia402.objects import Entry
from drivers.correction_table import RawTable, TableOnWire
from drivers.errors import AbortError, ProtocolError

_COMMIT_S = 2.0
"""Time a drive may take to accept a table that was transferred, s."""


class CanOpenCorrectionTable(TableOnWire):
    """The correction table of one open drive, as its map describes it."""

    def __init__(self, node: Node, table_map: TableMap) -> None:
        self.drive = node.name
        self.description = table_map.description
        self.map = table_map
        self.singles = {**table_map.scalars, "enable": table_map.enable}
        self.on, self.off = table_map.on, table_map.off
        self._node = node
        self._record = struct.Struct("<" + "".join(kind.format[1:] for _, kind in table_map.record))

    # -- contents ------------------------------------------------------------------------------------------------------
    def _numbers(self, names: Sequence[str]) -> dict[str, int]:
        return {name: self._node.sdo.read(self.singles[name]) for name in names}

    def _write_number(self, name: str, raw: int) -> None:
        self._node.sdo.write(self.singles[name], raw)

    def _read_columns(self, count: int | None) -> dict[str, tuple[int, ...]]:
        if self.map.domain is not None:
            return self._unpack(self._read_domain(self.map.domain))
        return {
            column: tuple(self._node.sdo.read(_element(first, index)) for index in range(count or 0))
            for column, first in self.map.columns.items()
        }

    def _unpack(self, data: bytes) -> dict[str, tuple[int, ...]]:
        if len(data) % self._record.size:
            raise ProtocolError(
                f"drive {self.drive}: {self.description.name} is {len(data)} bytes, expected a multiple of {self._record.size}"
            )
        rows = list(self._record.iter_unpack(data))
        return {column: tuple(int(row[place]) for row in rows) for place, (column, _) in enumerate(self.map.record)}

    def _write_columns(self, table: RawTable, present: RawTable | None) -> None:
        if self.map.domain is not None:
            data = self.pack(table)
            if present is None or self.pack(present) != data:
                self._write_domain(self.map.domain, data)
        for column, first in self.map.columns.items():
            before = () if present is None else getattr(present, column)
            for index, value in enumerate(getattr(table, column)):
                if index >= len(before) or before[index] != value:
                    self._node.sdo.write(_element(first, index), value)

    def pack(self, table: RawTable) -> bytes:
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


def _element(first: Entry, index: int) -> Entry:
    return Entry(first.index, first.subindex + index, first.type, f"{first.name}[{index}]")
