"""Touch probe: positions that the drive itself latches on the edges of its probe inputs (CiA-402, 60B8h to 60BDh).

What may go in: arming both probes and fetching what they latched, in load mm. The latch is made in the drive within microseconds; how
late the host fetches it does not matter to the position.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum

from drivers.canopen import objects
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.sdo import SdoClient
from drivers.drive import Capability
from drivers.errors import AbortError, InputError, ProtocolError

ENABLE, CONTINUOUS, ENABLED = 0x01, 0x02, 0x01
OBJECT_MISSING = (0x06020000, 0x06090011)


class Edge(IntEnum):
    """Edges of a probe's signal, numbered as the objects are."""

    POSITIVE = 0
    NEGATIVE = 1

    @property
    def arm_bit(self) -> int:
        """In 60B8h, within the probe's byte."""
        return 0x10 << self

    @property
    def stored_bit(self) -> int:
        """In 60B9h, within the probe's byte."""
        return 0x02 << self


@dataclass(frozen=True)
class Latch:
    """One latched position. time_ns is the clock's when the host fetched it.

    device_stamp is the drive's own time stamp (60D1h to 60D4h; unit and zero are the drive's), edges how many edges the drive has
    counted there; None where a drive has no such object.
    """

    probe: int
    edge: Edge
    position_load_mm: float
    time_ns: int
    device_stamp: int | None
    edges: int | None


class TouchProbe:
    """The touch-probe function of one open drive, both probes."""

    def __init__(self, drive: CanOpenDrive) -> None:
        drive.require(Capability.TOUCH_PROBE)
        self._drive = drive
        self._function = self._sdo.read(objects.PROBE_FUNCTION)
        self._seen: dict[
            tuple[int, Edge], tuple[int, int | None] | None
        ] = {}  # of each armed edge, what was fetched last
        self._continuous = {1: False, 2: False}

    @property
    def _sdo(self) -> SdoClient:
        return self._drive.sdo  # another one after a restart

    def arm(self, probe: int, edges: Collection[Edge], *, continuous: bool = False) -> None:
        """Latch the next of these edges of probe 1 or 2, or each of them (the last counts) where `continuous`.

        What was latched before is forgotten. Raises InputError for another probe or no edge, ProtocolError when the drive does
        not arm it, AbortError when it refuses.
        """
        if probe not in (1, 2) or not edges:
            raise InputError(
                f"touch probe {probe} with edges {sorted(edges)}: expected probe 1 or 2 and at least one edge"
            )
        self.disarm(probe)
        bits = ENABLE | (CONTINUOUS if continuous else 0)
        for edge in edges:
            bits |= edge.arm_bit
            self._seen[probe, edge] = None
        self._continuous[probe] = continuous
        self._write(probe, bits)
        if not self._status(probe) & ENABLED:
            raise ProtocolError(f"drive {self._drive.name}: touch probe {probe} was armed, 60B9h does not show it")

    def disarm(self, probe: int) -> None:
        """Switch a probe off."""
        for edge in Edge:
            self._seen.pop((probe, edge), None)
        self._write(probe, 0)

    def poll(self) -> list[Latch]:
        """What was latched since the last call, never waiting; at most one latch per armed edge."""
        found = []
        for probe in sorted({probe for probe, _ in self._seen}):
            status = self._status(probe)
            for edge in Edge:
                if (probe, edge) in self._seen and status & edge.stored_bit:
                    latch = self._fetch(probe, edge)
                    if latch is not None:
                        found.append(latch)
        return found

    def _fetch(self, probe: int, edge: Edge) -> Latch | None:
        """The latched value, None when it is the one that was fetched before."""
        if self._seen[probe, edge] is not None and not self._continuous[probe]:
            return None
        place = 2 * (probe - 1) + edge
        counts = self._sdo.read(objects.PROBE_POSITION[place])
        edges = self._optional(objects.PROBE_COUNTER[place])
        if self._seen[probe, edge] == (counts, edges):
            return None
        self._seen[probe, edge] = (counts, edges)
        stamp = self._optional(objects.PROBE_STAMP[place])
        drive = self._drive
        return Latch(probe, edge, drive.scaling.load_mm(counts), drive.clock.now_ns(), stamp, edges)

    def _optional(self, entry: objects.Entry) -> int | None:
        try:
            return self._sdo.read(entry)
        except AbortError as error:
            if error.code in OBJECT_MISSING:
                return None
            raise

    def _status(self, probe: int) -> int:
        return self._sdo.read(objects.PROBE_STATUS) >> 8 * (probe - 1) & 0xFF

    def _write(self, probe: int, bits: int) -> None:
        shift = 8 * (probe - 1)
        self._function = self._function & ~(0xFF << shift) & 0xFFFF | bits << shift
        self._sdo.write(objects.PROBE_FUNCTION, self._function)
