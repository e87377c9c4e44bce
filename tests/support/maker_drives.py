"""Makers' Modbus drives as their notes describe them: registers and behaviour over the project's servo, under a foreign Modbus stack.

Written from register notes alone and apart from the maps in drivers/modbus/maps: addresses are numbers here, and no code is shared.
Each drive has the difficulties that its notes name: a trigger that is processed later, path data that take 100 ms, addresses that
swallow writes, functions that have to be assigned. `served` puts one behind pyModbusTCP on loopback, `served_on_a_line` behind umodbus
on a serial line; `MakerWire` passes requests without frames.
"""

from __future__ import annotations

import math
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import serial
from pyModbusTCP.constants import EXP_DATA_ADDRESS, EXP_DATA_VALUE, EXP_ILLEGAL_FUNCTION, EXP_NONE
from pyModbusTCP.server import DataHandler, ModbusServer
from support.serial_pair import serial_pair
from umodbus.client.serial.redundancy_check import CRCError, validate_crc
from umodbus.functions import (
    ReadHoldingRegisters,
    WriteMultipleRegisters,
    WriteSingleRegister,
    create_function_from_request_pdu,
)
from umodbus.server.serial import get_server
from umodbus.server.serial.rtu import RTUServer
from umodbus.utils import pack_exception_pdu

from drivers.errors import AbortError
from drivers.modbus.wire import Request
from sim_backends.clock import SimClock
from sim_backends.servo import MotionMode, ServoParameters, SimulatedServo

MS = 1_000_000
_SIZE = {"u16": 1, "i16": 1, "u32": 2, "i32": 2}
_LARGEST = max(_SIZE.values())


class Shaft:
    friction_permille = 10.0

    def step(self, motor_rev: float, dt_s: float) -> None: ...


@dataclass
class Row:
    """One value. kind: u16, i16, u32, i32; first: "high" or "low" word; read and wrote: what reading gives and writing does."""

    kind: str
    first: str
    value: int = 0
    low: int | None = None
    high: int | None = None
    read: Callable[[], int] | None = None
    wrote: Callable[[int, int], None] | None = None
    writable: bool = True
    written: list[int] = field(default_factory=list)

    def words(self) -> list[int]:
        value = self.value if self.read is None else self.read()
        if _SIZE[self.kind] == 1:
            return [value & 0xFFFF]
        halves = [value >> 16 & 0xFFFF, value & 0xFFFF]
        return halves if self.first == "high" else halves[::-1]

    def number(self, words: list[int]) -> int:
        bits = 16 * len(words)
        whole = (
            words[0]
            if bits == 16
            else (words[0] << 16 | words[1] if self.first == "high" else words[1] << 16 | words[0])
        )
        return whole - (1 << bits) if self.kind[0] == "i" and whole >> (bits - 1) else whole


class MakerDrive:
    """Memory and servo of one drive. `found` is its memory as it was before anybody wrote."""

    first = "high"  # word of a wide value
    counts_per_rev = 10_000
    start_counts = 12_345  # 0 would look alike in both word orders
    swallows = False  # addresses without a register read 0 and take writes
    single_writes = True
    objects = False  # an address is the number of an object
    asked: Callable[[], object] | None = None  # called before each request is handled

    def __init__(self, clock: SimClock, shaft: Any = None) -> None:
        cpr = self.counts_per_rev
        self.servo = SimulatedServo(
            Shaft() if shaft is None else shaft,
            ServoParameters(
                counts_per_rev=cpr,
                start_counts=float(self.start_counts),
                max_velocity_rev_s=50.0,
                max_acceleration_rev_s2=1000.0,
                following_window_counts=2.0 * cpr,
                position_window_counts=2.0,
                negative_limit_counts=-0.2 * cpr,
                positive_limit_counts=31.0 * cpr,
                negative_stop_counts=-1.0 * cpr,
                positive_stop_counts=32.0 * cpr,
                home_switch_counts=-0.1 * cpr,
            ),
        )
        self.rows: dict[int, Row] = {}
        self.now_ns = 0
        self.fastest_counts_s = 0.0
        self.lowest = self.highest = self.servo.position_actual_counts
        self.lock = threading.RLock()
        self.later: list[tuple[int, Callable[[], None]]] = []
        self.table()
        self.found = self.memory()
        clock.attach(self._advance, bearable=lambda _now: MS)

    # -- what a drive fills in -----------------------------------------------------------------------------------------
    def table(self) -> None:
        raise NotImplementedError

    def row(
        self,
        address: int,
        kind: str = "u16",
        value: int = 0,
        *,
        low: int | None = None,
        high: int | None = None,
        first: str = "",
        wrote: Callable[[int, int], None] | None = None,
    ) -> Row:
        """A register that keeps what is written."""
        self.rows[address] = Row(kind, first or self.first, value, low, high, wrote=wrote)
        return self.rows[address]

    def shown(self, address: int, kind: str, read: Callable[[], int], *, first: str = "") -> None:
        """A register that only shows."""
        self.rows[address] = Row(kind, first or self.first, read=read, writable=False)

    def __getitem__(self, address: int) -> int:
        return self.rows[address].value

    def rpm(self, rpm: float) -> float:
        return rpm * self.counts_per_rev / 60.0

    def ramp(self, ms: float, to_rpm: float = 1000.0) -> float:
        """A ramp given as the time to a speed -> counts/s²."""
        return self.rpm(to_rpm) / (max(ms, 1.0) / 1000.0)

    def after(self, seconds: float, act: Callable[[], None]) -> None:
        self.later.append((self.now_ns + round(seconds * 1e9), act))

    @property
    def in_position(self) -> bool:
        return self.servo.target_reached

    @property
    def homing(self) -> bool:
        servo = self.servo
        return servo.mode is MotionMode.HOMING and not servo.homed and not servo.homing_error

    def memory(self) -> dict[int, int]:
        """Everything that can be written, by address."""
        return {address: row.value for address, row in self.rows.items() if row.writable and row.read is None}

    # -- time ------------------------------------------------------------------------------------------------------------
    def _advance(self, now_ns: int, dt_s: float) -> None:
        with self.lock:
            self.now_ns = now_ns
            if self.later:
                due = [act for at_ns, act in self.later if at_ns <= now_ns]
                self.later = [each for each in self.later if each[0] > now_ns]
                for act in due:
                    act()
            servo = self.servo
            servo.advance(now_ns, dt_s)
            self.tick()
            if (speed := abs(servo.velocity_actual_counts_s)) > self.fastest_counts_s:
                self.fastest_counts_s = speed
            if not self.lowest <= (here := servo.position_actual_counts) <= self.highest:
                self.lowest, self.highest = min(self.lowest, here), max(self.highest, here)

    def tick(self) -> None: ...

    # -- requests ----------------------------------------------------------------------------------------------------------
    def read(self, address: int, count: int) -> list[int] | None:
        if self.asked is not None:
            self.asked()
        with self.lock:
            if self.objects:
                row = self.rows.get(address)
                return row.words() if row is not None and _SIZE[row.kind] == count else None
            words: dict[int, int] = {}
            for start in range(address - _LARGEST + 1, address + count):
                if (row := self.rows.get(start)) is not None:
                    words |= {start + at: word for at, word in enumerate(row.words())}
            return [words.get(at, 0) for at in range(address, address + count)]

    def write(self, address: int, words: list[int]) -> int:
        """0, or the exception's code."""
        if self.asked is not None:
            self.asked()
        with self.lock:
            at = 0
            while at < len(words):
                row = self.rows.get(address + at)
                if row is None:
                    if not self.swallows:
                        return int(EXP_DATA_ADDRESS)
                    at += 1
                    continue
                size = _SIZE[row.kind]
                if len(words) - at < size:
                    return int(EXP_DATA_VALUE)
                value = row.number(words[at : at + size])
                at += size
                if not row.writable:
                    if not self.swallows:
                        return int(EXP_DATA_ADDRESS)
                    continue
                if (row.low is not None and value < row.low) or (row.high is not None and value > row.high):
                    return int(EXP_DATA_VALUE)
                before, row.value = row.value, value
                row.written.append(value)
                if row.wrote is not None:
                    row.wrote(before, value)
            return 0


