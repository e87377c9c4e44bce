"""Touch probe over CiA-402: 60B8h arms, 60B9h shows the state, 60BAh to 60BDh hold the latched positions.

Holds the bits of these objects. `drivers.touch_probe` decides which latch is new.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen.node import Node
from drivers.cia402 import objects
from drivers.scaling import AxisScaling
from drivers.touch_probe import Edge, LatchReading, TouchProbe

ENABLE, CONTINUOUS, ENABLED = 0x01, 0x02, 0x01  # within a probe's byte
ARM_BIT = {Edge.POSITIVE: 0x10, Edge.NEGATIVE: 0x20}  # of 60B8h
STORED_BIT = {Edge.POSITIVE: 0x02, Edge.NEGATIVE: 0x04}  # of 60B9h


class CanOpenTouchProbe(TouchProbe):
    """Both probes of one open drive. device_stamp is 60D1h to 60D4h, edges 60D5h to 60D8h."""

    def __init__(self, node: Node, scaling: AxisScaling) -> None:
        super().__init__(node.name, node.clock)
        self._scaling = scaling
        self._node = node
        self._function = node.sdo.read(objects.PROBE_FUNCTION)

    def _switch_on(self, probe: int, edges: frozenset[Edge], continuous: bool) -> bool:
        bits = ENABLE | (CONTINUOUS if continuous else 0)
        for edge in edges:
            bits |= ARM_BIT[edge]
        self._write(probe, bits)
        return bool(self._status(probe) & ENABLED)

    def _switch_off(self, probe: int) -> None:
        self._write(probe, 0)

    def _latched(self, wanted: Sequence[tuple[int, Edge]]) -> list[tuple[int, Edge]]:
        status = self._node.sdo.read(objects.PROBE_STATUS)
        return [(probe, edge) for probe, edge in wanted if _byte(status, probe) & STORED_BIT[edge]]

    def _read(self, probe: int, edge: Edge) -> LatchReading:
        place = 2 * (probe - 1) + edge
        counts = self._node.sdo.read(objects.PROBE_POSITION[place])
        edges = self._node.sdo.read_if_there(objects.PROBE_COUNTER[place], None)
        stamp = self._node.sdo.read_if_there(objects.PROBE_STAMP[place], None)
        return LatchReading(self._scaling.load_mm(counts), stamp, edges)

    def _status(self, probe: int) -> int:
        return _byte(self._node.sdo.read(objects.PROBE_STATUS), probe)

    def _write(self, probe: int, bits: int) -> None:
        shift = 8 * (probe - 1)
        self._function = self._function & ~(0xFF << shift) & 0xFFFF | bits << shift
        self._node.sdo.write(objects.PROBE_FUNCTION, self._function)


def _byte(word: int, probe: int) -> int:
    return word >> 8 * (probe - 1) & 0xFF
