"""Faults of a Modbus wire, and the requests to which they apply, as data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sim_backends.faults import WireFaultKind

_WRITES = (5, 6, 15, 16)


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
