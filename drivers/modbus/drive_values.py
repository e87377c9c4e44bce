"""A drive's registers converted to quantities of its axis: state, motor counts, load mm, percent. No I/O.

Registers in rev and rpm are of the motor's shaft. `AxisScaling` alone turns motor counts into load mm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.drive import DriveState
from drivers.errors import InputError, ProtocolError
from drivers.modbus.codec import Raw
from drivers.modbus.commands import Commands
from drivers.modbus.drive_map import DriveMap
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.modbus.register_map import Register
from drivers.scaling import AxisScaling, beyond_reach

_PER_REV = {"rev": 1.0, "rpm": 1.0 / 60.0, "rev/s": 1.0, "rpm/s": 1.0 / 60.0, "rev/s2": 1.0}
_COUNTS = ("counts", "counts/s", "counts/s2")
_RAMP_RPM = {"ms/1000rpm": 1000.0, "ms/3000rpm": 3000.0}
"""Units of a ramp by its time, ms from standstill to this speed: the inverse of an acceleration."""


def counts_per_unit(register: Register, counts_per_motor_rev: int) -> float:
    """Motor counts (per s, per s²) in one unit of the register. Raises InputError for a unit that is neither counts nor
    revolutions."""
    if register.unit in _COUNTS:
        return 1.0
    if register.unit in _PER_REV:
        return _PER_REV[register.unit] * counts_per_motor_rev
    raise InputError(f"register {register.name} is in {register.unit or 'no unit'}, expected counts or revolutions")


def to_counts(raw: Raw, register: Register, counts_per_motor_rev: int) -> float:
    """A register's raw value -> motor counts (per s, per s²); exact for counts without a scale. Raises InputError for a text."""
    value = register.value_of(raw)
    if isinstance(value, str):
        raise InputError(f"register {register.name} holds {value!r}, expected a number")
    if register.unit in _RAMP_RPM:
        rpm_s = _RAMP_RPM[register.unit] / (max(value, 1.0) / 1000.0)  # 0 ms stands for less than the least
        return rpm_s / 60.0 * counts_per_motor_rev
    factor = counts_per_unit(register, counts_per_motor_rev)
    return value if factor == 1.0 else value * factor


def from_counts(counts: float, register: Register, counts_per_motor_rev: int) -> Raw:
    """Motor counts (per s, per s²) -> the raw value; a ramp by its time is rounded to the gentler side, within the register's limits.

    Raises InputError outside the register's limits."""
    if register.unit in _RAMP_RPM:
        rpm_s = max(counts * 60.0 / counts_per_motor_rev, 1e-6)
        least, most = register.bounds
        ramp_ms = math.ceil(1000.0 * _RAMP_RPM[register.unit] / rpm_s)
        return register.raw_of(min(max(ramp_ms, least or 1.0), math.inf if most is None else most))
    factor = counts_per_unit(register, counts_per_motor_rev)
    return register.raw_of(counts if factor == 1.0 else counts / factor)


def to_percent(raw: Raw, register: Register) -> float:
    """A torque register's raw value -> percent of rated torque. Raises InputError for another unit."""
    value = register.value_of(raw)
    if isinstance(value, str) or register.unit not in ("percent", "permille"):
        raise InputError(f"register {register.name} is in {register.unit or 'no unit'}, expected percent or permille")
    return value / 10.0 if register.unit == "permille" else float(value)


class DriveValues:
    """Conversion by the drive's map and the axis's scaling. raw: values by register name, at least of those that are used."""

    def __init__(self, drive_name: str, drive_map: DriveMap, scaling: AxisScaling) -> None:
        self._name = drive_name
        self._map = drive_map
        self._registers = drive_map.registers
        self._scaling = scaling

    def state(self, raw: dict[str, Raw]) -> DriveState:
        """As `DriveMap.state_of`. Raises ProtocolError where no rule fits."""
        state = self._map.state_of(raw)
        if state is not DriveState.UNKNOWN:
            return state
        shown = ", ".join(f"{name} {whole(raw[name], name):#x}" for name in self._map.state_registers)
        raise ProtocolError(f"drive {self._name}: {shown} is no state that its register map knows")

    def counts(self, value: Raw, name: str) -> float:
        """A raw value -> motor counts (per s, per s²). Raises InputError for a text."""
        return to_counts(value, self._registers[name], self._scaling.encoder_counts_per_motor_rev)

    def raw(self, counts: float, name: str) -> Raw:
        """Motor counts (per s, per s²) -> the raw value. Raises InputError outside the register's limits."""
        return from_counts(counts, self._registers[name], self._scaling.encoder_counts_per_motor_rev)

    def raw_speed(self, counts: float, name: str) -> Raw:
        """As `raw`, for a velocity or ramp above 0: at least one step, as one rounded to 0 would never arrive."""
        register = self._registers[name]
        if register.unit in _RAMP_RPM:
            return self.raw(counts, name)
        step = to_counts(1, register, self._scaling.encoder_counts_per_motor_rev)
        return self.raw(counts if register.layout.type.is_float else max(counts, step), name)

    def position_counts(self, raw: Mapping[str, Raw]) -> float:
        return self.counts(raw[self._map.position], self._map.position)

    def check_held(self, ends_mm: Sequence[float]) -> None:
        """Raise InputError for an end of the travel, load mm, that the registers of position and absolute target cannot hold."""
        for name in (self._map.position, *(() if self._map.move.relative else (self._map.move.target,))):
            register = self._registers[name]
            per = counts_per_unit(register, self._scaling.encoder_counts_per_motor_rev)
            low, high = register.bounds
            ends = (-math.inf if low is None else low * per, math.inf if high is None else high * per)
            held = sorted(map(self._scaling.load_mm, ends))
            for end_mm in ends_mm:
                if not held[0] <= end_mm <= held[1]:
                    raise InputError(
                        f"drive {self._name}: an end of its travel is {end_mm:g} mm: {beyond_reach(*held)} ({name})"
                    )

    def load_mm(self, raw: Mapping[str, Raw], name: str | None) -> float | None:
        """A position or velocity of the load, mm or mm/s; None for a register that the drive does not have."""
        return None if name is None else self._scaling.load_mm(self.counts(raw[name], name))

    def torque_percent(self, raw: Mapping[str, Raw]) -> float | None:
        """Percent of rated torque, in the load's direction; None where the drive has no such register."""
        name = self._map.torque
        return None if name is None else self._scaling.direction * to_percent(raw[name], self._registers[name])

    def fault_code(self, raw: Mapping[str, Raw]) -> int | None:
        """The fault code, None while there is none."""
        name = self._map.fault_code
        return None if name is None else whole(raw[name], name) or None

    def window_counts(self) -> float:
        """Largest distance from a move's target at which the drive's "in position" counts, motor counts; 0 where the map has none."""
        window = self._map.move.window or 0.0
        in_counts = self._registers[self._map.move.target].unit == "counts"
        return window if in_counts else window * self._scaling.encoder_counts_per_motor_rev


@dataclass(frozen=True)
class Unit:
    """What the parts of one drive work with: its name, its map, its registers, their values, its commands."""

    name: str
    map: DriveMap
    access: RegisterAccess
    values: DriveValues
    commands: Commands
    clock: Clock
    scaling: AxisScaling
