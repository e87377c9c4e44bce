"""A CiA-402 drive's parameters by name: standard objects under names of their own, those of an EDS as "2100h:01".

Maps names to objects and units. `parameters` checks, refuses, and proves writes by reading back.
"""

from __future__ import annotations

from collections.abc import Mapping

from drivers.canopen import cia301
from drivers.canopen.eds import EdsEntry, EdsFile
from drivers.canopen.node import Node
from drivers.canopen.parameters import CanOpenParameters
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.cia402.wire import OBJECT_MISSING
from drivers.errors import AbortError, InputError, ProtocolError
from drivers.parameters import DriveParameters, ParameterInfo, ParameterKind, ParameterValue
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


def _name(entry: Entry) -> str:
    return entry.name.replace(" ", "_").replace("-", "_").lower()


def known_objects(eds: EdsFile | None) -> tuple[EdsFile, dict[str, EdsEntry], dict[str, str]]:
    """The drive's known objects, by name, and their units as `unit_text` takes them. An EDS takes precedence over the standard."""
    entries: dict[tuple[int, int], EdsEntry] = dict(eds.entries) if eds is not None else {}
    names: dict[str, EdsEntry] = {}
    units: dict[str, str] = {}
    standard = set()
    for entry, unit, writable in _STANDARD:
        key = entry.index, entry.subindex
        if eds is None:
            entries[key] = EdsEntry(entry, "rw" if writable else "ro", None, None, None, None, False)
        if key in entries:
            names[_name(entry)] = entries[key]
            units[_name(entry)] = unit
            standard.add(key)
    for key, found in sorted(entries.items()):
        if key not in standard and found.readable and found.entry.type is not DataType.DOMAIN:
            names[f"{key[0]:04X}h:{key[1]:02X}"] = found
    path = "CiA-402" if eds is None else eds.path
    return EdsFile(path, entries, ()), names, units


def unit_text(unit: str, motion: MotionScaling | None) -> str:
    """A unit of `known_objects` as text. motion: the drive's own units of velocity and acceleration; "" where they are not known."""
    if unit not in (VELOCITY, ACCELERATION):
        return unit
    if motion is None or motion.ambiguous:
        return ""
    return motion.velocity.text if unit == VELOCITY else motion.acceleration.text


class NamedParameters(DriveParameters):
    """Parameters of one open drive. Without an EDS only the standard's objects that the drive answers, without limits.

    motion: its own units of velocity and acceleration."""

    def __init__(self, node: Node, motion: MotionScaling) -> None:
        self._name = node.name
        self._motion = motion
        file, self._entries, self._units = known_objects(node.eds)
        self._access = CanOpenParameters(node, file)
        self._present: tuple[str, ...] | None = tuple(self._entries) if node.eds is not None else None

    @property
    def names(self) -> tuple[str, ...]:
        if self._present is None:
            self._present = tuple(name for name in self._entries if self._answers(name))
        return self._present

    def _answers(self, name: str) -> bool:
        try:
            self._access.read(self._entries[name])
        except AbortError as error:
            if error.code in OBJECT_MISSING:
                return False
            raise
        return True

    def describe(self, name: str) -> ParameterInfo:
        found = self._find(name)
        low, high = range_of(found)
        return ParameterInfo(
            name,
            kind_of(found.entry.type),
            unit_text(self._units.get(name, ""), self._motion),
            low,
            high,
            self._access.refusal(found) is None,
            description=str(found.entry),
        )

    def read(self, name: str) -> ParameterValue:
        return self._access.read(self._find(name)).value

    def write(self, name: str, value: ParameterValue) -> bool:
        """As `DriveParameters.write`; raises InputError for a value of another kind too."""
        found = self._find(name)
        kind = kind_of(found.entry.type)
        present: ParameterValue | None = None
        if self._access.refusal(found) is None:
            if not isinstance(value, FITTING[kind]):
                raise InputError(f"{found.entry}: {value!r} is no {kind.value}")
            present = self._access.read(found).value
        self._access.check(found, value)
        if present == value:
            return False
        self._access.write(found, value)
        return True

    def _find(self, name: str) -> EdsEntry:
        found = self._entries.get(name)
        if found is None:
            raise InputError(f"drive {self._name} has no parameter {name!r}")
        return found


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
    """The kind of a value of this type."""
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
