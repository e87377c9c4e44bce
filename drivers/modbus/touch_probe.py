"""Touch probe of a Modbus drive, by the probe inputs of its register map. `drivers.touch_probe` decides which latch is new."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.clock import Clock
from drivers.errors import CapabilityError
from drivers.modbus.codec import Raw
from drivers.modbus.drive_map import ProbeMap, all_hold
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.touch_probe import Edge, LatchReading, TouchProbe


class ModbusTouchProbe(TouchProbe):
    """The probe inputs of one open drive. load_mm(raw, register name): a latched position, load mm."""

    def __init__(
        self,
        drive_name: str,
        clock: Clock,
        probes: Sequence[ProbeMap],
        access: RegisterAccess,
        load_mm: Callable[[Raw, str], float],
    ) -> None:
        super().__init__(drive_name, clock)
        self._maps = {probe.number: probe for probe in probes}
        self.probes = tuple(self._maps)
        self._access = access
        self._load_mm = load_mm

    def _switch_on(self, probe: int, edges: frozenset[Edge], continuous: bool) -> bool:
        found = self._maps[probe]
        missing = [edge.name.lower() for edge in sorted(edges) if edge not in found.edges]
        if missing or (continuous and not found.continuous):
            what = f"{' and '.join(missing)} edges" if missing else "each edge, only the next one"
            raise CapabilityError(f"drive {self._name}: touch probe {probe} does not latch {what}")
        writes = [write for edge in sorted(edges) for write in found.edges[edge].arm]
        for write in (*writes, *(found.continuous if continuous else ()), *found.on):
            self._access.command(write)
        return all_hold(found.armed, self._access.of_conditions(found.armed))

    def _switch_off(self, probe: int) -> None:
        for write in self._maps[probe].off:
            self._access.command(write)

    def _latched(self, wanted: Sequence[tuple[int, Edge]]) -> list[tuple[int, Edge]]:
        shown = {key: self._maps[key[0]].edges[key[1]].latched for key in wanted}
        raw = self._access.of_conditions([condition for conditions in shown.values() for condition in conditions])
        return [key for key, conditions in shown.items() if all_hold(conditions, raw)]

    def _read(self, probe: int, edge: Edge) -> LatchReading:
        found = self._maps[probe].edges[edge]
        raw = self._access.read([name for name in (found.position, found.stamp, found.count) if name is not None])
        return LatchReading(
            self._load_mm(raw[found.position], found.position),
            None if found.stamp is None else whole(raw[found.stamp], found.stamp),
            None if found.count is None else whole(raw[found.count], found.count),
        )
