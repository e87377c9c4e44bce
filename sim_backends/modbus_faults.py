"""Faults of a Modbus wire, and the requests to which they apply, as data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

_WRITES = (5, 6, 15, 16)


class WireFaultKind(Enum):
    """Kinds of fault; the comment says whether the request is carried out."""

    LATE_REPLY = "late reply"  # carried out; the reply leaves delay_s of simulated time later
    DISPLACED = "displaced reply"  # carried out; the reply leaves just before the next one on the same wire
    NO_REPLY = "no reply"  # carried out; the reply is lost
    LOST_REQUEST = "lost request"  # neither carried out nor answered
    EXCEPTION = "exception"  # not carried out, answered with `code`
    BAD_CRC = "damaged reply"  # carried out; one bit of the reply's check (TCP: of its protocol id) is flipped
    WRONG_UNIT = "wrong unit"  # carried out; the reply names the next unit
    WRONG_FUNCTION = "wrong function"  # carried out; the reply is one to another function
    WRONG_ECHO = "wrong echo"  # carried out; the reply to a write names another address
    TRUNCATED = "truncated reply"  # carried out; only the first half of the reply is sent
    TORN = "torn reply"  # carried out; half of the reply is sent, the rest just before the next one
    SHORT_DATA = "short data"  # carried out; a well-formed reply with one register too few
    DROP = "connection dropped"  # carried out; TCP: the connection is closed instead of a reply
    DROP_REQUEST = "connection dropped before"  # not carried out; TCP: the connection is closed


@dataclass(frozen=True)
class WireFault:
    """Applies to the nth request that matches (1 = the next), and the `count` − 1 after it.

    function None matches every function, writes=True only those that write; unit None every unit.
    """

    kind: WireFaultKind
    nth: int = 1
    count: int = 1
    function: int | None = None
    writes: bool = False
    unit: int | None = None
    delay_s: float = 0.0
    code: int = 4

    def matches(self, unit: int, function: int) -> bool:
        """Whether it applies to requests of this unit and function."""
        return (
            self.unit in (None, unit) and self.function in (None, function) and (not self.writes or function in _WRITES)
        )


class WireFaultPlan:
    """The faults of one server and how many requests each has matched; at most one fault applies to a request, the first one due."""

    def __init__(self, faults: Iterable[WireFault] = ()) -> None:
        self._faults = [(fault, [0]) for fault in faults]

    def add(self, fault: WireFault) -> None:
        """Arm another fault; it counts from now."""
        self._faults.append((fault, [0]))

    def clear(self) -> None:
        """Remove every fault."""
        self._faults.clear()

    def hit_by(self, unit: int, function: int) -> WireFault | None:
        """The fault that applies to this request; every fault that matches counts it."""
        hit: WireFault | None = None
        for fault, seen in self._faults:
            if fault.matches(unit, function):
                seen[0] += 1
                if hit is None and fault.nth <= seen[0] < fault.nth + fault.count:
                    hit = fault
        return hit
