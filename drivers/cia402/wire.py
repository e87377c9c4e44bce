"""What CiA 402 needs of a wire: objects that are read and written."""

from __future__ import annotations

from typing import Protocol, TypeVar

from drivers.cia402.objects import Entry

Absent = TypeVar("Absent", int, None)

OBJECT_MISSING = (0x06020000, 0x06090011)
"""Codes of an AbortError for an object, or a sub-index, that does not exist (CiA 301, table 22)."""
LEFT_OUT = (0x06010002, *OBJECT_MISSING)
"""Read-only, no such object, no such sub-index."""
OUT_OF_RANGE = (0x06090030, 0x06090031)
"""Value outside the object's range, value too high."""


class Objects(Protocol):
    """The objects of one drive, one at a time. name: such as "drive X", for errors.

    Every call returns once the drive has answered.
    """

    @property
    def name(self) -> str: ...

    def read(self, entry: Entry) -> int:
        """A whole number. Raises AbortError (a refusal, with the codes of CiA 301), NoAnswerError, ProtocolError, LinkLostError."""

    def read_if_shown(self, entry: Entry, absent: Absent) -> int | Absent:
        """A whole number; `absent` where the drive refuses it. Raises as `read`, but not AbortError."""
