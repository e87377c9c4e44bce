"""A CiA-402 drive's parameters by name: standard objects under names of their own, those of an EDS as "2100h:01".

Checked before they are written, read back after. Objects that move the axis are no parameters: targets, modes and the controlword are
refused, because some drives keep them through a store and a restore (`not_parameters`). Whole sets are in `raw_parameters`.
"""

from __future__ import annotations

from collections.abc import Mapping

from drivers.canopen import cia301
from drivers.canopen.eds import EdsEntry, EdsFile, Key
from drivers.canopen.node import Node
from drivers.canopen.not_parameters import why_not_written
from drivers.canopen.sdo import most_bytes
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.cia402.wire import OBJECT_MISSING
from drivers.errors import AbortError, CapabilityError, InputError, ProtocolError
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
        self._node = node
        self._motion = motion
        file, self._entries, self._units = known_objects(node.eds)
        self._path = file.path
        self._present: tuple[str, ...] | None = tuple(self._entries) if node.eds is not None else None
        self._found: dict[Key, ParameterValue] = {}  # as first read: never out of range when it is put back

    @property
    def names(self) -> tuple[str, ...]:
        if self._present is None:
            self._present = tuple(name for name in self._entries if self._answers(name))
        return self._present

    def _answers(self, name: str) -> bool:
        try:
            self.read(name)
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
            why_not_written(found, self._node.table) is None,
            description=str(found.entry),
        )

    def read(self, name: str) -> ParameterValue:
        entry = self._find(name).entry
        value = entry.unpack(self._shown(entry))
        self._found.setdefault(entry.key, value)
        return value

    def write(self, name: str, value: ParameterValue) -> bool:
        """As `DriveParameters.write`; raises InputError for a value of another kind too. A value that the drive was found with may lie
        outside the limits."""
        found = self._find(name)
        entry, kind = found.entry, kind_of(found.entry.type)
        refusal = why_not_written(found, self._node.table)
        if refusal is not None:
            raise CapabilityError(f"drive {self._node.name}: {refusal}")
        if not isinstance(value, FITTING[kind]):
            raise InputError(f"{entry}: {value!r} is no {kind.value}")
        present = self.read(name)
        data = entry.pack(value)
        what = self.describe(name).outside(value) if isinstance(value, int | float) else None
        if what is not None and value != self._found[entry.key]:
            raise InputError(f"{entry}: {what}", path=self._path)
        if present == value:
            return False
        self._node.sdo.write_bytes(entry.index, entry.subindex, data, same=entry.same)
        kept = self._shown(entry)
        if not entry.same(kept, data):
            raise ProtocolError(
                f"drive {self._node.name}: {entry} was written {value!r}, it reads back {entry.unpack(kept)!r}"
            )
        return True

    def _shown(self, entry: Entry) -> bytes:
        return self._node.sdo.read_bytes(entry.index, entry.subindex, most=most_bytes(entry))

    def _find(self, name: str) -> EdsEntry:
        found = self._entries.get(name)
        if found is None:
            raise InputError(f"drive {self._node.name} has no parameter {name!r}")
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
