"""A drive's parameters by their dictionary: checked before they are written, read back after.

Single parameters with what an EDS says of them; whole sets (all or nothing, audit) are built on `raw_parameters`. Objects that move
the axis are no parameters: targets, modes and the controlword are refused here, because some drives keep them through a store and a
restore (`not_parameters`).
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.canopen.eds import EdsEntry, EdsFile
from drivers.canopen.node import Node
from drivers.canopen.not_parameters import why_not_written
from drivers.canopen.sdo import most_bytes
from drivers.cia402.objects import DataType
from drivers.errors import CapabilityError, InputError, ProtocolError

Value = int | float | str | bytes | bool
SAVE = b"save"
ON_COMMAND = 0x01  # 1010h:1 and 1011h:1 when read


@dataclass(frozen=True)
class TimedValue:
    """A value read, and how long its answer took (the clock's time, s)."""

    value: Value
    seconds: float


class CanOpenParameters:
    """Parameter access of one open drive, by an EDS or DCF."""

    def __init__(self, node: Node, eds: EdsFile) -> None:
        self._node = node
        self.eds = eds
        self._found: dict[tuple[int, int], Value] = {}  # as first read: never out of range when it is put back

    # -- which --------------------------------------------------------------------------------------------------------
    def readable(self) -> tuple[EdsEntry, ...]:
        """Every entry that can be read, ascending; domains are left out."""
        return tuple(
            found
            for _, found in sorted(self.eds.entries.items())
            if found.readable and found.entry.type is not DataType.DOMAIN
        )

    def writable(self) -> tuple[EdsEntry, ...]:
        """The entries that the user may change: no targets, no commands, no PDO parameters."""
        return tuple(found for found in self.readable() if self.refusal(found) is None)

    def refusal(self, found: EdsEntry) -> str | None:
        """Why an entry is not written as a parameter; None for one that may be written."""
        return why_not_written(found, self._node.table)

    def find(self, index: int, subindex: int = 0) -> EdsEntry:
        """The entry of an object. Raises InputError for one that the file does not have."""
        found = self.eds.entries.get((index, subindex))
        if found is None:
            raise InputError(f"has no object {index:04X}h:{subindex:02X}", path=self.eds.path)
        return found

    # -- one --------------------------------------------------------------------------------------------------------
    def read(self, found: EdsEntry) -> TimedValue:
        """The present value. Raises AbortError, NoAnswerError, ProtocolError, LinkLostError."""
        entry, clock = found.entry, self._node.clock
        start_ns = clock.now_ns()
        value = entry.unpack(self._node.sdo.read_bytes(entry.index, entry.subindex, most=most_bytes(entry)))
        self._found.setdefault(entry.key, value)
        return TimedValue(value, (clock.now_ns() - start_ns) * 1e-9)

    def check(self, found: EdsEntry, value: Value) -> None:
        """Raise CapabilityError for an entry that may not be written, InputError for a value outside its type, or outside its limits
        unless the drive was found with it."""
        refusal = self.refusal(found)
        if refusal is not None:
            raise CapabilityError(f"drive {self._node.name}: {refusal}")
        entry = found.entry
        entry.pack(value)
        if isinstance(value, (int, float)) and value != self._found.get(entry.key):
            if found.low is not None and value < found.low:
                raise InputError(f"{entry}: {value!r} is below its limit {found.low:g}", path=self.eds.path)
            if found.high is not None and value > found.high:
                raise InputError(f"{entry}: {value!r} is above its limit {found.high:g}", path=self.eds.path)

    def write(self, found: EdsEntry, value: Value) -> None:
        """Check, write, read back. Raises as `check`, AbortError when the drive refuses, ProtocolError when it kept another value."""
        self.check(found, value)
        entry = found.entry
        data = entry.pack(value)
        self._node.sdo.write_bytes(entry.index, entry.subindex, data, same=entry.same)
        kept = self._node.sdo.read_bytes(entry.index, entry.subindex, most=most_bytes(entry))
        if not entry.same(kept, data):
            raise ProtocolError(
                f"drive {self._node.name}: {entry} was written {value!r}, it reads back {entry.unpack(kept)!r}"
            )
