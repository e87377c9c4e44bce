"""The bench: clock, feed axis, servo and laser, connected in the right order from one frozen description.

The code that makes a face of the servo on a wire attaches it to `clock`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from types import TracebackType
from typing import Self

from drivers.errors import InputError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from sim_backends import laser_effects
from sim_backends.clock import SimClock
from sim_backends.faults import Fault
from sim_backends.gauge import GaugeParameters, SimulatedGauge
from sim_backends.homing import HOMING_METHODS, LIMIT_SWITCH_AND_INDEX, Switches
from sim_backends.laser import LaserParameters, SimulatedLaser
from sim_backends.plant import switches
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.parameters import (
    PlantParameters,
    bent_axis,
    geometric_axis,
    ideal_axis,
    typical_axis,
    worn_axis,
)
from sim_backends.servo import ServoParameters, SimulatedServo
from sim_backends.terminal import TerminalInstrument

HOMING_REV_S = 5.0
"""Homing velocity towards the switch, motor revolutions per second: 50 mm/s with the usual screw, which stops within 1.3 mm behind the
switch."""
HOMING_SLOW_REV_S = 0.5
"""Homing velocity away from the switch, to the edge and the index pulse, motor revolutions per second."""
SWITCH_SPREAD_REV = 1e-4
"""Standard deviation of the switching point of a limit switch: 1 µm with the usual screw, as stated for precision switches."""
BESIDE_TRAVEL_MM = 2.0
"""Travel of a simulated axis beyond either end of its length, mm."""


@dataclass(frozen=True)
class BenchParameters:
    """All randomness is seeded; the default is a typical 500 mm axis with 10 nm per count (1 000 000 counts/rev, lead 10 mm).

    gauge: a display or gauge that measures the axis instead of the laser; the laser's faults then apply to it
    homing_method: of a drive on a wire, by 6098h, until its axis file says otherwise: 1 is the negative limit switch and the index
    pulse above it
    trigger_input: fast input of the drive, 1 or 2, connected to the instrument: a pulse with each of its samples
    """

    plant: PlantParameters = field(default_factory=lambda: typical_axis(1))
    servo: ServoParameters = field(default_factory=ServoParameters)
    laser: LaserParameters = field(default_factory=LaserParameters)
    gauge: GaugeParameters | None = None
    laser_faults: tuple[Fault, ...] = ()
    servo_faults: tuple[Fault, ...] = ()
    homing_method: int = LIMIT_SWITCH_AND_INDEX
    trigger_input: int | None = None
    step_s: float = 0.005

    def __post_init__(self) -> None:
        end_mm = self.servo.positive_limit_counts / self.servo.counts_per_rev * self.plant.screw.lead_mm
        if end_mm < (travel_mm := self.plant.begin_mm + self.plant.length_mm):
            raise InputError(
                f"bench: positive limit switch at {end_mm:g} mm, expected beyond the travel, to {travel_mm:g} mm"
            )

    @property
    def scaling(self) -> AxisScaling:
        """The scaling that a drive on this bench is given."""
        return AxisScaling(self.servo.counts_per_rev, self.plant.screw.lead_mm)

    @property
    def limits(self) -> DriveLimits:
        """The axis's travel and speeds, for a drive on this bench."""
        plant, lead_mm = self.plant, self.plant.screw.lead_mm
        return DriveLimits(
            travel_min_mm=plant.begin_mm - BESIDE_TRAVEL_MM,
            travel_max_mm=plant.begin_mm + plant.length_mm + BESIDE_TRAVEL_MM,
            max_velocity_mm_s=min(250.0, self.servo.max_velocity_rev_s * lead_mm),
            max_acceleration_mm_s2=self.servo.max_acceleration_rev_s2 * lead_mm,
        )

    @property
    def objects(self) -> dict[tuple[int, int], int]:
        """Factory settings of a CiA-402 drive for this machine: (index, subindex) -> value.

        Encoder, gear, feed per shaft revolution in units of position, and that unit (60A8h) as a power of ten of a metre where
        the count is one, else as increments (B5h); stopping and homing fit for this motor.
        """
        counts, servo = self.servo.counts_per_rev, self.servo
        exponent = math.log10(self.plant.screw.lead_mm * 1e-3 / counts)
        is_length = abs(exponent - round(exponent)) < 1e-9
        return {
            (0x608F, 1): counts,
            (0x608F, 2): 1,
            (0x6091, 1): 1,
            (0x6091, 2): 1,
            (0x6092, 1): counts,
            (0x6092, 2): 1,
            (0x60A8, 0): (round(exponent) & 0xFF) << 24 | 0x01 << 16 if is_length else 0xB5 << 16,
            (0x6085, 0): round(servo.max_acceleration_rev_s2 * counts),
            (0x607F, 0): round(servo.max_velocity_rev_s * counts),
            (0x60C5, 0): round(servo.max_acceleration_rev_s2 * counts),
            (0x60C6, 0): round(servo.max_acceleration_rev_s2 * counts),
            (0x6098, 0): self.homing_method,
            (0x607C, 0): self.home_counts,
            (0x6099, 1): round(HOMING_REV_S * counts),
            (0x6099, 2): round(HOMING_SLOW_REV_S * counts),
        }

    @property
    def home_counts(self) -> int:
        """End position of the homing method, motor counts, in the frame in which the axis's nominal zero is 0.

        0 for a method that takes the present position, or the index pulse beside it.
        """
        method, switches = HOMING_METHODS.get(self.homing_method), Switches(self.servo)
        if method is None or method.sensor is None:
            return 0
        edge = switches.edge(method.sensor)
        turn = method.final_direction * float(self.servo.counts_per_rev)
        pulse = switches.index_between(edge, edge + turn) if method.index else None
        return round(edge if pulse is None else pulse)

    @property
    def vendor_settings(self) -> dict[str, int]:
        """Homing settings of the drive with a vendor's own registers; speeds in 0.01 rpm."""
        return {
            "origin_method": self.homing_method,
            "origin_offset": self.home_counts,
            "origin_speed": round(6000 * HOMING_REV_S),
            "origin_creep": round(6000 * HOMING_SLOW_REV_S),
        }

    @property
    def micrometre_objects(self) -> dict[tuple[int, int], int]:
        """As `objects`, for a drive whose feed per revolution is in µm, whatever its position unit."""
        own = self.objects
        for key in ((0x60A8, 0), (0x607F, 0), (0x60C5, 0), (0x60C6, 0)):
            del own[key]
        return {**own, (0x6092, 1): round(self.plant.screw.lead_mm * 1000.0)}


