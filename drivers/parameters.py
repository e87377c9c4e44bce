"""DriveParameters: a drive's own parameters by name, whatever wire it is on.

Values are in the drive's own units, and `describe` says which. What moves the axis is no parameter: targets, modes and commands are
refused. Whole sets (snapshot, all or nothing, audit) are built on top of this.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

ParameterValue = int | float | str | bytes


class ParameterKind(Enum):
    """What a parameter's value is."""

    INTEGER = "whole number"
    NUMBER = "number"
    TEXT = "text"
    BYTES = "bytes"


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of a parameter. low and high: what it may be, in its unit, its type's range at most; None is unlimited.

    wears: each change goes into a memory that bears only so many writes.
    """

    name: str
    kind: ParameterKind
    unit: str = ""
    low: float | None = None
    high: float | None = None
    writable: bool = True
    wears: bool = False
    description: str = ""


class DriveParameters(ABC):
    """Parameter access of one open drive."""

    @property
    @abstractmethod
    def names(self) -> Sequence[str]:
        """Every parameter that can be read."""

    @abstractmethod
    def describe(self, name: str) -> ParameterInfo:
        """Raises InputError for a name that the drive does not have, as the others do."""

    @abstractmethod
    def read(self, name: str) -> ParameterValue:
        """The present value. Raises AbortError, NoAnswerError, ProtocolError."""

    @abstractmethod
    def write(self, name: str, value: ParameterValue) -> bool:
        """Check, write, read back; False when the drive held the value already and was not written to.

        Raises InputError for what does not fit type or limits, CapabilityError for what is read only or moves the axis, AbortError
        when the drive refuses, ProtocolError when it took the value but shows another.
        """
