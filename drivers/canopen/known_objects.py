"""Which objects of a drive are parameters: those of its EDS, as "2100h:01", and the standard's, which have names of their own.

`not_parameters` says which of them may not be written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.canopen import cia301
from drivers.canopen.eds import EdsEntry, EdsFile, Key
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.errors import ProtocolError
from drivers.parameters import ParameterKind
from drivers.scaling import MotionScaling

VELOCITY, ACCELERATION = "velocity", "acceleration"
"""In place of a unit: the drive's own one, see `unit_text`."""
_STANDARD: tuple[tuple[Entry, str, bool], ...] = (
    # object, unit, whether it may be written
    (cia301.DEVICE_NAME, "", False),
    (cia301.HARDWARE_VERSION, "", False),
    (cia301.SOFTWARE_VERSION, "", False),
    (cia301.SERIAL_NUMBER, "", False),
    (objects.QUICK_STOP_OPTION, "", True),
    (objects.SHUTDOWN_OPTION, "", True),
    (objects.DISABLE_OPTION, "", True),
    (objects.HALT_OPTION, "", True),
    (objects.FAULT_REACTION_OPTION, "", True),
    (objects.FOLLOWING_ERROR_WINDOW, "counts", True),
    (objects.FOLLOWING_ERROR_TIMEOUT, "ms", True),
    (objects.MAX_TORQUE, "0.1 %", True),  # of the rated torque, as all torques of CiA 402
    (objects.POSITION_WINDOW, "counts", True),
    (objects.POSITION_WINDOW_TIME, "ms", True),
    (objects.HOME_OFFSET, "counts", True),
    (objects.SOFTWARE_LIMIT_MIN, "counts", True),
    (objects.SOFTWARE_LIMIT_MAX, "counts", True),
    (objects.QUICK_STOP_DECELERATION, ACCELERATION, True),
    (objects.ENCODER_INCREMENTS, "", False),
    (objects.ENCODER_REVOLUTIONS, "", False),
    (objects.GEAR_MOTOR_REVOLUTIONS, "", True),
    (objects.GEAR_SHAFT_REVOLUTIONS, "", True),
    (objects.FEED, "", True),
    (objects.FEED_SHAFT_REVOLUTIONS, "", True),
    (objects.HOMING_METHOD, "", True),
    (objects.HOMING_SPEED_SWITCH, VELOCITY, True),
    (objects.HOMING_SPEED_ZERO, VELOCITY, True),
    (objects.HOMING_ACCELERATION, ACCELERATION, True),
)


def address_of(key: Key) -> str:
    """An object's address in parameter sets, such as "2210h:01"."""
    return f"{key[0]:04X}h:{key[1]:02X}"


@dataclass(frozen=True)
class KnownObjects:
    """All objects, readable or not, and of the standard's ones name -> key and key -> unit, as `unit_text` takes it."""

    entries: Mapping[Key, EdsEntry]
    names: Mapping[str, Key]
    units: Mapping[Key, str]


def known_objects(eds: EdsFile | None) -> KnownObjects:
    """The drive's known objects. An EDS takes precedence over the standard."""
    entries: dict[Key, EdsEntry] = dict(eds.entries) if eds is not None else {}
    names: dict[str, Key] = {}
    units: dict[Key, str] = {}
    for entry, unit, writable in _STANDARD:
        if eds is None:
            entries[entry.key] = EdsEntry(entry, "rw" if writable else "ro", None, None, None, None, False)
        if entry.key in entries:
            names[entry.name.replace(" ", "_").replace("-", "_").lower()] = entry.key
            units[entry.key] = unit
    return KnownObjects(entries, names, units)


def unit_text(unit: str, motion: MotionScaling | None) -> str:
    """A unit of `KnownObjects` as text. motion: the drive's own units of velocity and acceleration; "" where they are not known."""
    if unit not in (VELOCITY, ACCELERATION):
        return unit
    if motion is None or motion.ambiguous:
        return ""
    return motion.velocity.text if unit == VELOCITY else motion.acceleration.text


_KINDS: Mapping[DataType, ParameterKind] = {
    DataType.F32: ParameterKind.NUMBER,
    DataType.F64: ParameterKind.NUMBER,
    DataType.STRING: ParameterKind.TEXT,
    DataType.UNICODE: ParameterKind.TEXT,
    DataType.OCTETS: ParameterKind.BYTES,
    DataType.TIME_OF_DAY: ParameterKind.BYTES,
    DataType.TIME_DIFFERENCE: ParameterKind.BYTES,
    DataType.DOMAIN: ParameterKind.BYTES,
}


FITTING: Mapping[ParameterKind, tuple[type, ...]] = {
    ParameterKind.INTEGER: (int,),
    ParameterKind.NUMBER: (int, float),
    ParameterKind.TEXT: (str,),
    ParameterKind.BYTES: (bytes,),
}


def kind_of(data_type: DataType) -> ParameterKind:
    return _KINDS.get(data_type, ParameterKind.INTEGER)


def range_of(found: EdsEntry) -> tuple[float | None, float | None]:
    """The file's limits within those of the type. Raises ProtocolError for limits that exclude every value."""
    kind = found.entry.type
    if kind_of(kind) is not ParameterKind.INTEGER:
        return found.low, found.high
    least, most = kind.range
    low = least if found.low is None else max(least, found.low)
    high = most if found.high is None else min(most, found.high)
    if low > high:
        raise ProtocolError(f"{found.entry}: its limits {low:g} to {high:g} leave nothing")
    return low, high