# -- the families ------------------------------------------------------------------------------------------------------------
class LeadshineEl7(MakerDrive):
    """Notes 1: PR path 0, trigger read back as a state, servo on by the function of DI1, jog that ends after 60 ms."""

    def table(self) -> None:
        self._order, self._deaf_until_ns, self._jogged_ns = 0, 0, -1
        self.row(0x0003, value=6)
        self.row(0x0011, value=self.counts_per_rev)
        self.row(0x0401, value=0x03, wrote=self._di1)
        self.row(0x0609, value=100)
        servo = self.servo
        self.shown(0x0B03, "u16", lambda: servo.fault_code & 0xFFF)
        self.shown(0x0B05, "u16", self._status)
        self.shown(0x0B07, "i16", lambda: round(servo.torque_actual_permille / 10))
        self.shown(0x0B09, "i16", lambda: round(servo.velocity_actual_counts_s * 60 / self.counts_per_rev))
        self.shown(0x0B0A, "u16", lambda: 325)
        self.shown(0x0B0B, "i16", lambda: 41)
        self.row(0x1801, wrote=self._control).read = lambda: 0
        self.row(0x6002, wrote=self._trigger).read = lambda: self._order
        self.row(0x600A, value=17)
        self.shown(0x602C, "i32", lambda: servo.position_actual_counts)
        self.row(0x6200, value=0)
        self.row(0x6201, "i32")
        self.row(0x6203, "i16", 60)
        self.row(0x6204, value=100, low=1, high=32767)
        self.row(0x6205, value=100, low=1, high=32767)

    def _status(self) -> int:
        servo = self.servo
        bits = (
            not servo.fault_code,
            servo.powered,
            bool(servo.fault_code),
            servo.homed,
            self.in_position and servo.powered,
        )
        return sum(bool(bit) << at for at, bit in enumerate(bits))

    def _di1(self, _: int, function: int) -> None:
        if function == 0x83:
            self._deaf_until_ns = self.now_ns + 650 * MS
            self.after(0.3, lambda: self.servo.power_on() if self[0x0401] == 0x83 else None)
        else:
            self.servo.power_off()

    def _control(self, _: int, order: int) -> None:
        if order == 0x1111:
            self.servo.reset_fault()
            if self._order == 0x40:
                self._order = 0
                self.servo.resume()
        elif order in (0x4001, 0x4002):
            self._jogged_ns = self.now_ns
            sign = 1 if order == 0x4001 else -1
            self.servo.move_velocity(sign * self.rpm(self[0x0609]), self.ramp(100))

    def _trigger(self, _: int, order: int) -> None:
        self._order = order
        if order == 0x40:
            self.servo.quick_stop(self.ramp(20))
        else:
            self.after(0.004, lambda: self._take(order))

    def _take(self, order: int) -> None:
        servo = self.servo
        if self._order != order or self.now_ns < self._deaf_until_ns or not servo.powered or self[0x0003] != 6:
            return
        if order == 0x10 and self[0x6200] in (1, 0x41):
            at = servo.position_demand_counts if self[0x6200] == 0x41 else 0
            servo.move_absolute(at + self[0x6201], self.rpm(self[0x6203]), self.ramp(self[0x6204]))
            self._order = 0x0100
        elif order == 0x20:
            servo.start_homing(self[0x600A], self.rpm(60), self.rpm(12), 0)
            self._order = 0x0100

    def tick(self) -> None:
        servo = self.servo
        if self._order == 0x0100 and (servo.target_reached or servo.homed) and not self.homing:
            self._order = 0
        if self._jogged_ns >= 0 and self.now_ns - self._jogged_ns > 60 * MS:
            self._jogged_ns = -1
            servo.move_velocity(0.0, self.ramp(100))


