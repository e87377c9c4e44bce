"""A Modbus drive's parameters as raw bytes: its registers by the names of its map, their words high byte first.

Reads are grouped for the wire, writes of neighbours go together, each write to an EEPROM is counted. A line carries one request at a
time: drives on one line take turns.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import TypeVar

from drivers.clock import NS_PER_S, Clock
from drivers.drive import DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    InputError,
    MotionTimeoutError,
    ProtocolError,
    StateError,
)
from drivers.modbus.codec import OrderMatch, RegisterType, decode, encode, probe_order
from drivers.modbus.commands import comes_true
from drivers.modbus.drive_map import DriveMap, Ratio, all_hold
from drivers.modbus.endpoint import RtuEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.plan import ReadRequest, WireCost, group_writes
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import Memory, Register
from drivers.modbus.wear import WearLedger
from drivers.parameters import ParameterInfo, ParameterKind, ParameterValue
from drivers.raw_parameters import (
    DriveIdentity,
    Line,
    Pause,
    RawForm,
    RawParameter,
    RawParameters,
    Steps,
    WireTime,
)
from drivers.scaling import ReportedScaling

T = TypeVar("T")
_SPARE_WRITES = 2  # of a register's wear budget: a value written may have to be put back


class ModbusLine(Line):
    """A Modbus line, serial or TCP: one request at a time, so drives are served one after the other, the next one during a pause."""

    def __init__(self, link: ModbusLink) -> None:
        self.link = link

    def run(self, jobs: Sequence[Steps[T]]) -> list[T | BridgeError]:
        """One job after the other. Raises StateError for a step of another kind of line."""
        results: dict[int, T | BridgeError] = {}
        clock = self.link.clock
        due_ns = dict.fromkeys(range(len(jobs)), clock.now_ns())
        while due_ns:
            number = min(due_ns, key=lambda number: due_ns[number])
            clock.sleep_until_ns(due_ns[number])
            try:
                pause = next(jobs[number])
            except StopIteration as stop:
                results[number] = stop.value
                del due_ns[number]
            except BridgeError as error:
                results[number] = error
                del due_ns[number]
            else:
                if not isinstance(pause, Pause):
                    raise StateError("work for another kind of line")
                due_ns[number] = clock.now_ns() + round(pause.duration_s * NS_PER_S)
        return [results[number] for number in range(len(jobs))]


class ModbusRawParameters(RawParameters):
    """The parameters of one unit, by its register map. access: of an open drive; None makes one."""

    def __init__(
        self,
        name: str,
        line: ModbusLine,
        unit: int,
        drive_map: DriveMap,
        *,
        wear: WearLedger | None = None,
        access: RegisterAccess | None = None,
    ) -> None:
        self.name = name
        self.line: ModbusLine = line
        self.clock: Clock = line.link.clock
        self.map = drive_map
        self.wear = wear or WearLedger()
        self.path = drive_map.registers.path
        self.access = access or RegisterAccess(line.link, unit, drive_map.registers)
        moving = drive_map.moving()
        self._entries = {
            each.name: _parameter(each, each.name in moving)
            for each in drive_map.registers.registers.values()
            if each.readable
        }

    # -- description -----------------------------------------------------------------------------------------------------
    @property
    def entries(self) -> Mapping[str, RawParameter]:
        return self._entries

    def _register(self, entry: RawParameter) -> Register:
        return self.map.registers[entry.address]

    def encode(self, entry: RawParameter, value: ParameterValue) -> bytes:
        """A value in its unit -> the bytes of its registers, high byte first. Raises InputError."""
        if isinstance(value, bytes):
            raise InputError(f"{value!r} is no {entry.info.kind.value}")
        return _bytes(self._register(entry).encode(value))

    def decode(self, entry: RawParameter, data: bytes) -> ParameterValue:
        return self._register(entry).decode(_words(data))

    def from_raw(self, entry: RawParameter, raw: RawForm) -> bytes:
        """A raw value -> the bytes of its registers. Raises InputError."""
        layout = self._register(entry).layout
        if isinstance(raw, int):
            if not layout.type.is_integer:
                raise InputError(f"raw is {raw}, expected hexadecimal digits for a {entry.type}")
            return _bytes(encode(raw, layout))
        try:
            data = bytes.fromhex(raw)
        except ValueError as error:
            raise InputError(f"raw is {raw!r}, expected hexadecimal digits") from error
        if len(data) != 2 * layout.words:
            raise InputError(
                f"raw is {len(data)} bytes, a {entry.type} of {layout.words} registers has {2 * layout.words}"
            )
        return data

    def to_raw(self, entry: RawParameter, data: bytes) -> RawForm:
        layout = self._register(entry).layout
        if layout.type.is_integer:
            return int(decode(_words(data), layout))
        return data.hex()

    def objection(self, entry: RawParameter, data: bytes) -> str | None:
        why = super().objection(entry, data)
        register = self._register(entry)
        if why is not None or register.memory is not Memory.EEPROM:
            return why
        left = register.wear_budget - self.wear.writes(self.name, register.name)
        if left >= _SPARE_WRITES:
            return None
        return (
            f"is kept in EEPROM and its budget has {max(0, left)} writes left, expected {_SPARE_WRITES};"
            " raise wear_budget in the register map if this is meant"
        )

    def cost(self, reads: Sequence[tuple[str, bytes]], writes: Sequence[tuple[str, bytes]]) -> WireTime:
        """By the groups in which it would be done."""
        endpoint = self.line.link.endpoint
        cost = WireCost.rtu(endpoint.baud, 0.0) if isinstance(endpoint, RtuEndpoint) else WireCost.tcp(0.0)
        seconds = [cost.read_s(each.table, each.span.count) for each in self._plan([address for address, _ in reads])]
        places = [self.map.registers[address].place for address, _ in writes]
        for group in group_writes(places, max_registers=self.map.registers.max_write):
            table, first = places[group[0]]
            seconds.append(cost.write_s(table, places[group[-1]][1].end - first.start))
        return WireTime(2 * len(seconds), sum(seconds), len(seconds))

    # -- on the wire -----------------------------------------------------------------------------------------------------
    def _plan(self, names: Sequence[str]) -> Sequence[ReadRequest]:
        return self.access.plan(tuple(names)).requests if names else ()

    def identify(self) -> Steps[DriveIdentity]:
        """The map's name, and the texts that the drive shows and that cannot be written."""
        yield from ()
        plates = [
            each.name
            for each in self.map.registers.registers.values()
            if each.layout.type is RegisterType.STRING and each.readable and not each.writable
        ]
        texts = {name: str(text) for name, text in self.access.read(plates).items()} if plates else {}
        return DriveIdentity("modbus", {"register_map": self.map.registers.name, **texts})

    def state(self) -> Steps[DriveState]:
        yield from ()
        return self.map.state_of(self.access.integers(self.map.state_registers))

    def _read_groups(self, addresses: Sequence[str]) -> Iterable[Sequence[str]]:
        left = dict.fromkeys(addresses)
        for request in self._plan(addresses):
            inside = [address for address in left if self._covers(request, self.map.registers[address])]
            left = dict.fromkeys(address for address in left if address not in inside)
            if inside:
                yield inside

    @staticmethod
    def _covers(request: ReadRequest, register: Register) -> bool:
        return request.table is register.table and request.span.covers(register.span)

    def _read_group(self, addresses: Sequence[str]) -> Steps[Sequence[bytes]]:
        yield from ()
        words = self.access.words(addresses)
        return [_bytes(words[address]) for address in addresses]

    def _write_groups(self, items: Sequence[tuple[str, bytes]]) -> Iterable[Sequence[tuple[str, bytes]]]:
        places = [self.map.registers[address].place for address, _ in items]
        groups = group_writes(places, max_registers=self.map.registers.max_write)
        return [[items[index] for index in group] for group in groups]

    def _write_group(self, items: Sequence[tuple[str, bytes]]) -> Steps[None]:
        yield from ()
        for address, _ in items:
            register = self.map.registers[address]
            if register.memory is Memory.EEPROM:
                self.wear.charge(self.name, address, register.wear_budget)
        self.access.write_words({address: _words(data) for address, data in items})

    # -- storing and restoring ---------------------------------------------------------------------------------------------
    def objection_to_store(self) -> Steps[str | None]:
        yield from ()
        return None if self.map.store is not None else "its register map has no command to store parameters"

    def store(self) -> Steps[None]:
        """By the map's commands; waits until it is done. Raises CapabilityError where the map has none, StateError while enabled,
        MotionTimeoutError when it does not end."""
        store = self.map.store
        if store is None:
            raise CapabilityError(f"drive {self.name}: its register map has no command to store parameters")
        if (yield from self.state()) is DriveState.ENABLED:
            raise StateError(f"drive {self.name} is enabled; disable it before storing parameters")
        for write in store.writes:
            self.access.command(write)
        if not comes_true(
            lambda: all_hold(store.done, self.access.of_conditions(store.done)), store.timeout_s, self.clock
        ):
            raise MotionTimeoutError(f"drive {self.name}: storing not over within {store.timeout_s:g} s")

    def load_defaults(self) -> Steps[None]:
        """Raises CapabilityError: register maps have no such command."""
        yield from ()
        raise CapabilityError(f"drive {self.name}: its register map has no command to load defaults")

    def restart(self) -> Steps[None]:
        """Raises CapabilityError: only its supply restarts such a drive."""
        yield from ()
        raise CapabilityError(f"drive {self.name}: only switching its supply restarts it")

    # -- the drive's own units, and the order of its words -------------------------------------------------------------------
    def reported_scaling(self) -> ReportedScaling:
        """The drive's own units, exact fractions. Raises ProtocolError for a divisor of 0."""
        scaling = self.map.scaling
        return ReportedScaling(
            self._ratio(scaling.encoder_counts_per_motor_rev),
            self._ratio(scaling.motor_revs_per_shaft_rev),
            self._ratio(scaling.feed_mm_per_shaft_rev),
        )

    def unit_parameters(self) -> dict[str, int | float]:
        """The registers of the drive's own units, by name and in their unit."""
        scaling = self.map.scaling
        ratios = (scaling.encoder_counts_per_motor_rev, scaling.motor_revs_per_shaft_rev, scaling.feed_mm_per_shaft_rev)
        named = [name for ratio in ratios if ratio is not None for name in (ratio.register, ratio.per)]
        names = tuple(dict.fromkeys(name for name in named if name is not None))
        values = self.access.read(names) if names else {}
        units = {name: self.map.registers[name].value_of(raw) for name, raw in values.items()}
        return {name: value for name, value in units.items() if isinstance(value, int | float)}

    def _ratio(self, ratio: Ratio | None) -> Fraction | None:
        if ratio is None or ratio.register is None:
            return None if ratio is None else ratio.constant
        above = ratio.times * self._exact(ratio.register)
        below = Fraction(1) if ratio.per is None else self._exact(ratio.per)
        if below == 0:
            raise ProtocolError(f"drive {self.name}: {ratio.per} is 0, {ratio.register} is to be divided by it")
        return above / below

    def _exact(self, name: str) -> Fraction:
        register = self.map.registers[name]
        raw = self.access.read((name,))[name]
        return Fraction(str(raw)) * Fraction(str(register.scale)) + Fraction(str(register.offset))

    def probe_order(self, name: str, known_value: float, *, tolerance: float = 0.0) -> tuple[OrderMatch, ...]:
        """Every type and order by which the registers at and around `name` hold the value that the drive's own display shows.

        known_value and tolerance in the register's unit; offset 0 of a match is the mapped address, ±1 a base that is off by one.
        """
        register = self.map.registers[name]
        try:
            before, words = self.access.neighbourhood(name, 1)
        except AbortError:
            before, words = self.access.neighbourhood(name, 0)  # no such neighbours
        matches = probe_order(words, known_value - register.offset, scale=register.scale, tolerance=tolerance)
        return tuple(
            OrderMatch(match.offset - before, match.layout, match.value + register.offset) for match in matches
        )


def kind_of(register: Register) -> ParameterKind:
    """The kind of a register's value; a whole number that has a scale is a number."""
    if register.layout.type is RegisterType.STRING:
        return ParameterKind.TEXT
    plain = register.layout.type.is_integer and register.scale == 1.0 and register.offset == 0.0
    return ParameterKind.INTEGER if plain else ParameterKind.NUMBER


def _parameter(register: Register, moving: bool) -> RawParameter:
    low, high = register.bounds
    refusal = None
    if not register.writable:
        refusal = "is read only"
    elif moving or register.self_clearing:
        refusal = "is a command, a target or written as a whole, and no parameter"
    wears = register.memory is Memory.EEPROM
    info = ParameterInfo(
        register.name, kind_of(register), register.unit, low, high, refusal is None, wears, register.description
    )
    return RawParameter(register.name, info, register.layout.type.value, refusal)


def _bytes(words: Sequence[int]) -> bytes:
    return struct.pack(f">{len(words)}H", *words)


def _words(data: bytes) -> tuple[int, ...]:
    if len(data) % 2:
        raise ProtocolError(f"{len(data)} bytes are no registers")
    return struct.unpack(f">{len(data) // 2}H", data)
