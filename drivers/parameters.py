"""DriveParameters: a drive's own parameters by name, whatever wire it is on; `NamedParameters` implements it for every wire.

Values are in the drive's own units, and `describe` names them. Objects that move the axis are no parameters: targets, modes and
commands are refused. Whole sets (snapshot, all-or-nothing transaction, audit) are built by `hil.parameters`.
"""

from __future__ import annotations

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

ParameterValue = int | float | str | bytes
_ROUNDED = 1e-7  # relative, of a number with four bytes


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
        """Why a value lies outside the range, None where it lies within, or as near to its end as the drive's bytes can hold it."""
        for limit, far, word in ((self.low, operator.lt, "below"), (self.high, operator.gt, "above")):
            if limit is not None and far(value, limit):
                if isinstance(value, float) and math.isclose(value, limit, rel_tol=_ROUNDED):
                    continue
                return f"{value!r} is {word} its limit {limit:g}"
        return None


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
