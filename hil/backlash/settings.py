"""Where an axis keeps its backlash amount and acceleration switch: objects of a CANopen drive, named parameters of any
other drive. A drive that has none is compensated by the axis's sealed tables.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.drive import ServoDrive
from drivers.errors import InputError, StateError
from hil.axis.axis_file import DriveAxis
from hil.axis.backlash import BacklashConfig
from hil.backlash.neutral_settings import BacklashSettings
from hil.machine.drive_setting import drive_setting

NOTE = "backlash-before.json"
_TABLES_RESOLUTION_UM = 0.1


@dataclass(frozen=True)
class NoSetting:
    """Of a drive without such a parameter: always 0. Its lost motion is entered in the axis's sealed tables, in µm."""

    name: str = "no parameter of the drive"
    resolution: float = _TABLES_RESOLUTION_UM

    def read(self) -> float:
        """0.0: the drive compensates nothing."""
        return 0.0

    def write(self, value: float) -> None:
        """Raises StateError for another value than 0."""
        if value:
            raise StateError("the drive has no backlash parameter that could hold an amount ([backlash] parameter)")


def backlash_settings(axis: DriveAxis, how: BacklashConfig, drive: ServoDrive) -> BacklashSettings:
    """The settings that an axis file names, on its open drive. Writes nothing.

    Raises InputError for an incomplete section, and as `drive_setting`.
    """
    directory = axis.store.directory
    directory.mkdir(parents=True, exist_ok=True)
    if how.parameter is None:
        if how.acceleration is not None:
            raise InputError("[backlash] names acceleration without parameter, expected both or none", path=axis.path)
        return BacklashSettings(NoSetting(), 1.0, None, directory / NOTE, how.scale)
    amount = drive_setting(axis, drive, how.parameter)
    acceleration = None if how.acceleration is None else drive_setting(axis, drive, how.acceleration)
    return BacklashSettings(amount, how.parameter_um, acceleration, directory / NOTE, how.scale)
