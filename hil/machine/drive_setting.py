"""A number that a drive keeps, by the name in the axis file: an object of a CANopen drive, a named parameter of any other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.drive import ServoDrive
from drivers.errors import CapabilityError, InputError, ProtocolError, StateError
from drivers.parameters import DriveParameters
from hil.axis.axis_file import DriveAxis
from hil.axis.backlash import object_key

if TYPE_CHECKING:
    from drivers.canopen.drive import CanOpenDrive

_WRITES = 3  # of one measurement at most: 0, the earlier value, and the new amount; a value that was set to 0 must be restorable


@dataclass(frozen=True)
class ObjectSetting:
    """An object of a CANopen drive, whole numbers >= 0; its length is that of the drive's answer."""

    drive: CanOpenDrive
    name: str
    key: tuple[int, int]
    resolution: float = 1.0

    def read(self) -> float:
        """The present value. Raises what an SDO upload raises."""
        return int.from_bytes(self.drive.sdo.read_bytes(*self.key), "little")

    def write(self, value: float) -> None:
        """Raises InputError for what does not fit the object, AbortError where the drive refuses, ProtocolError for another value."""
        size = len(self.drive.sdo.read_bytes(*self.key))
        whole = round(value)
        if not 0 <= whole < 1 << (8 * size):
            raise InputError(f"{self.name} is to be {whole}, expected what {size} bytes hold")
        self.drive.sdo.write_bytes(*self.key, whole.to_bytes(size, "little"))
        kept = self.read()
        if kept != whole:
            raise ProtocolError(f"drive {self.drive.name}: {self.name} was written {whole}, it reads back {kept:g}")


@dataclass(frozen=True)
class NamedSetting:
    """A parameter of any drive by its name, in its own unit."""

    parameters: DriveParameters
    name: str
    resolution: float

    def read(self) -> float:
        """The present value. Raises InputError for one that is no number, and what reading a parameter raises."""
        value = self.parameters.read(self.name)
        if not isinstance(value, int | float):
            raise InputError(f"parameter {self.name} is {value!r}, expected a number")
        return value

    def write(self, value: float) -> None:
        """Writes and reads back. Raises what writing a parameter raises."""
        whole = self.resolution == 1.0
        self.parameters.write(self.name, round(value) if whole else value)


def drive_setting(axis: DriveAxis, drive: ServoDrive, name: str) -> ObjectSetting | NamedSetting:
    """The setting of that name, on the axis's open drive. Writes nothing.

    Raises CapabilityError for a parameter that cannot be written, StateError where the EEPROM's
    write budget does not last.
    """
    if axis.drive.register_map:
        return _register(drive, name)
    key = object_key(name)
    if key is not None:
        from drivers.canopen.drive import CanOpenDrive  # noqa: PLC0415  (a verb loads the wire its axis file names)
        from drivers.canopen.not_parameters import MOTION_TARGETS, NOT_PARAMETERS  # noqa: PLC0415  (as above)

        if isinstance(drive, CanOpenDrive):
            if key[0] in MOTION_TARGETS or key[0] in NOT_PARAMETERS or key[0] < 0x2000:
                raise CapabilityError(
                    f"drive {drive.name}: {name} is no parameter but a target, a command or communication; nothing was written"
                )
            return ObjectSetting(drive, name, key)
    return NamedSetting(_writable(drive, name), name, 1.0)


def _writable(drive: ServoDrive, name: str) -> DriveParameters:
    if not drive.parameters.describe(name).writable:
        raise CapabilityError(f"drive {drive.name}: {name} cannot be written")
    return drive.parameters


def _register(drive: ServoDrive, name: str) -> NamedSetting:
    from drivers.modbus.drive import ModbusDrive  # noqa: PLC0415  (as above)
    from drivers.modbus.register_map import Memory  # noqa: PLC0415  (as above)

    parameters = _writable(drive, name)
    if not isinstance(drive, ModbusDrive):
        return NamedSetting(parameters, name, 1.0)
    register = drive.registers[name]
    left = register.wear_budget - drive.raw.wear.writes(drive.name, name)
    if register.memory is Memory.EEPROM and left < _WRITES:
        raise StateError(
            f"drive {drive.name}: {name} is kept in EEPROM and its budget has {max(0, left)} writes left, a measurement takes"
            f" {_WRITES}; raise wear_budget in the register map if this is meant"
        )
    return NamedSetting(parameters, name, abs(register.scale) or 1.0)
