"""Faults of a simulated part and their times, as data; each part acts on the faults of its own kinds.

Times are seconds of simulated time since the clock's zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class FaultKind(Enum):
    """Kinds of fault; the comment gives the meaning of `size`."""

    # of the interferometer's signal
    BEAM_LOST = "beam lost"  # the count runs away while it lasts
    HEAD_ERROR = "head error"
    OVERSPEED = "overspeed"
    GLITCH = "glitch"  # size µm on every sample while it lasts
    # of its line
    SILENCE = "silence"  # samples are taken and numbered, but not sent
    HALF_LINE = "half line"  # a line breaks off in the middle
    GARBAGE = "garbage"  # size bytes of noise after the line (8 when 0)
    LINE_ENDS = "other line ends"  # LF, CR and CR LF in turn
    RESTART = "restart"  # numbers and counts begin anew
    # of the drive
    DRIVE_FAULT = "drive fault"  # size = error code
    JAM = "jam"  # the shaft is blocked
    TORQUE_NOISE = "torque noise"  # size: additional noise, 0.1 %


@dataclass(frozen=True)
class Fault:
    """One fault in force from at_s on for duration_s, s; with duration 0 it happens once."""

    kind: FaultKind
    at_s: float
    duration_s: float = 0.0
    size: float = 0.0


class FaultSchedule:
    """The faults of one part, in time order. A fault of duration 0 is returned exactly once."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults: list[Fault] = []
        self._done: set[int] = set()  # identities: of two faults that are alike each happens
        self.next_s = math.inf
        self.add(faults)

    def add(self, faults: Iterable[Fault]) -> None:
        """Add faults to those there are."""
        self._faults = sorted([*self._faults, *faults], key=lambda fault: fault.at_s)
        self.next_s = self._faults[0].at_s if self._faults else math.inf

    def active(self, time_s: float) -> list[Fault]:
        """The faults in force at this time, s; single ones only at the first call after their time."""
        if time_s < self.next_s:
            return []
        found = []
        for fault in self._faults:
            if fault.at_s > time_s:
                break
            if fault.duration_s == 0.0:
                if id(fault) not in self._done:
                    self._done.add(id(fault))
                    found.append(fault)
            elif time_s < fault.at_s + fault.duration_s:
                found.append(fault)
        return found

    def next_change_s(self, time_s: float) -> float:
        """Time of the next begin or end of a fault after this time, s; inf when there is none."""
        changes = [f.at_s for f in self._faults] + [f.at_s + f.duration_s for f in self._faults]
        return min((change for change in changes if change > time_s), default=math.inf)