class DeltaAsdaA2(MakerDrive):
    """Notes 2: 32-bit slots low word first, PR#1 whose data take 100 ms, monitor chosen by P0-17, EEPROM unless P2-30 is 5."""

    first = "low"
    counts_per_rev = 100_000
    monitor = 0  # P0-17: what P0-09 shows

    def table(self) -> None:
        self.stored = 0
        self._pr, self._path = 20001, (0, 0)
        servo = self.servo
        for page, index, value in (
            (1, 1, 1), (1, 44, 128), (1, 45, 10), (2, 10, 0x101), (2, 30, 0), (3, 6, 0), (5, 4, 17), (0, 17, self.monitor),
            (5, 20, 200), (5, 60, 1000), (6, 2, 0x42),
        ):  # fmt: skip
            self.row(page * 0x100 + 2 * index, "u32", value, wrote=self._kept)
        self.row(0x0002, "u32", wrote=lambda _, value: servo.reset_fault() if value == 0 else None).read = lambda: (
            servo.fault_code & 0xFFF
        )
        self.shown(0x0012, "i32", lambda: servo.position_actual_counts if self[0x0022] == 0 else 60 * 4096)
        self.shown(0x005C, "u32", self._status)
        self.row(0x040E, "u32", wrote=lambda *_: self._input())
        self.row(0x050E, "u32", wrote=self._start).read = lambda: self._pr
        self.row(0x0606, "i32", wrote=lambda _, value: self.after(0.1, lambda: self._take_path(value)))
        self.rows[0x0604].wrote = self._kept

    def write(self, address: int, words: list[int]) -> int:
        """The low word of a slot may be written alone."""
        return super().write(address, [*words, 0] if len(words) == 1 else words)

    def _kept(self, _: int, __: int) -> None:
        self.stored += self[0x023C] not in (5,)
        self._input()

    def _take_path(self, value: int) -> None:
        self._path = (value, 0)

    def _status(self) -> int:
        servo = self.servo
        bits = (not servo.fault_code, servo.powered, servo.velocity_actual_counts_s == 0, False, self.in_position)
        return sum(bool(b) << at for at, b in enumerate((*bits, False, bool(servo.fault_code), False, servo.homed)))

    def _input(self) -> None:
        if 0x040E not in self.rows:
            return
        on = bool(self[0x030C] & 1 and self[0x040E] & 1 and self[0x0214] == 0x101)
        if on and not self.servo.powered:
            self.after(0.05, self.servo.power_on)
        elif not on and self.servo.powered:
            self.servo.power_off()

    def _start(self, _: int, order: int) -> None:
        servo = self.servo
        if order == 1000:
            servo.quick_stop(self.ramp(self[0x0528], 3000))
            self.after(0.2, servo.resume)
            self._pr = 1000
        elif order == 0 and servo.powered:
            servo.start_homing(self[0x0508], self.rpm(60), self.rpm(12), 0)
            self._pr = 0
        elif order == 1 and servo.powered and self[0x0102] & 0xF == 1:
            kind = self[0x0604]
            at = servo.position_demand_counts if kind & 0xC0 == 0x40 else 0
            if kind & 0xF == 2:
                servo.move_absolute(at + self._path[0], self.rpm(0.1 * self[0x0578]), self.ramp(self[0x0528], 3000))
                self._pr = 1

    def tick(self) -> None:
        servo = self.servo
        if self._pr in (0, 1) and not self.homing and servo.target_reached:
            self._pr += 20000


class Akd2g(MakerDrive):
    """Notes 3: user-defined map of two registers per entry, function 16 only, empty addresses swallow writes. 360000 counts a turn are
    the thousandths of a degree of PL.FB."""

    counts_per_rev = 360_000
    swallows = True
    single_writes = False
    mapped = True  # whether the user has typed the four MODBUS.MAP lines

    def table(self) -> None:
        servo = self.servo
        self._moving = False
        self.shown(0, "i32", lambda: servo.position_actual_counts)
        self.shown(2, "i32", lambda: round(servo.velocity_actual_counts_s * 60_000 / self.counts_per_rev))
        self.shown(4, "u32", lambda: servo.powered)
        self.shown(6, "u32", self._motion_status)
        self.shown(8, "u32", lambda: 0 if servo.powered else 1)
        self.shown(10, "u32", lambda: bool(servo.fault_code))
        self.row(22, "u32", wrote=self._action(self._move))
        self.row(24, "u32", 1_000_000)
        self.row(26, "u32", 1_000_000)
        self.row(28, "u32", 60_000)
        self.row(30, "i32")
        self.row(32, "u32", 0)
        if self.mapped:
            self.row(200, "u32", wrote=self._action(servo.power_on))
            self.row(202, "u32", wrote=self._action(servo.power_off))
            self.row(204, "u32", wrote=self._action(servo.reset_fault))
            self.row(206, "u32", wrote=self._action(self._stop))
            self.row(208, "u32", wrote=self._action(self._home))

    @staticmethod
    def _action(act: Callable[[], None]) -> Callable[[int, int], None]:
        return lambda before, now: act() if now and not before else None

    def _motion_status(self) -> int:
        servo = self.servo
        return self._moving | 6 * servo.homed | self.homing << 3 | servo.homing_error << 4

    def _home(self) -> None:
        if self.servo.powered:
            self.servo.start_homing(17, self.rpm(60), self.rpm(12), 0)

    def _stop(self) -> None:
        self.servo.quick_stop(self.rpm(20_000))
        self.after(0.3, self.servo.resume)

    def _move(self) -> None:
        if self.servo.powered:
            at = self.servo.position_demand_counts if self[32] & 1 else 0
            self.servo.move_absolute(at + self[30], self.rpm(self[28] / 1000), self.rpm(self[24] / 1000))
            self._moving = True

    def tick(self) -> None:
        self._moving = self._moving and not self.servo.target_reached


