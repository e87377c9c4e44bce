"""What CiA 402 needs of a wire: objects that are read and written, and the values that a drive sends cyclically."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeVar

from drivers.cia402.objects import Entry

Absent = TypeVar("Absent", int, None)

OBJECT_MISSING = (0x06020000, 0x06090011)
"""Codes of an AbortError for an object, or a sub-index, that does not exist (CiA 301, table 22)."""
LEFT_OUT = (0x06010002, *OBJECT_MISSING)
"""Read-only, no such object, no such sub-index."""
OUT_OF_RANGE = (0x06090030, 0x06090031)
"""Value outside the object's range, value too high."""


class ObjectAccess(Protocol):
    """The objects of one drive, one at a time. name: such as "drive X", for errors.

    Every call returns once the drive has answered. A write whose answer is lost is resolved by reading back, never sent twice.
    """

    @property
    def name(self) -> str: ...

    def read(self, entry: Entry) -> int:
        """A whole number. Raises AbortError (a refusal, with the codes of CiA 301), NoAnswerError, ProtocolError, LinkLostError."""

    def read_if_shown(self, entry: Entry, absent: Absent) -> int | Absent:
        """A whole number; `absent` where the drive refuses it. Raises as `read`, but not AbortError."""

    def write(self, entry: Entry, value: int) -> None:
        """Returns once the drive has accepted it. Raises InputError for a value that does not fit the type, and as `read`."""


class ProcessImage(Protocol):
    """The values of one drive as received last: statusword, position, and what else it has of velocity, torque, following error.

    heard_ns: when they were received; asked_ns: before they were taken, None where heard_ns is exact.
    """

    @property
    def values(self) -> Mapping[Entry, int]: ...

    @property
    def heard_ns(self) -> int: ...

    @property
    def asked_ns(self) -> int | None: ...

    @property
    def statusword(self) -> int: ...

    @property
    def position_counts(self) -> int: ...

    def refresh(self) -> None:
        """All values, of a moment after this call. Raises NoAnswerError, LinkLostError."""
