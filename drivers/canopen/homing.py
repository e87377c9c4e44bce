"""Homing by a CANopen drive's own methods: begun with its settings, and looked after until it is attained or has failed.

What may go in: the objects and status bits of the homing mode. Who waits for it, and how often it is tried, is the drive's business.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen import objects
from drivers.canopen.cia402 import Control, HomingStatus, Mode, decode_homing
from drivers.canopen.motion import RUN, ProfileMotion
from drivers.canopen.objects import Entry
from drivers.canopen.power import PowerStage
from drivers.canopen.settings import HomingSettings
from drivers.errors import DriveFaultError
from drivers.scaling import AxisScaling


class Homing:
    """Of one open drive. homed: since it was opened, None while that is unknown; under_way: begun, and not heard the end of."""

    def __init__(self, drive_name: str, power: PowerStage, motion: ProfileMotion) -> None:
        self.homed: bool | None = None
        self.under_way = False
        self._name = drive_name
        self._power = power
        self._motion = motion

    def start(self, homing: HomingSettings, scaling: AxisScaling) -> None:
        """Write the settings, change the mode, begin."""
        settings: list[tuple[Entry, int | None]] = [
            (objects.HOMING_METHOD, homing.method),
            (objects.HOMING_SPEED_SWITCH, _counts(homing.speed_switch_mm_s, scaling.motor_counts_per_s)),
            (objects.HOMING_SPEED_ZERO, _counts(homing.speed_zero_mm_s, scaling.motor_counts_per_s)),
            (objects.HOME_OFFSET, _counts(homing.home_position_mm, scaling.motor_counts)),
        ]
        for entry, value in settings:
            if value is not None:
                self._motion.set(entry, value)
        self._motion.set_mode(Mode.HOMING)
        self.homed, self.under_way = False, False
        self._power.write(RUN)
        self._power.write(RUN | Control.HOMING_START)
        self.under_way = True

    def look(self, status: int) -> None:
        """At a statusword; does nothing unless it is under way. Raises DriveFaultError once when it failed."""
        if not self.under_way:
            return
        homing = decode_homing(status)
        if homing is HomingStatus.COMPLETED:
            self.homed, self.under_way = True, False
        elif homing is not None and homing.failed:
            self.under_way = False
            self._power.write(RUN)
            raise DriveFaultError(
                f"drive {self._name}: homing failed, statusword {status:04X}h ({homing.name.lower()})"
            )


def _counts(value: float | None, convert: Callable[[float], int]) -> int | None:
    return None if value is None else convert(value)