class OrientalAz(MakerDrive):
    """Notes 4: 32-bit values, one block of direct data with its trigger last, excited from power-up on."""

    start_powered = True

    def table(self) -> None:
        servo = self.servo
        self._homing = self._home_end = False
        for address, value in ((0x58, 0), (0x5A, 2), (0x5E, 1000), (0x60, 1_000_000), (0x62, 1_000_000), (0x64, 1000)):
            self.row(address, "u32", value)
        self.row(0x5C, "i32")
        self.row(0x66, "i32", wrote=lambda _, value: self._go() if value == 1 else None).read = lambda: 0
        self.row(0x7C, "u32", wrote=self._input)
        self.shown(0x7E, "u32", self._output)
        self.shown(0x80, "u32", lambda: servo.fault_code & 0xFF)
        self.shown(0xCC, "i32", lambda: servo.position_actual_counts)
        self.shown(0xCE, "i32", lambda: round(servo.velocity_actual_counts_s * 60 / self.counts_per_rev))
        self.shown(0xD0, "i32", lambda: servo.velocity_actual_counts_s)
        if self.start_powered:
            servo.power_on()

    def speed(self) -> float:
        return float(self[0x5E])

    def acceleration(self) -> float:
        return float(self[0x60])

    def write(self, address: int, words: list[int]) -> int:
        if address == 0x7D and len(words) == 1:  # the lower word may be written alone
            return super().write(0x7C, [0, *words])
        return super().write(address, words)

    def _go(self) -> None:
        if not self[0x7C] & 1 << 5:
            at = {1: 0, 2: self.servo.position_demand_counts}.get(self[0x5A])
            if at is not None:
                self._home_end = False
                self.servo.move_absolute(at + self[0x5C], self.speed(), self.acceleration())

    def _power(self, before: int, now: int) -> None:
        if now & 1 << 6:
            self.servo.power_off()
        elif before & 1 << 6:
            self.servo.power_on()

    def _input(self, before: int, now: int) -> None:
        self._power(before, now)
        rises = now & ~before
        if rises & 1 << 5:
            self._homing = False
            self.servo.quick_stop(self.rpm(20_000))
        elif before & ~now & 1 << 5:
            self.servo.resume()
        if rises & 1 << 7:
            self.servo.reset_fault()
        if rises & 1 << 4 and self.servo.powered:
            self._homing, self._home_end = True, False
            self.servo.move_absolute(0, self.rpm(120), self.rpm(2000))

    def _output(self) -> int:
        servo = self.servo
        moving = not servo.target_reached
        bits = {4: self._home_end, 5: servo.powered and not moving, 7: servo.fault_code, 13: moving, 14: not moving}
        return sum(bool(bit) << at for at, bit in bits.items())

    def tick(self) -> None:
        if self._homing and self.servo.target_reached:
            self._homing, self._home_end = False, True


class OrientalBlvR(OrientalAz):
    """Notes 4: the same block with speeds in r/min; S-ON is bit 0."""

    counts_per_rev = 36_000
    start_powered = False

    def speed(self) -> float:
        return self.rpm(self[0x5E])

    def acceleration(self) -> float:
        return self.rpm(self[0x60])

    def _power(self, before: int, now: int) -> None:
        if now & 1 and not before & 1:
            self.servo.power_on()
        elif before & 1 and not now & 1:
            self.servo.power_off()


class _VirtualInputs(MakerDrive):
    """Notes 5 and 6: functions of virtual inputs and outputs, segments at an edge, low word first."""

    first = "low"
    outputs_from_factory: tuple[int, ...] = ()

    def table(self) -> None:
        servo = self.servo
        self.stored = 0
        self._levels: dict[int, bool] = {}
        self.shown(0x0B00, "i16", lambda: round(servo.velocity_actual_counts_s * 60 / self.counts_per_rev))
        self.shown(0x0B07, "i32", lambda: servo.position_actual_counts)
        self.shown(0x0B22, "u16", lambda: servo.fault_code & 0xFFF)
        kept = [(0x0500, 0), (0x051E, 0), (0x051F, 17), (0x0709, 3000), (0x070A, 3000), (0x0C09, 0), (0x0C0B, 0)]
        kept += [(0x1100, 1), (0x1101, 2), (0x1104, 0), (0x110E, 100), (0x110F, 100)]
        kept += [(0x1700 + 2 * n, 0) for n in range(8)] + [(0x1721 + 2 * n, 0) for n in range(8)]
        for address, value in kept:
            self.row(address, value=value, wrote=lambda *_: self._kept())
        self.row(0x0C0D, value=1)
        self.row(0x110C, "i32")
        self.row(0x0D01, wrote=lambda _, value: servo.reset_fault() if value == 1 and not servo.powered else None)
        self.row(0x3100, wrote=lambda *_: self._look_at_inputs())
        self.shown(0x1720, "u16", self._outputs)
        if self.outputs_from_factory:
            self.rows[0x0C0B].value = 1
            for n, function in enumerate(self.outputs_from_factory):
                self.rows[0x1721 + 2 * n].value = function

    def _kept(self) -> None:
        self.stored += self[0x0C0D] == 1
        self._look_at_inputs()

    def _level(self, function: int) -> bool:
        return self[0x0C09] == 1 and any(
            self[0x1700 + 2 * n] == function and self[0x3100] >> n & 1 for n in range(8)
        )  # fmt: skip

    def _look_at_inputs(self) -> None:
        before, now = self._levels, {function: self._level(function) for function in (1, 28, 32, 34)}
        self._levels = now
        servo = self.servo

        def rises(function: int) -> bool:
            return now[function] and not before.get(function, False)

        if rises(1):
            self.switch_on()
        elif before.get(1) and not now[1]:
            servo.power_off()
        if rises(34):
            servo.quick_stop(self.ramp(20))
        elif before.get(34) and not now[34]:
            servo.resume()
        if rises(28) and servo.powered and self.plans:
            at = 0 if self[0x1104] == 1 else servo.position_demand_counts
            servo.move_absolute(at + self[0x110C], self.rpm(self[0x110E]), self.ramp(self[0x110F]))
        if rises(32) and servo.powered and self[0x051E] == 1:
            servo.start_homing(self[0x051F], self.rpm(60), self.rpm(12), 0)

    def switch_on(self) -> None:
        self.after(0.05, lambda: self.servo.power_on() if self._level(1) else None)

    @property
    def plans(self) -> bool:
        return True

    def _outputs(self) -> int:
        servo = self.servo
        shows = {
            1: not servo.fault_code,
            9: servo.powered,
            5: self.in_position and servo.powered,
            11: bool(servo.fault_code),
            16: servo.homed,
        }
        return sum((self[0x0C0B] == 1 and bool(shows.get(self[0x1721 + 2 * n]))) << n for n in range(8))


