"""TouchProbe: positions that a drive latches itself on the edges of its probe inputs, whatever wire it is on.

The drive latches within microseconds; how late the host reads the latch does not affect the position. A backend implements how
an input is armed and where its latches are read; which latch is new is decided here for all backends.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import IntEnum

from drivers.clock import Clock
from drivers.errors import InputError, ProtocolError


class Edge(IntEnum):
    """Edges of a probe's signal."""

    POSITIVE = 0
    NEGATIVE = 1


@dataclass(frozen=True)
class Latch:
    """One latched position, load mm. time_ns: the clock's time at which the host read it.

    device_stamp: the drive's own time stamp (its unit and zero are the drive's); edges: the number of edges that the drive has
    counted; None where a drive has neither.
    """

    probe: int
    edge: Edge
    position_load_mm: float
    time_ns: int
    device_stamp: int | None
    edges: int | None


@dataclass(frozen=True)
class LatchReading:
    """The values of one edge in the drive; fields as in `Latch`."""

    position_load_mm: float
    device_stamp: int | None
    edges: int | None


class TouchProbe(ABC):
    """The touch-probe function of one open drive. probes: the numbers of its inputs, from 1.

    A drive that counts no edges cannot tell two passes at the very same position apart.
    """

    probes: Sequence[int] = (1, 2)

    def __init__(self, drive_name: str, clock: Clock) -> None:
        self._name = drive_name
        self._clock = clock
        self._armed: dict[tuple[int, Edge], LatchReading | None] = {}  # last reading of each armed edge
        self._continuous: set[int] = set()

    def arm(self, probe: int, edges: Collection[Edge], *, continuous: bool = False) -> None:
        """Latch the next of these edges of a probe, or each of them (the last counts) where `continuous`.

        Earlier latches are discarded. Raises InputError for another probe or no edge, ProtocolError when the drive does
        not arm it, CapabilityError where it cannot latch such edges, AbortError when it refuses.
        """
        if probe not in self.probes or not edges:
            known = " or ".join(str(number) for number in self.probes)
            raise InputError(
                f"touch probe {probe} with edges {sorted(edges)}: expected probe {known} and at least one edge"
            )
        self.disarm(probe)
        if not self._switch_on(probe, frozenset(edges), continuous):
            raise ProtocolError(f"drive {self._name}: touch probe {probe} was armed, its status does not show it")
        for edge in edges:
            self._armed[probe, edge] = None
        if continuous:
            self._continuous.add(probe)

    def disarm(self, probe: int) -> None:
        """Switch a probe off."""
        for edge in Edge:
            self._armed.pop((probe, edge), None)
        self._continuous.discard(probe)
        self._switch_off(probe)

    def poll(self) -> list[Latch]:
        """Latches since the last call, at most one per armed edge. Never waits. Raises as reading a parameter does."""
        found = []
        wanted = [
            key for key, last in sorted(self._armed.items()) if last is None or key[0] in self._continuous
        ]  # a single latch is read once
        for probe, edge in self._latched(wanted) if wanted else ():
            reading, last = self._read(probe, edge), self._armed[probe, edge]
            if last is not None and (reading.position_load_mm, reading.edges) == (last.position_load_mm, last.edges):
                continue
            self._armed[probe, edge] = reading
            found.append(
                Latch(probe, edge, reading.position_load_mm, self._clock.now_ns(), reading.device_stamp, reading.edges)
            )
        return found

    # -- implemented by a backend --------------------------------------------------------------------------------------
    @abstractmethod
    def _switch_on(self, probe: int, edges: frozenset[Edge], continuous: bool) -> bool:
        """Arm a probe that is off; whether the drive shows it as armed."""

    @abstractmethod
    def _switch_off(self, probe: int) -> None: ...

    @abstractmethod
    def _latched(self, wanted: Sequence[tuple[int, Edge]]) -> list[tuple[int, Edge]]:
        """Those of the wanted edges for which the drive holds a latch."""

    @abstractmethod
    def _read(self, probe: int, edge: Edge) -> LatchReading: ...
