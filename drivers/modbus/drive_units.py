"""Conversion between a map's units and motor counts: rev and rpm are of the motor's shaft.

Pure functions. `AxisScaling` alone turns motor counts into load mm; this module brings a drive's registers to motor counts.
"""

from __future__ import annotations

from drivers.errors import InputError
from drivers.modbus.codec import Raw
from drivers.modbus.register_map import Register

_PER_REV = {"rev": 1.0, "rpm": 1.0 / 60.0, "rev/s": 1.0, "rpm/s": 1.0 / 60.0, "rev/s2": 1.0}
_COUNTS = ("counts", "counts/s", "counts/s2")


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
    factor = counts_per_unit(register, counts_per_motor_rev)
    return value if factor == 1.0 else value * factor


def from_counts(counts: float, register: Register, counts_per_motor_rev: int) -> Raw:
    """Motor counts (per s, per s²) -> the raw value. Raises InputError outside the register's limits."""
    factor = counts_per_unit(register, counts_per_motor_rev)
    return register.raw_of(counts if factor == 1.0 else counts / factor)


def to_percent(raw: Raw, register: Register) -> float:
    """A torque register's raw value -> percent of rated torque. Raises InputError for another unit."""
    value = register.value_of(raw)
    if isinstance(value, str) or register.unit not in ("percent", "permille"):
        raise InputError(f"register {register.name} is in {register.unit or 'no unit'}, expected percent or permille")
    return value / 10.0 if register.unit == "permille" else float(value)