class LichuanA5(_VirtualInputs):
    """Notes 5: its state is what the user has assigned to virtual outputs; its segments start at an edge in mode 2 only."""

    outputs_from_factory = (1, 9, 5, 11, 16)

    def table(self) -> None:
        super().table()
        self.row(0x0200, value=1)

    @property
    def plans(self) -> bool:
        return self[0x0200] == 1 and self[0x0500] == 2 and self[0x1100] == 2 and self[0x1101] == 1


class InovanceSv660(_VirtualInputs):
    """Notes 6: a status word, DI5 that collides with the virtual servo on, positions only from the segments."""

    def table(self) -> None:
        super().table()
        self.row(0x0200, value=1)
        self.row(0x030A, value=0)
        servo = self.servo
        self.armed = 0
        self.rows[0x051E].wrote = self._arm
        self.shown(0x3000, "u16", lambda: (3 if servo.fault_code else 2 if servo.powered else 1) << 12)
        self.shown(0x3001, "u16", lambda: (servo.homed and self.armed != 1) << 15)

    def _arm(self, _: int, how: int) -> None:
        self.armed = int(how == 4)
        self._kept()

    def switch_on(self) -> None:
        if self[0x030A] == 1:
            self.servo.raise_fault(0x122)
        elif self.armed == 1:
            self.after(0.05, self._home)
        else:
            super().switch_on()

    def _home(self) -> None:
        self.armed = 2
        self.servo.power_on()
        self.servo.start_homing(self[0x051F], self.rpm(60), self.rpm(12), 0)

    @property
    def plans(self) -> bool:
        return self[0x0500] == 2 and self[0x1100] == 0 and self[0x1101] == 1


class A6Rs(MakerDrive):
    """Notes 7: written low word first, read high word first; logic levels of inputs."""

    first = "low"
    counts_per_rev = 131_072

    def table(self) -> None:
        servo = self.servo
        self.stored = 0
        for address, value in (
            (0x0300, 0),
            (0x0400, 19),
            (0x0404, 2),
            (0x0408, 14),
            (0x1000, 0),
            (0x1001, 17),
            (0x1100, 1),
            (0x1101, 1),
            (0x1103, 0),
            (0x1104, 0),
            (0x1108, 100),
        ):
            self.row(address, value=value, wrote=lambda *_: self._kept())
        self.row(0x0A05, value=1)
        self.row(0x1106, "i32", wrote=lambda *_: self._kept())
        self.row(0x110A, "u32", 100)
        self.row(0x110C, "u32", 100)
        self.row(0x0401, wrote=self._start)
        self.row(0x0409, wrote=self._home)
        self.shown(0x4005, "u16", lambda: 8 * servo.homed + 4 * self.in_position + (not servo.fault_code))
        self.row(0x0405, wrote=lambda before, now: servo.reset_fault() if now and not before else None)
        self.row(0x0411, wrote=lambda _, now: self.after(0.05, self._power))
        self.shown(0x4001, "i16", lambda: round(servo.velocity_actual_counts_s * 60 / self.counts_per_rev))
        self.shown(0x4003, "i16", lambda: servo.torque_actual_permille)
        self.shown(0x4006, "u16", lambda: 310)
        self.shown(0x4016, "i32", lambda: servo.position_actual_counts, first="high")
        self.shown(0x4030, "i16", lambda: 38)
        self.shown(0x410A, "u16", lambda: 3 if servo.fault_code else 2 if servo.powered else 1)

    def _kept(self) -> None:
        self.stored += self[0x0A05] == 1

    def _home(self, before: int, now: int) -> None:
        if now and not before and self.servo.powered and self[0x0408] == 25 and self[0x1000] == 2:
            self.servo.start_homing(self[0x1001], self.rpm(60), self.rpm(12), 0)

    def _power(self) -> None:
        if self[0x0411]:
            self.servo.power_on()
        elif self.servo.powered:
            self.servo.quick_stop(self.ramp(20))  # its setting: brake, then take the power off
            self.after(0.3, self.servo.power_off)

    def _start(self, before: int, now: int) -> None:
        ready = self[0x0300] == 1 and self[0x1100] == 0 and self[0x1103] == 1 and self[0x1104] == 1
        if now and not before and self.servo.powered and ready:
            at = self.servo.position_demand_counts if self[0x1101] else 0
            self.servo.move_absolute(at + self[0x1106], self.rpm(self[0x1108]), self.ramp(self[0x110A]))


