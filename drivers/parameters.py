"""DriveParameters: a drive's own parameters by name, whatever wire it is on; `NamedParameters` implements it for every wire.

Values are in the drive's own units, and `describe` names them. Objects that move the axis are no parameters: targets, modes and
commands are refused. Whole sets (snapshot, all-or-nothing transaction, audit) are built by `hil.parameters`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

ParameterValue = int | float | str | bytes


class ParameterKind(Enum):
    """The type of a parameter's value."""

    INTEGER = "whole number"
    NUMBER = "number"
    TEXT = "text"
    BYTES = "bytes"


@dataclass(frozen=True)
class ParameterInfo:
    """Description of a parameter. low and high: allowed range in its unit, its type's range at most; None is unlimited.

    wears: each change is written to a memory with a limited number of write cycles.
    """

    name: str
    kind: ParameterKind
    unit: str = ""
    low: float | None = None
    high: float | None = None
    writable: bool = True
    wears: bool = False
    description: str = ""

    def outside(self, value: float) -> str | None:
        """Why a value lies outside the range, with range and unit; None where it lies within."""
        low, high = (None if limit is None else f"{limit:.15g}" for limit in (self.low, self.high))
        if self.low is not None and value < self.low:
            beyond = f"{value!r} is below its limit {low}"
        elif self.high is not None and value > self.high:
            beyond = f"{value!r} is above its limit {high}"
        else:
            return None
        allowed = f"at most {high}" if low is None else f"at least {low}" if high is None else f"{low} to {high}"
        return f"{beyond}, allowed is {allowed} {self.unit}".rstrip()


class DriveParameters(ABC):
    """Parameter access of one open drive. Raises NoAnswerError and LinkLostError from every access."""

    @property
    @abstractmethod
    def names(self) -> Sequence[str]:
        """Names of all parameters that can be read."""

    @abstractmethod
    def describe(self, name: str) -> ParameterInfo:
        """The description of a parameter. It and the methods below raise InputError for a name that the drive does not have."""

    @abstractmethod
    def read(self, name: str) -> ParameterValue:
        """The present value in the drive's unit. Raises AbortError, NoAnswerError, ProtocolError."""

    @abstractmethod
    def write(self, name: str, value: ParameterValue) -> bool:
        """Check, write, read back; False when the drive held the value already and nothing was written.

        Raises InputError for a value outside type or limits, CapabilityError for a parameter that is read only or moves the axis,
        AbortError when the drive refuses, ProtocolError when it took the value but reads back another.
        """
