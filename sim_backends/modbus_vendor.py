"""The simulated drive with a vendor's own register set: coils for commands, inputs for the status, a self-clearing trigger register.

With the difficulties of such drives: the trigger register is processed only every few milliseconds, "in position" stays set
until then, an enable coil left set switches power on as soon as the alarm is reset. Written without the client's register map.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from sim_backends.modbus_registers import ILLEGAL_VALUE, Bank, Cell, RefusedRequestError, Space, Value
from sim_backends.modbus_table import PITCH_STEPS, BlockTable
from sim_backends.servo import SimulatedServo

_MS = 1_000_000
TASK_NS = 2 * _MS  # interval at which the drive processes its orders
_MOVE, _ORIGIN = 1, 2
_NAME = b"VS-200A"


_QUICK_STOP_RPM_S = 20_000.0


class VendorRegisters:
    """`Face` of such a drive. counts_per_rev: of the motor, as speeds are in 0.01 rpm and ramps in 0.1 rpm/s.

    settings: initial values of the parameters by name (origin_method, origin_speed, origin_creep, origin_offset); raw.
    """

    max_read = 32
    max_write = 16
    single_writes = True

    def __init__(
        self,
        servo: SimulatedServo,
        *,
        counts_per_rev: int,
        settings: Mapping[str, int] | None = None,
    ) -> None:
        self.servo = servo
        self._counts_per_rpm = counts_per_rev / 60.0
        self._quick_stop = _QUICK_STOP_RPM_S * self._counts_per_rpm
        self._coils = {"servo_on": 0, "emergency_stop": 0, "alarm_reset": 0, "pause": 0}
        self._motion = {"target": 0, "target_speed": 10_000, "ramp": 30_000, "trigger": 0}
        self._kept: dict[str, float] = {
            "origin_method": 35,
            "origin_speed": 6000,
            "origin_creep": 600,
            "origin_offset": 0,
            "gear_numerator": 1,
            "gear_denominator": 1,
            "stiffness": 60.0,
            "torque_limit": 3000,
        }
        self._working: dict[str, float] = {"backlash": 0, "backlash_quick": 0}  # in RAM
        self._kept.update(settings or {})
        self.eeprom_writes: dict[str, int] = {}
        servo.backlash.follow(lambda: self._working["backlash"], lambda: bool(self._working["backlash_quick"]))
        self.table = BlockTable(PITCH_STEPS, lambda: servo.powered, lambda: 1.0)
        servo.table.follow(self.table.own)
        self._now_ns = 0
        self._ordered_ns = 0
        self.banks: Mapping[Space, Bank] = {
            Space.COILS: Bank(self._coil_cells(), gaps_readable=False),
            Space.DISCRETE_INPUTS: Bank(self._status_cells(), gaps_readable=False),
            Space.INPUT_REGISTERS: Bank(self._value_cells(), gaps_readable=False),
            Space.HOLDING_REGISTERS: Bank([*self._holding_cells(), *self.table.pitch_cells()], gaps_readable=False),
        }

    @property
    def settings(self) -> dict[str, float]:
        """Present motion values and parameters of the drive by name, raw."""
        return {**self._motion, **self._working, **self._kept}

    # -- cells -----------------------------------------------------------------------------------------------------------
    def _coil_cells(self) -> list[Cell]:
        acts = (self._on_servo_on, self._on_emergency_stop, self._on_alarm_reset, self._on_pause)
        return [
            Cell(address, "?", self._reader(self._coils, name), self._coil_writer(name, act))
            for address, (name, act) in enumerate(zip(self._coils, acts, strict=True))
        ]

    def _status_cells(self) -> list[Cell]:
        servo = self.servo
        readings: list[Callable[[], Value]] = [
            lambda: not servo.fault_code,
            lambda: servo.powered,
            lambda: bool(servo.fault_code),
            lambda: servo.target_reached,
            lambda: servo.homed,
            lambda: servo.homing_error,
            lambda: bool(self._coils["emergency_stop"]),
            lambda: servo.positive_limit_switch,
            lambda: servo.negative_limit_switch,
        ]
        return [Cell(address, "?", read) for address, read in enumerate(readings)]

    def _value_cells(self) -> list[Cell]:
        servo = self.servo
        return [
            Cell(0, "H", lambda: servo.fault_code),
            _low_first(1, "i", lambda: servo.position_actual_counts),
            _low_first(3, "i", lambda: round(100 * servo.velocity_actual_counts_s / self._counts_per_rpm)),
            Cell(5, "h", lambda: servo.torque_actual_permille),
            _low_first(6, "i", lambda: servo.following_error_counts),
            Cell(8, "H", lambda: 3250),
            Cell(9, "h", lambda: 715),
            _low_first(10, "Q", lambda: self._now_ns // _MS),
        ]

    def _holding_cells(self) -> list[Cell]:
        motion, working = self._motion, self._working

        def set_to(name: str) -> Callable[[Value], None]:
            return lambda value: working.__setitem__(name, int(value))

        def moved(name: str) -> Callable[[Value], None]:
            return lambda value: motion.__setitem__(name, int(value))

        return [
            _low_first(0, "i", self._reader(motion, "target"), moved("target")),
            _low_first(2, "I", self._reader(motion, "target_speed"), moved("target_speed"), (1, 600_000)),
            _low_first(4, "I", self._reader(motion, "ramp"), moved("ramp"), (1, 1_000_000_000)),
            Cell(6, "H", self._reader(motion, "trigger"), self._on_trigger, 0, 2),
            self._kept_cell(100, "h", "origin_method", -3, 35),
            self._kept_cell(101, "I", "origin_speed", 1, 100_000),
            self._kept_cell(103, "I", "origin_creep", 1, 50_000),
            self._kept_cell(105, "i", "origin_offset"),
            self._kept_cell(107, "H", "gear_numerator", 1, 9999),
            self._kept_cell(108, "H", "gear_denominator", 1, 9999),
            self._kept_cell(109, "f", "stiffness", 0.0, 500.0, low_byte_first=True),
            self._kept_cell(111, "H", "torque_limit", 0, 3000),
            _low_first(112, "I", self._reader(working, "backlash"), set_to("backlash"), (0, 1_000_000)),
            Cell(114, "H", self._reader(working, "backlash_quick"), set_to("backlash_quick"), 0, 1),
            Cell(200, "12s", lambda: _NAME, low_byte_first=True),
        ]

    def _kept_cell(
        self,
        address: int,
        code: str,
        name: str,
        low: float | None = None,
        high: float | None = None,
        *,
        low_byte_first: bool = False,
    ) -> Cell:
        def write(value: Value) -> None:
            self._kept[name] = float(value) if code == "f" else int(value)
            self.eeprom_writes[name] = self.eeprom_writes.get(name, 0) + 1

        return Cell(
            address,
            code,
            self._reader(self._kept, name),
            write,
            low,
            high,
            low_word_first=True,
            low_byte_first=low_byte_first,
        )

    @staticmethod
    def _reader(values: Mapping[str, float], name: str) -> Callable[[], Value]:
        return lambda: values[name]

    def _coil_writer(self, name: str, act: Callable[[int, int], None]) -> Callable[[Value], None]:
        def write(value: Value) -> None:
            before, self._coils[name] = self._coils[name], int(value)
            act(before, int(value))

        return write

    # -- orders ----------------------------------------------------------------------------------------------------------
    def _on_servo_on(self, before: int, now: int) -> None:
        if now and not before:
            self.servo.power_on()
        elif before and not now:
            self.servo.power_off()
            self._motion["trigger"] = 0

    def _on_emergency_stop(self, before: int, now: int) -> None:
        if now:
            self._motion["trigger"] = 0
            self.servo.quick_stop(self._quick_stop)
        elif before:
            self.servo.resume()

    def _on_alarm_reset(self, before: int, now: int) -> None:
        if now and not before:
            self.servo.reset_fault()
            if self._coils["servo_on"]:
                self.servo.power_on()

    def _on_pause(self, before: int, now: int) -> None:
        if now:
            self._motion["trigger"] = 0
            self.servo.halt(0.1 * self._motion["ramp"] * self._counts_per_rpm)
        elif before and not self._coils["emergency_stop"]:
            self.servo.resume()

    def _on_trigger(self, value: Value) -> None:
        if value and not self.servo.powered:
            raise RefusedRequestError(ILLEGAL_VALUE)
        self._motion["trigger"] = int(value)
        self._ordered_ns = self._now_ns

    def _take_order(self) -> None:
        order, self._motion["trigger"] = self._motion["trigger"], 0
        if order == _MOVE:
            self.servo.move_absolute(
                self._motion["target"],
                0.01 * self._motion["target_speed"] * self._counts_per_rpm,
                0.1 * self._motion["ramp"] * self._counts_per_rpm,
            )
        elif order == _ORIGIN:
            self.servo.start_homing(
                int(self._kept["origin_method"]),
                0.01 * self._kept["origin_speed"] * self._counts_per_rpm,
                0.01 * self._kept["origin_creep"] * self._counts_per_rpm,
                int(self._kept["origin_offset"]),
            )

    # -- time ------------------------------------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        self._now_ns = now_ns
        if self._motion["trigger"] and now_ns - self._ordered_ns >= TASK_NS:
            self._take_order()

    def bearable(self, now_ns: int) -> int:
        return TASK_NS if self._motion["trigger"] else 1000 * _MS


def _low_first(
    address: int,
    code: str,
    read: Callable[[], Value],
    write: Callable[[Value], None] | None = None,
    limits: tuple[float | None, float | None] = (None, None),
) -> Cell:
    return Cell(address, code, read, write, *limits, low_word_first=True)
