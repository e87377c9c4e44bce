"""A small axis for tests of decisions: drive and instrument over a motor, a nut with play and a wavy screw, in simulated time.

It shares no code with the bench. Faults are given as data (`Trouble`), at a time or at the n-th call; `calls` records every order to
the drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.clock import NS_PER_S
from drivers.drive import Capability, DriveSample, DriveState, ServoDrive
from drivers.errors import LinkLostError
from drivers.instrument import DistanceInstrument, Environment, Reading, ReadingStatus
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.axis.axis_file import MeasurementConfig
from hil.machine.session import AxisSession
from sim_backends.clock import SimClock

LIMITS = DriveLimits(-2.0, 102.0, 100.0, 1000.0)
MEASUREMENT = MeasurementConfig(
    targets_mm=(0.0, 30.0, 61.0, 100.0),
    runs=2,
    velocity_mm_s=50.0,
    overrun_mm=1.0,
    dwell_s=0.1,
    reading_s=0.1,
    reference_mm=0.0,
    home=True,
    seed=1,
)
READING_NS = NS_PER_S // 100
OFFSET_MM = 1234.5  # zero of the instrument


@dataclass
class Trouble:
    """Faults and their times: at a simulated time, s, or at the n-th call."""

    fault_at_s: float = math.inf
    drop_out_at_s: float = math.inf  # safe torque off: disabled without a fault
    limit_switch_at_s: float = math.inf  # the drive stops by itself, and shows target reached
    beam_lost_at_s: float = math.inf
    silent_at_s: float = math.inf  # no more readings
    link_lost_at_s: float = math.inf
    frozen_samples_at_s: float = math.inf  # the drive repeats its last sample
    stuck_at_s: float = math.inf  # the motor no longer moves
    frozen_readings_at_s: float = math.inf  # the instrument repeats its position; status and count are as before
    jump_at_s: float = math.inf  # the instrument's zero moves by `jump_mm`
    jump_mm: float = 0.0
    instrument_sense: int = 1  # -1: readings fall when the axis advances
    faster: float = 1.0  # than the drive was ordered
    torque_percent: float | None = None
    limited: bool | None = None
    false_arrival: bool = False  # target reached at once, wherever the motor is
    at_call: int = -1
    error: Callable[[], BaseException] = KeyboardInterrupt
    stop_error: Callable[[], BaseException] | None = None  # what quick_stop raises


@dataclass
class ToyMachine:
    """True state: motor -> nut (play) -> table (wave), and the instrument's noise per arrival."""

    play_mm: float = 0.02
    wave_um: float = 5.0
    wave_period_mm: float = 40.0
    noise_um: float = 0.0
    seed: int = 1
    clock: SimClock = field(default_factory=SimClock)
    trouble: Trouble = field(default_factory=Trouble)
    state: DriveState = DriveState.SWITCH_ON_DISABLED
    motor_mm: float = 40.0
    first_reading_s: float = 0.0
    temperatures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.target_mm = self.motor_mm
        self.velocity_mm_s = 1.0
        self.nut_mm = self.motor_mm
        self.homed = False
        self.homing = False
        self.calls: list[tuple[str, float]] = []
        self.counted = 0
        self.lowest_mm = self.highest_mm = self.motor_mm
        self.travel_since_reversal_mm = 0.0
        self.direction = 0
        self.readings: list[Reading] = []
        self.sequence = 0
        self.arrival_um = 0.0
        self.seen_mm = OFFSET_MM
        self._random = np.random.default_rng(self.seed)
        self._next_reading_ns = round(self.first_reading_s * NS_PER_S)
        self.clock.attach(self.advance)

    @property
    def now_s(self) -> float:
        return self.clock.now_ns() / NS_PER_S

    @property
    def moving(self) -> bool:
        return self.motor_mm != self.target_mm and self.state is DriveState.ENABLED

    @property
    def table_mm(self) -> float:
        wave = self.wave_um * math.sin(2 * math.pi * self.nut_mm / self.wave_period_mm)
        return self.nut_mm + (wave + self.arrival_um) / 1000.0

    def count(self) -> None:
        """Count one call; the chosen one raises `Trouble.error`."""
        self.counted += 1
        if self.counted == self.trouble.at_call:
            raise self.trouble.error()

    def told(self, what: str) -> list[float]:
        return [value for name, value in self.calls if name == what]

    def advance(self, now_ns: int, dt_s: float) -> None:
        trouble, now_s = self.trouble, now_ns / NS_PER_S
        if now_s >= trouble.fault_at_s:
            self.state = DriveState.FAULT
        elif now_s >= trouble.drop_out_at_s:
            self.state = DriveState.SWITCH_ON_DISABLED
        elif now_s >= trouble.limit_switch_at_s and self.state is DriveState.ENABLED:
            self.state = DriveState.QUICK_STOP
        if self.moving and now_s < trouble.stuck_at_s:
            self._move(dt_s)
        while self._next_reading_ns <= now_ns:
            self._read(self._next_reading_ns)
            self._next_reading_ns += READING_NS

    def _move(self, dt_s: float) -> None:
        left = self.target_mm - self.motor_mm
        step = math.copysign(min(abs(left), self.trouble.faster * self.velocity_mm_s * dt_s), left)
        sign = 1 if step > 0 else -1
        self.travel_since_reversal_mm = abs(step) + (self.travel_since_reversal_mm if sign == self.direction else 0.0)
        self.direction = sign
        self.motor_mm = self.target_mm if abs(left) <= abs(step) else self.motor_mm + step
        self.nut_mm = min(max(self.nut_mm, self.motor_mm - self.play_mm / 2), self.motor_mm + self.play_mm / 2)
        self.lowest_mm = min(self.lowest_mm, self.motor_mm)
        self.highest_mm = max(self.highest_mm, self.motor_mm)
        if self.motor_mm == self.target_mm:
            self.arrival_um = float(self._random.normal(0.0, self.noise_um)) if self.noise_um else 0.0
            if self.homing:
                self.homed, self.homing = True, False

    def _read(self, time_ns: int) -> None:
        if time_ns / NS_PER_S >= self.trouble.silent_at_s:
            return
        lost = time_ns / NS_PER_S >= self.trouble.beam_lost_at_s
        status = ReadingStatus.BEAM_LOST if lost else ReadingStatus.GOOD
        if time_ns / NS_PER_S < self.trouble.frozen_readings_at_s:
            self.seen_mm = self.trouble.instrument_sense * self.table_mm + OFFSET_MM
        jumped_mm = self.trouble.jump_mm if time_ns / NS_PER_S >= self.trouble.jump_at_s else 0.0
        position = None if lost else self.seen_mm + jumped_mm
        self.readings.append(Reading(time_ns, status, position, self.sequence))
        self.sequence += 1


