"""A Modbus drive's parameters by name: checked before they are written, read back after, with few writes to its EEPROM.

Registers that move the axis are no parameters: those of commands, targets and modes are refused here.
"""

from __future__ import annotations

from fractions import Fraction

from drivers.clock import Clock
from drivers.drive import DriveState
from drivers.errors import AbortError, CapabilityError, InputError, MotionTimeoutError, ProtocolError, StateError
from drivers.modbus.codec import OrderMatch, Raw, RegisterType, decode, encode, probe_order
from drivers.modbus.drive_map import DriveMap, Ratio, all_hold
from drivers.modbus.orders import comes_true
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import Memory, Register, Value
from drivers.modbus.wear import WearLedger
from drivers.parameters import DriveParameters, ParameterInfo, ParameterKind, ParameterValue
from drivers.scaling import ReportedScaling


def kind_of(register: Register) -> ParameterKind:
    """The kind of a register's value; a whole number that has a scale is a number."""
    if register.layout.type is RegisterType.STRING:
        return ParameterKind.TEXT
    plain = register.layout.type.is_integer and register.scale == 1.0 and register.offset == 0.0
    return ParameterKind.INTEGER if plain else ParameterKind.NUMBER


_SETTLE_S = 0.5  # longest time until a drive shows a parameter that it has saved, s
_POLL_S = 0.02