class MrJeC(MakerDrive):
    """Notes 9: objects by index, no two in one request; CiA 402 with speeds in 0.01 r/min and ramps as times to 3000 r/min."""

    first = "low"
    counts_per_rev = 131_072
    objects = True

    def table(self) -> None:
        servo = self.servo
        self._state, self._acknowledge = 0x40, False
        self.shown(0x2A42, "u16", lambda: servo.fault_code & 0xFFFF)
        self.row(0x6040, wrote=self._control)
        self.shown(0x6041, "u16", self._status)
        self.row(0x6060, "i16", 8)
        self.shown(0x6061, "i16", lambda: self[0x6060])
        self.shown(0x6064, "i32", lambda: servo.position_actual_counts)
        self.shown(0x606C, "i32", lambda: round(servo.velocity_actual_counts_s * 6000 / self.counts_per_rev))
        self.shown(0x6077, "i16", lambda: servo.torque_actual_permille)
        self.row(0x607A, "i32")
        self.row(0x6081, "u32", 10_000)
        self.row(0x6083, "u32", 300)
        self.row(0x6084, "u32", 300)
        self.row(0x6098, "i16", 17)
        self.shown(0x60F4, "i32", lambda: servo.following_error_counts)

    def _status(self) -> int:
        servo = self.servo
        if servo.fault_code:
            return 0x0008
        homing = self[0x6060] == 6
        word = self._state | 0x200 | (servo.target_reached and not self.homing) << 10
        return word | (servo.homed if homing else self._acknowledge) << 12 | (homing and servo.homing_error) << 13

    def _control(self, before: int, now: int) -> None:
        servo, low = self.servo, now & 0x0F
        if now & 0x80 and not before & 0x80:
            servo.reset_fault()
            self._state = 0x40
            return
        if servo.fault_code:
            return
        if not now & 0x02:
            self._state = 0x40
            servo.power_off()
        elif not now & 0x04:
            if self._state == 0x27:
                self._state = 0x07
                servo.quick_stop(self.rpm(20_000))
        elif low == 0x06:
            self._state = 0x21
            servo.power_off()
        elif low == 0x07 and self._state in (0x21, 0x27):
            self._state = 0x23
            servo.power_off()
        elif low == 0x0F and self._state in (0x23, 0x27):
            if self._state == 0x23:
                self._state = 0x27
                servo.power_on()
            self._operate(before, now)

    def _operate(self, before: int, now: int) -> None:
        servo = self.servo
        if now & 0x100:
            if not before & 0x100:
                servo.halt(self.ramp(self[0x6084], 3000))
            return
        if before & 0x100:
            servo.resume()
        start = now & 0x10 and not before & 0x10
        if self[0x6060] == 1 and start:
            at = servo.position_demand_counts if now & 0x40 else 0
            servo.move_absolute(at + self[0x607A], self.rpm(self[0x6081] / 100), self.ramp(self[0x6083], 3000))
            self._acknowledge = True
        elif self[0x6060] == 6 and start:
            servo.start_homing(self[0x6098], self.rpm(60), self.rpm(12), 0)
        if not now & 0x10:
            self._acknowledge = False


class AppliedMotion(MakerDrive):
    """Notes 10: opcodes; speeds in 1/240 turns/s, ramps in 1/6 turns/s²."""

    counts_per_rev = 20_000

    def table(self) -> None:
        servo = self.servo
        self.shown(0, "u16", lambda: servo.fault_code & 0xFFFF)
        self.shown(1, "u16", self._status)
        self.shown(4, "i32", lambda: servo.position_actual_counts)
        self.row(124, wrote=self._order).read = lambda: 0
        self.row(344, "u32", 600)
        self.row(346, "u32", 600)
        self.row(348, "u32", 240)
        self.row(350, "i32", 20_000)

    def _status(self) -> int:
        servo = self.servo
        moving = not servo.target_reached
        return servo.powered | bool(servo.fault_code) << 2 | (not moving) << 3 | moving << 4

    def _order(self, _: int, opcode: int) -> None:
        servo, turn = self.servo, self.counts_per_rev
        if opcode == 0x9F:
            servo.power_on()
        elif opcode == 0x9E:
            servo.power_off()
        elif opcode == 0xBA:
            servo.reset_fault()
        elif opcode in (0xE1, 0xE2):
            servo.quick_stop(300.0 * turn if opcode == 0xE1 else self[346] / 6 * turn)
            self.after(0.3, servo.resume)
        elif opcode in (0x66, 0x67):
            at = servo.position_demand_counts if opcode == 0x66 else 0
            servo.move_absolute(at + self[350], self[348] / 240 * turn, self[344] / 6 * turn)


