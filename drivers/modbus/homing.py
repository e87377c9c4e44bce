"""Homing by a Modbus drive's own methods, as its register map describes it: ordered, and followed until it is attained or has failed.

The drive decides whether it may begin, and stops one that was not confirmed.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.errors import DriveFaultError
from drivers.modbus.codec import Raw
from drivers.modbus.commands import POLL_S, hold
from drivers.modbus.drive_map import HomingMap, all_hold
from drivers.modbus.drive_values import Unit
from drivers.standstill import Standstill

_ATTAINED_S = 0.5
""""Homing attained" that did not go away after the start counts when it and the axis's position stay for this long, s."""


class MappedHoming:
    """Homing of one drive. homed: since it was opened, or as the drive reports, None while that is unknown.

    under_way: begun, and its end not seen yet. elsewhere: the last one ended in another frame than announced.
    post_stop(): sends the stop.
    """

    def __init__(self, unit: Unit, *, post_stop: Callable[[], None]) -> None:
        self.homed: bool | None = None
        self.under_way = self.elsewhere = False
        self._unit = unit
        self._post_stop = post_stop
        self._attained_gone = False  # whether the "homing attained" of the last homing has gone since this one started
        self._attained_stands = Standstill(unit.scaling.resolution_load_mm)  # while it is shown

    def forget(self) -> None:
        """For a new connection: nothing is known of earlier homings."""
        self.homed, self.under_way, self.elsewhere = None, False, False

    def begin(self, homing: HomingMap, take_power: Callable[[], None]) -> None:
        """Order it and wait until the drive shows it in progress, or attained for long enough. take_power(): for a drive that homes as
        its power comes on. Raises MotionTimeoutError, NoAnswerError."""
        commands = self._unit.commands
        commands.give(homing.release)
        commands.set_mode(homing.mode, homing.mode_shown, homing.timeout_s)
        self.homed = self.elsewhere = False
        if homing.at_power_on:
            take_power()
            commands.remember([write.register for write in homing.start if write.mask is None])
        commands.start(homing.start, "homing", homing.timeout_s)
        commands.wait_for(homing.accepted, "homing to be taken up", homing.timeout_s, homing.remedy)
        self._attained_gone, self._attained_stands = False, Standstill(self._unit.scaling.resolution_load_mm)
        self.under_way = True
        deadline = self._unit.clock.deadline(homing.timeout_s)
        while not self._attained_seen(homing) and not deadline.expired:
            self._unit.clock.sleep_s(POLL_S)

    def _attained_seen(self, homing: HomingMap) -> bool:
        """Whether one sample shows that "attained" has gone, or has stayed for long enough."""
        raw = self._unit.access.read(self._unit.map.sampled())
        position_mm = self._unit.scaling.load_mm(self._unit.values.position_counts(raw))
        attained = hold(homing.applies, raw) and hold(homing.attained, raw)
        return self._is_of_this_homing(attained, self._unit.clock.now_ns(), position_mm)

    def _is_of_this_homing(self, attained: bool, time_ns: int, position_mm: float) -> bool:
        """Whether the "attained" shown cannot be that of the last homing, which stays until the drive has processed its commands."""
        self._attained_gone = self._attained_gone or not attained
        stayed = self._attained_stands.look(time_ns, position_mm, still_s=_ATTAINED_S)
        return self._attained_gone or stayed

    def look(self, raw: dict[str, Raw], time_ns: int, position_mm: float) -> None:
        """Evaluate a sample: its registers, time (ns) and position (load mm). Raises DriveFaultError once when homing failed."""
        homing = self._unit.map.homing
        if homing is None or not hold(homing.applies, raw):
            return
        if self.under_way and homing.failed and hold(homing.failed, raw):
            self.under_way, self.homed = False, False
            if self._unit.values.load_mm(raw, self._unit.map.velocity) != 0.0:
                self._post_stop()
            raise DriveFaultError(f"drive {self._unit.name}: homing failed", self._unit.values.fault_code(raw))
        attained = hold(homing.attained, raw) and not self.elsewhere
        if self.under_way and not (self._is_of_this_homing(attained, time_ns, position_mm) and attained):
            return
        self.under_way, self.homed = False, attained

    def leave(self, raw: dict[str, Raw]) -> None:
        """Take back a homing order that is still set: it would start another homing, or act as a new set-point."""
        homing = self._unit.map.homing
        self.under_way = False
        if homing is not None and homing.applies and hold(homing.applies, raw):
            self._unit.commands.give(homing.release)

    def ask(self, homing: HomingMap) -> bool | None:
        """Read in homing mode whether the drive is homed. None for one that does not say so: it may have lost it with the change of
        mode. For a drive without power."""
        self._unit.commands.set_mode(homing.mode, homing.mode_shown, homing.timeout_s)
        raw = self._unit.access.of_conditions((*homing.applies, *homing.attained))
        return True if all_hold(homing.applies, raw) and all_hold(homing.attained, raw) else None