class ModbusParameters(DriveParameters):
    """Parameter access of one drive."""

    def __init__(self, drive: str, drive_map: DriveMap, access: RegisterAccess, clock: Clock, wear: WearLedger) -> None:
        self._drive = drive
        self._map = drive_map
        self._access = access
        self._clock = clock
        self.wear = wear
        self._found: dict[str, Raw] = {}  # by name, as before the first write: never out of range when it is put back

    @property
    def names(self) -> tuple[str, ...]:
        """All registers that can be read."""
        return tuple(name for name, register in self._access.registers.registers.items() if register.readable)

    @property
    def writable_names(self) -> tuple[str, ...]:
        """Names of the registers that the user may change."""
        moving = self._map.moving()
        return tuple(
            name
            for name, register in self._access.registers.registers.items()
            if register.readable and register.writable and name not in moving
        )

    def register(self, name: str) -> Register:
        """A register of the map. Raises InputError for a name that the map does not have."""
        return self._access.registers[name]

    def describe(self, name: str) -> ParameterInfo:
        register = self._access.registers[name]
        low, high = register.bounds
        return ParameterInfo(
            name,
            kind_of(register),
            register.unit,
            low,
            high,
            name in self.writable_names,
            register.memory is Memory.EEPROM,
            register.description,
        )

    def read(self, name: str) -> Value:
        """One parameter in its unit. Raises InputError for a name that the map does not have, and as `ModbusLink.read`."""
        return self.read_many((name,))[name]

    def read_many(self, names: tuple[str, ...]) -> dict[str, Value]:
        """Several parameters, read in as few requests as the wire allows. Raises as `read`."""
        return {name: self._access.registers[name].value_of(raw) for name, raw in self._access.read(names).items()}

    def write(self, name: str, value: ParameterValue) -> bool:
        """Write one parameter and read it back; False when the drive held the value already and nothing was written.

        Raises InputError outside the map's limits, unless the drive was found with the value, or for an unknown name, CapabilityError
        for one that is read only or moves the axis, StateError when its EEPROM budget is used up, AbortError when the drive refuses,
        ProtocolError when it accepted the value but shows another.
        """
        register = self._access.registers[name]
        if name in self._map.moving():
            raise CapabilityError(f"drive {self._drive}: {name} moves the axis and is no parameter")
        if name not in self.writable_names:
            raise CapabilityError(f"drive {self._drive}: {name} cannot be written and read back")
        if isinstance(value, bytes):
            raise InputError(f"{name} cannot be {value!r}, expected {kind_of(register).value}")
        present = self._access.words((name,))[name]
        found = self._found.setdefault(name, decode(present, register.layout))
        raw = found if register.value_of(found) == value else register.raw_of(value)
        words = encode(raw, register.layout)
        if present == words:
            return False
        if register.memory is Memory.EEPROM:
            self.wear.charge(self._drive, name, register.wear_budget)
        try:
            self._access.write({name: raw})
        except AbortError as error:
            raise AbortError(f"drive {self._drive} refuses {name} = {value}: {error}", error.code) from error
        self._prove(name, words)
        return True

    def _prove(self, name: str, words: tuple[int, ...]) -> None:
        deadline = self._clock.deadline(_SETTLE_S)
        while (seen := self._access.words((name,))[name]) != words:
            if deadline.expired:
                layout = self._access.registers[name].layout
                raise ProtocolError(
                    f"drive {self._drive}: {name} was written as {decode(words, layout)!r}"
                    f" and reads {decode(seen, layout)!r} (raw)"
                )
            self._clock.sleep_s(_POLL_S)

    def store(self, state: DriveState) -> None:
        """Have the drive save its parameters for the next power-up; `state` is its present one.

        Raises CapabilityError when the map has no such command, StateError while enabled, MotionTimeoutError when it does not end.
        """
        store = self._map.store
        if store is None:
            raise CapabilityError(f"drive {self._drive}: its register map has no command to store parameters")
        if state is DriveState.ENABLED:
            raise StateError(f"drive {self._drive} is enabled; disable it before storing parameters")
        for write in store.writes:
            self._access.command(write)
        if not comes_true(
            lambda: all_hold(store.done, self._access.of_conditions(store.done)), store.timeout_s, self._clock
        ):
            raise MotionTimeoutError(f"drive {self._drive}: storing not over within {store.timeout_s:g} s")

    def reported_scaling(self) -> ReportedScaling:
        """The drive's own units, exact fractions. Raises ProtocolError for a divisor of 0."""
        scaling = self._map.scaling
        return ReportedScaling(
            self._ratio(scaling.encoder_counts_per_motor_rev),
            self._ratio(scaling.motor_revs_per_shaft_rev),
            self._ratio(scaling.feed_mm_per_shaft_rev),
        )

    def unit_parameters(self) -> dict[str, int | float]:
        """The registers of the drive's own units, by name and in their unit."""
        scaling = self._map.scaling
        ratios = (scaling.encoder_counts_per_motor_rev, scaling.motor_revs_per_shaft_rev, scaling.feed_mm_per_shaft_rev)
        named = [name for ratio in ratios if ratio is not None for name in (ratio.register, ratio.per)]
        names = tuple(dict.fromkeys(name for name in named if name is not None))
        values = self.read_many(names) if names else {}
        return {name: value for name, value in values.items() if isinstance(value, int | float)}

    def _ratio(self, ratio: Ratio | None) -> Fraction | None:
        if ratio is None or ratio.register is None:
            return None if ratio is None else ratio.constant
        above = ratio.times * self._exact(ratio.register)
        below = Fraction(1) if ratio.per is None else self._exact(ratio.per)
        if below == 0:
            raise ProtocolError(f"drive {self._drive}: {ratio.per} is 0, {ratio.register} is to be divided by it")
        return above / below

    def _exact(self, name: str) -> Fraction:
        register = self._access.registers[name]
        raw = self._access.read((name,))[name]
        return Fraction(str(raw)) * Fraction(str(register.scale)) + Fraction(str(register.offset))

    def probe_order(self, name: str, known_value: float, *, tolerance: float = 0.0) -> tuple[OrderMatch, ...]:
        """Every type and order by which the registers at and around `name` hold the value that the drive's own display shows.

        known_value and tolerance in the register's unit; offset 0 of a match is the mapped address, ±1 a base that is off by one.
        """
        register = self._access.registers[name]
        try:
            before, words = self._access.neighbourhood(name, 1)
        except AbortError:
            before, words = self._access.neighbourhood(name, 0)  # no such neighbours
        matches = probe_order(words, known_value - register.offset, scale=register.scale, tolerance=tolerance)
        return tuple(
            OrderMatch(match.offset - before, match.layout, match.value + register.offset) for match in matches
        )