class LichuanA6(MakerDrive):
    """Notes 5: functions of inputs and outputs by registers, a position loaded at an edge, homing while its input is on. Without an
    order that brakes: servo off stops as the drive is set up to."""

    first = "low"
    start_counts = 9_876

    def table(self) -> None:
        servo = self.servo
        self._loading, self._homes = False, False
        functions = {0x80: 0, 0x81: 1, 0x82: 2, 0x83: 3, 0x84: 21, 0x85: 20, 0x86: 17, 0x87: 16}
        outputs = {0x88: 0, 0x89: 1, 0x8A: 2, 0x8B: 3, 0x8C: 4, 0x8D: 11}
        modes = {
            0x02: 0,
            0x4A: self.counts_per_rev,
            0x5E: 3000,
            0x63: 2,
            0x8E: 0,
            0x90: 1,
            0x91: 0,
            0x94: 0,
            0x96: 2,
            0xA0: 0,
            0xA1: 1,
        }
        for address, value in {**functions, **outputs, **modes}.items():
            self.row(address, value=value)
        self.row(0x58, value=100, low=0, high=2500)
        self.row(0x59, value=100, low=0, high=2500)
        self.row(0x168, "i32")
        self.row(0x190, value=100, low=0, high=3000)
        self.row(0x1A0, value=0xA3)
        self.row(0x1A4, wrote=self._inputs)
        self.row(0x1A7).read = lambda: 0
        self.shown(0x1B8, "i32", lambda: round(servo.position_demand_counts))
        self.shown(0x1BC, "i32", lambda: round(servo.position_actual_counts * 13.1072))
        self.shown(0x1C1, "i16", lambda: round(servo.velocity_actual_counts_s * 60 / self.counts_per_rev))
        self.shown(0x1C9, "u16", lambda: servo.fault_code & 0xFF)
        self.shown(0x1D3, "u16", self._outputs)

    def _on(self, function: int, word: int) -> bool:
        """Whether an input that is taken from the bus has this function and is on."""
        return any(self[0x80 + n] == function and word & self[0x1A0] & 1 << n for n in range(8))

    def _inputs(self, before: int, now: int) -> None:
        servo = self.servo
        rises = {f for f in (0, 1, 20, 16) if self._on(f, now) and not self._on(f, before)}
        if 0 in rises:
            self.after(0.1, lambda: servo.power_on() if self._on(0, self[0x1A4]) else None)
        elif self._on(0, before) and not self._on(0, now) and servo.powered:
            servo.quick_stop(self.ramp(20))
            self.after(0.2, servo.power_off)
        if 1 in rises and not servo.powered:
            servo.reset_fault()
        if 20 in rises and servo.powered and (self[0x90], self[0x91], self[0x94], self[0x96]) == (1, 0, 0, 2):
            servo.move_absolute(self[0x168], self.rpm(self[0x190]), self.ramp(self[0x58]))
        if 16 in rises and servo.powered and self[0xA0] == 0:
            self._homes = True
            servo.start_homing(17, self.rpm(60), self.rpm(12), 0)
        elif self._homes and not self._on(16, now) and self.homing:
            servo.quick_stop(self.ramp(100))
            self.after(0.5, servo.resume)

    def _outputs(self) -> int:
        servo = self.servo
        still = servo.velocity_actual_counts_s == 0
        shows = {
            0: not servo.fault_code,
            1: bool(servo.fault_code),
            2: self.in_position and still and not self.homing,
            3: servo.powered,
            4: still,
            11: servo.homed,
        }
        return sum(bool(shows.get(self[0x88 + n])) << n for n in range(6))


class Aasd15a(MakerDrive):
    """Notes 11: registers of 16 bits only, a distance in ten-thousands and the rest, inputs that are on at 0, HOME for a while."""

    lines = 2500

    def table(self) -> None:
        servo = self.servo
        self._home_until_ns, self._was_homing, self._paused = -1, False, False
        for number, value in {
            2: 2,
            33: 0,
            34: 0,
            43: 80,
            68: 0x0002,
            69: 0x0C40,
            98: 1,
            102: 1,
            109: 2,
            117: 1,
            118: 1,
            119: 50,
        }.items():
            self.row(number, value=value)
        self.row(3, wrote=self._servo_on)
        self.row(70, value=32691, wrote=self._inputs_1)
        self.row(71, value=32767, wrote=self._inputs_2)
        self.row(120, "i16", low=-9999, high=9999)
        self.row(121, "i16", low=-9999, high=9999)
        self.row(128, value=100, low=0, high=3000)
        self.shown(370, "i16", lambda: round(servo.torque_actual_permille / 10))
        self.shown(376, "i16", lambda: round(servo.velocity_actual_counts_s * 15 / self.lines))
        self.shown(379, "i16", lambda: self._split()[1])
        self.shown(380, "i16", lambda: self._split()[0])
        self.shown(386, "u16", self._outputs)

    def _split(self) -> tuple[int, int]:
        """Ten-thousands and the rest of the position, both with its sign."""
        counts = self.servo.position_actual_counts
        tens = int(counts / 10_000)
        return tens, counts - 10_000 * tens

    def _servo_on(self, before: int, now: int) -> None:
        if now and not before:
            self.after(0.1, lambda: self.servo.power_on() if self[3] else None)
        elif before and not now:
            self.servo.power_off()

    def _inputs_1(self, before: int, now: int) -> None:
        if self[68] & 2 and before & 2 and not now & 2:
            self.servo.reset_fault()

    def _inputs_2(self, before: int, now: int) -> None:
        servo = self.servo
        before, now = before | ~self[69], now | ~self[69]
        if before & 1 << 11 and not now & 1 << 11:
            self._paused = True
            servo.quick_stop(abs(servo.velocity_actual_counts_s) / (max(self[119], 1) / 1000.0) + 1000.0)
        elif now & 1 << 11 and not before & 1 << 11:
            self._paused = False
            servo.resume()
        if now & 1 << 10 and not before & 1 << 10 and servo.powered and not self._paused and self[117] == 1:
            way = 10_000 * self[120] + self[121]
            speed = self.rpm(self[128])
            servo.move_absolute(servo.position_demand_counts + way, speed, speed / 0.07)
        if now & 1 << 6 and not before & 1 << 6 and servo.powered and self[33] == 2:
            self._was_homing = True
            servo.start_homing(17, self.rpm(60), self.rpm(12), 0)

    def _outputs(self) -> int:
        servo = self.servo
        still = abs(servo.velocity_actual_counts_s) < self.rpm(10)
        home = self.now_ns < self._home_until_ns
        bits = {0: servo.fault_code, 1: not servo.fault_code, 3: self.in_position, 6: still, 7: servo.powered, 9: home}
        return sum(bool(bit) << at for at, bit in bits.items())

    def tick(self) -> None:
        if self._was_homing and self.servo.homed and not self.homing:
            self._was_homing = False
            self._home_until_ns = self.now_ns + self[43] * MS