def known_bench(kind: str, seed: int) -> BenchParameters:
    """A bench by the name of its machine: ideal, geometric, bent, typical or worn. Raises InputError for another."""
    plants = {
        "ideal": lambda _seed: ideal_axis(),
        "geometric": geometric_axis,
        "bent": bent_axis,
        "typical": typical_axis,
        "worn": worn_axis,
    }
    if kind not in plants:
        raise InputError(f"machine {kind!r}, expected one of {', '.join(plants)}")
    servo = ServoParameters()
    servo = replace(servo, switch_spread_counts=SWITCH_SPREAD_REV * servo.counts_per_rev)
    return BenchParameters(plant=plants[kind](seed), servo=servo)


class Bench:
    """A running bench. Use as a context manager: the laser's terminal is closed at the end. Raises InputError.

    wait_for_arrival False: for readers in other threads or processes (real time), which may take bytes during the wait.
    clock: an existing one, such as that of another axis of the same machine.
    """

    def __init__(
        self,
        parameters: BenchParameters | None = None,
        *,
        wait_for_arrival: bool = True,
        clock: SimClock | None = None,
    ) -> None:
        self.parameters = p = parameters or BenchParameters()
        self.clock = clock or SimClock(p.step_s)
        self.plant = FeedAxis(p.plant, p.servo.start_counts / p.servo.counts_per_rev)
        self.servo = SimulatedServo(self.plant, p.servo, p.servo_faults)
        self.laser = SimulatedLaser(self.plant, p.laser, p.laser_faults, wait_for_arrival=wait_for_arrival)
        self.clock.attach(self.servo.advance, bearable=self.servo.bearable)
        self.clock.attach(self.laser.advance, bearable=self.laser.bearable, settle=self.laser.settle)
        self.across: Bench | None = None
        self.gauge: SimulatedGauge | None = None
        if p.gauge is not None:
            self.gauge = SimulatedGauge(self.plant, p.gauge, p.laser_faults, wait_for_arrival=wait_for_arrival)
            self.clock.attach(self.gauge.advance, bearable=self.gauge.bearable, settle=self.gauge.settle)
            self.laser.close()
        self._instrument: TerminalInstrument = self.gauge or self.laser
        if p.trigger_input is not None:
            self._instrument.pulse = partial(self._pulse, p.trigger_input)

    def _pulse(self, number: int) -> None:
        for hear in self.servo.fast_inputs:
            hear(number)

    def switch_on(self, effect: str, size_um: float) -> None:
        """Add an effect to the machine or its instrument from now on, by its id in the catalogue; `plant.switches` and `laser_effects`
        define `size_um`, µm. Raises InputError for an unknown id."""
        if effect in laser_effects.SWITCHES and self.gauge is not None:
            raise InputError(f"effect {effect!r} is a laser's, and this bench measures with a gauge")
        if effect in laser_effects.SWITCHES:
            laser_effects.switch_on(self.laser, self.plant, effect, size_um)
        elif effect in switches.SWITCHES:
            switches.switch_on(self.plant, effect, size_um)
        else:
            known = ", ".join([*switches.SWITCHES, *laser_effects.SWITCHES])
            raise InputError(f"effect {effect!r} cannot be switched on in the bench, expected one of {known}")

    def cross(self, other: Bench) -> None:
        """Make the axes of two benches those of one machine, at right angles (`FeedAxis.across`)."""
        self.across, other.across = other, self
        self.plant.across, other.plant.across = other.plant, self.plant

    @property
    def laser_path(self) -> str:
        """Path of the port that a reader of the instrument opens."""
        return self._instrument.path

    @property
    def has_instrument(self) -> bool:
        """Whether the instrument's terminal is open."""
        return self._instrument.is_open

    def close_instrument(self) -> None:
        """Close the instrument's terminal; readers then see the port vanish."""
        self._instrument.close()

    def close(self) -> None:
        self.close_instrument()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