class ToyDrive(ServoDrive):
    """The motor's drive."""

    missing: frozenset[Capability] = frozenset()

    def __init__(self, machine: ToyMachine, limits: DriveLimits = LIMITS) -> None:
        super().__init__("toy", AxisScaling(10_000, 10.0), limits, machine.clock)
        self.machine = machine
        self.is_open = False
        self._last: DriveSample | None = None

    def _reach(self) -> ToyMachine:
        if not self.is_open or self.machine.now_s >= self.machine.trouble.link_lost_at_s:
            raise LinkLostError("drive toy: nobody there")
        self.machine.count()
        return self.machine

    def open(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    @property
    def capabilities(self) -> frozenset[Capability]:
        return frozenset({Capability.PROFILE_POSITION, Capability.HOMING}) - self.missing

    def sample(self) -> DriveSample:
        machine = self._reach()
        if machine.now_s >= machine.trouble.frozen_samples_at_s and self._last is not None:
            return self._last
        stands = machine.motor_mm == machine.target_mm or machine.state is DriveState.QUICK_STOP
        self._last = DriveSample(
            machine.clock.now_ns(),
            machine.state,
            machine.motor_mm,
            target_reached=stands or machine.trouble.false_arrival,
            torque_percent=machine.trouble.torque_percent,
            homed=machine.homed,
            limited=machine.trouble.limited,
            fault_code=0x7305 if machine.state is DriveState.FAULT else None,
        )
        return self._last

    def _enable(self) -> None:
        machine = self._reach()
        machine.calls.append(("enable", machine.motor_mm))
        machine.target_mm = machine.motor_mm
        machine.state = DriveState.ENABLED

    def disable(self) -> None:
        machine = self._reach()
        machine.calls.append(("disable", machine.motor_mm))
        if machine.state is not DriveState.FAULT:
            machine.state = DriveState.SWITCH_ON_DISABLED
        machine.target_mm = machine.motor_mm

    def send_stop(self) -> None:
        self.machine.calls.append(("stop frame", self.machine.motor_mm))

    def quick_stop(self) -> None:
        machine = self.machine
        machine.calls.append(("quick stop", machine.motor_mm))
        if machine.trouble.stop_error is not None:
            raise machine.trouble.stop_error()
        self._reach()
        if machine.state is DriveState.ENABLED:
            machine.state = DriveState.QUICK_STOP
        machine.target_mm = machine.motor_mm
        machine.homing = False

    def reset_fault(self) -> None:
        self._reach().calls.append(("reset fault", 0.0))

    def _start_homing(self) -> None:
        machine = self._reach()
        machine.calls.append(("home", 0.0))
        machine.homed, machine.homing = False, True
        machine.target_mm, machine.velocity_mm_s = self.limits.travel_min_mm, 20.0

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        machine = self._reach()
        machine.calls.append(("move", position_load_mm))
        machine.target_mm, machine.velocity_mm_s = position_load_mm, velocity_mm_s
        machine.count()  # the answer to the order may be lost as well


class ToyInstrument(DistanceInstrument):
    """Measures the table, with a zero of its own."""

    name = "toy gauge"

    def __init__(self, machine: ToyMachine) -> None:
        self.machine = machine
        self.is_open = False
        self.open_error: BaseException | None = None

    def open(self) -> None:
        if self.open_error is not None:
            raise self.open_error
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def poll(self) -> Sequence[Reading]:
        self.machine.count()
        arrived, self.machine.readings = self.machine.readings, []
        return arrived

    def environment(self) -> Environment:
        return Environment(self.machine.clock.now_ns(), place_temps_c=dict(self.machine.temperatures))

    @property
    def sample_rate_hz(self) -> float | None:
        return 100.0


def toy_session(machine: ToyMachine, **changed: object) -> AxisSession:
    """A session over a machine; keywords change its measurement settings."""
    how = replace(MEASUREMENT, **changed)  # type: ignore[arg-type]
    return AxisSession(ToyDrive(machine), ToyInstrument(machine), how)