FAMILIES: dict[str, type[MakerDrive]] = {
    "leadshine_el7": LeadshineEl7,
    "delta_asda_a2": DeltaAsdaA2,
    "kollmorgen_akd2g": Akd2g,
    "oriental_az": OrientalAz,
    "oriental_blv_r": OrientalBlvR,
    "lichuan_a5": LichuanA5,
    "lichuan_a6": LichuanA6,
    "inovance_sv660": InovanceSv660,
    "stepperonline_a6_rs": A6Rs,
    "mitsubishi_mr_je_c": MrJeC,
    "applied_motion": AppliedMotion,
    "aasd_15a": Aasd15a,
}
"""By the name of the map that describes the same drive."""


class _Handler(DataHandler):  # type: ignore[misc]
    """pyModbusTCP's requests to one drive."""

    def __init__(self, drive: MakerDrive) -> None:
        super().__init__()
        self._drive = drive

    def read_h_regs(self, address: int, count: int, srv_info: Any) -> Any:
        words = self._drive.read(address, count)
        return self.Return(EXP_DATA_ADDRESS) if words is None else self.Return(EXP_NONE, words)

    def write_h_regs(self, address: int, words_l: list[int], srv_info: Any) -> Any:
        if not self._drive.single_writes and srv_info.recv_frame.pdu.func_code == 6:
            return self.Return(EXP_ILLEGAL_FUNCTION)
        code = self._drive.write(address, list(words_l))
        return self.Return(code or EXP_NONE)


class MakerWire:
    """Requests to one drive as unit 1, without frames."""

    connected = True

    def __init__(self, drive: MakerDrive) -> None:
        self._drive = drive

    def connect(self, within_s: float = math.inf) -> None: ...
    def disconnect(self) -> None: ...
    def discard(self, silence_s: float) -> None: ...
    def post(self, unit: int, requests: Sequence[Request]) -> None: ...

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        if request.function == 3:
            words = self._drive.read(request.address, request.count)
            if words is None:
                raise AbortError("refused", int(EXP_DATA_ADDRESS))
            return tuple(words)
        allowed = request.function == 16 or (request.function == 6 and self._drive.single_writes)
        code = self._drive.write(request.address, list(request.values)) if allowed else int(EXP_ILLEGAL_FUNCTION)
        if code:
            raise AbortError("refused", code)
        return ()


class _Server(ModbusServer):  # type: ignore[misc]
    """pyModbusTCP's server, which looks every 10 ms, not every 0.5 s, whether it is to end."""

    def _serve(self) -> None:
        self._evt_running.set()
        try:
            self._service.serve_forever(0.01)
        finally:
            self._evt_running.clear()


@contextmanager
def served(drive: MakerDrive) -> Iterator[int]:
    """The drive behind pyModbusTCP on loopback; yields the port."""
    server = _Server("127.0.0.1", 0, no_block=True, data_hdl=_Handler(drive))
    server.start()
    try:
        yield int(server._service.server_address[1])
    finally:
        server.stop()
        server._serve_th.join()


class _Line(RTUServer):  # type: ignore[misc]
    """umodbus's frames and requests of a serial line to one drive; requests to other units stay unanswered."""

    drive: MakerDrive
    unit = 1
    requests = 0

    def serve_once(self) -> None:
        """One request; on a busy computer its bytes come in pieces, between which umodbus would take it for ended."""
        request_adu = bytes(self.serial_port.read(256))
        for _ in range(100):
            if not request_adu:
                return
            try:
                validate_crc(request_adu)
            except (CRCError, struct.error):
                request_adu += bytes(self.serial_port.read(256))
            else:
                self.respond(self.process(request_adu))
                return
        raise CRCError(f"no request: {request_adu.hex()}")

    def respond(self, response_adu: bytes) -> None:
        if response_adu:
            super().respond(response_adu)

    def create_response_adu(self, meta_data: dict[str, int], response_pdu: bytes) -> bytes:
        if meta_data["unit_id"] != self.unit:
            return b""
        return bytes(super().create_response_adu(meta_data, response_pdu))

    def execute_route(self, meta_data: dict[str, int], request_pdu: bytes) -> bytes:
        if meta_data["unit_id"] != self.unit:
            return b""
        self.requests += 1
        function = create_function_from_request_pdu(request_pdu)
        code = 0
        if isinstance(function, ReadHoldingRegisters):
            words = self.drive.read(function.starting_address, function.quantity)
            if words is not None:
                return bytes(function.create_response_pdu(words))
            code = int(EXP_DATA_ADDRESS)
        elif isinstance(function, WriteMultipleRegisters):
            code = self.drive.write(function.starting_address, [int(word) & 0xFFFF for word in function.values])
        elif isinstance(function, WriteSingleRegister) and self.drive.single_writes:
            code = self.drive.write(function.address, [int(function.value) & 0xFFFF])
        else:
            code = int(EXP_ILLEGAL_FUNCTION)
        if code:
            return bytes(pack_exception_pdu(request_pdu[0], code))
        return bytes(function.create_response_pdu())


@contextmanager
def served_on_a_line(drive: MakerDrive, baud: int) -> Iterator[tuple[str, _Line]]:
    """The drive behind umodbus as unit 1 of a serial line; yields the master's port and the server."""
    with serial_pair() as (theirs, mine), serial.Serial(theirs, baud) as port:
        server = get_server(_Line, port)
        server.drive = drive
        # it takes for one request what comes within this time: a pseudo-terminal passes a frame on as a whole
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.002})
        thread.start()
        try:
            yield mine, server
        finally:
            server.shutdown()
            thread.join()
