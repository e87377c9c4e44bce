"""VirtualDrive: the in-process drive, `ServoDrive` directly over the servo firmware, without a wire.

For tests of procedures and for demonstrations without a wire. It implements the guarantees of every abstract method itself
(demand := actual before power, target_reached false at once), as a drive on a wire has to.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Final

from drivers.clock import Clock
from drivers.drive import Capability, DriveSample, DriveState, DriveZero
from drivers.errors import (
    CapabilityError,
    DriveFaultError,
    HeldUnderPowerError,
    InputError,
    LinkLostError,
    MotionTimeoutError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.paced_stream import HostPacedDrive
from drivers.scaling import AxisScaling
from drivers.touch_probe import TouchProbe
from sim_backends.clock import SimClock
from sim_backends.control_wires import Wires
from sim_backends.own_table import TableForm
from sim_backends.probe_latch import ProbeLatch
from sim_backends.servo import SimulatedServo
from sim_backends.virtual_faces import (
    VirtualCorrectionTable,
    VirtualDriveSettings,
    VirtualParameters,
    VirtualTouchProbe,
)

__all__ = ["VirtualDrive", "VirtualDriveSettings"]


_IDLE_STEP_NS = 60_000_000_000  # longest step of the probe's inputs, as of the servo
_CAPABILITIES = frozenset(Capability) - {Capability.STORE}


class VirtualDrive(HostPacedDrive):
    """A drive without a wire. Simulated time must be running (`SimClock` with the servo attached). Raises CapabilityError."""

    def __init__(
        self,
        servo: SimulatedServo,
        scaling: AxisScaling,
        limits: DriveLimits,
        clock: Clock,
        *,
        name: str = "virtual",
        settings: VirtualDriveSettings | None = None,
        table: TableForm | None = None,
    ) -> None:
        super().__init__(name, scaling, limits, clock)
        self._servo = servo
        self.settings: Final = replace(settings or VirtualDriveSettings())  # a copy, which its parameters change
        if scaling.motor_revs_per_shaft_rev != Fraction(1):
            raise InputError(
                f"drive {name}: gear ratio is {scaling.motor_revs_per_shaft_rev}, the virtual drive expects 1 (direct)"
            )
        self._open = False
        self._counts_per_mm = scaling.direction * scaling.counts_per_load_mm
        self.probe = ProbeLatch(servo)
        self.wires = Wires()
        if isinstance(clock, SimClock):  # after the servo, which is attached before
            clock.attach(lambda now_ns, _dt_s: self.probe.tick(now_ns), bearable=lambda _now_ns: _IDLE_STEP_NS)
        self._parameters = VirtualParameters(name, scaling, self.settings)
        self._table = None if table is None else VirtualCorrectionTable(name, table, lambda: servo.powered)
        if self._table is not None:
            servo.table.follow(self._table.own)

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        self._open = True

    def close(self) -> None:
        if not self._open:
            return
        try:
            self.disable()
        finally:
            self._open = False

    @property
    def capabilities(self) -> frozenset[Capability]:
        return _CAPABILITIES - self.settings.missing

    # -- reading ---------------------------------------------------------------------------------------------------
    def sample(self) -> DriveSample:
        self._require_open()
        servo, counts_per_mm, state = self._servo, self._counts_per_mm, self._state()
        return DriveSample(
            time_ns=self.clock.now_ns(),
            state=state,
            position_load_mm=servo.position_actual_counts / counts_per_mm,
            target_reached=servo.target_reached and state is DriveState.ENABLED,
            velocity_mm_s=servo.velocity_actual_counts_s / counts_per_mm,
            torque_percent=self.scaling.direction * servo.torque_actual_permille / 10.0,
            following_error_mm=servo.following_error_counts / counts_per_mm,
            homed=servo.homed,
            fault_code=servo.fault_code or None,
        )

    def zero(self) -> DriveZero:
        return DriveZero(self.settings.homing_method, self.settings.home_position_mm, {"model": "virtual"})

    def _state(self) -> DriveState:
        servo = self._servo
        if servo.fault_code:
            return DriveState.FAULT
        if not servo.powered:
            return DriveState.SWITCH_ON_DISABLED
        return DriveState.QUICK_STOP if servo.stopping else DriveState.ENABLED

    def _require_open(self) -> None:
        if not self._open:
            raise LinkLostError(f"drive {self.name} is not open")

    def _counts_s2(self, acceleration_mm_s2: float) -> int:
        return self.scaling.motor_counts_per_s(acceleration_mm_s2)

    # -- states ----------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self._require_open()
        if self._servo.powered and self._servo.stopping:
            raise StateError(f"drive {self.name} cannot enable: it is held by a quick stop, disable it first")
        self._servo.power_on()  # sets the demand to the actual position before the loop closes

    def disable(self) -> None:
        """Stop if moving, then power off. An axis that does not come to rest is quick-stopped, and disabled all the same.

        Raises HeldUnderPowerError for an axis that would then fall; it stays under power, quick-stopped.
        """
        self._require_open()
        servo = self._servo
        if not servo.powered:
            return
        try:
            if not servo.stopping:  # a quick stop in progress has the shorter ramp
                servo.halt(self._counts_s2(self.settings.acceleration_mm_s2))
            seen = self._comes_to_rest()
        except BaseException:
            self.send_stop()
            raise
        if not seen:
            self.send_stop()
            if not self._comes_to_rest() and self.falls_without_power:
                raise HeldUnderPowerError(
                    f"drive {self.name}: not seen at rest within {self.settings.stop_timeout_s:g} s of a quick stop; gravity can move"
                    " the axis and no brake is stated, so it stays under power, held by its drive"
                )
        servo.power_off()

    def _comes_to_rest(self) -> bool:
        try:
            self.wait_for(
                lambda sample: sample.velocity_mm_s == 0.0 or sample.state is not DriveState.QUICK_STOP,
                self.settings.stop_timeout_s,
                "standstill before power off",
            )
        except MotionTimeoutError:
            return False
        return True

    def send_stop(self) -> None:
        if self._open:
            self._servo.quick_stop(self._counts_s2(self.settings.quick_stop_mm_s2))

    def quick_stop(self) -> None:
        """Confirmed by returning: there is no wire on which it could be lost."""
        self._require_open()
        self.send_stop()

    def reset_fault(self) -> None:
        self._require_open()
        self._servo.power_off()
        self._servo.reset_fault()

    # -- motion ----------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        settings, scaling = self.settings, self.scaling
        self._servo.start_homing(
            settings.homing_method,
            scaling.motor_counts_per_s(settings.homing_speed_switch_mm_s),
            scaling.motor_counts_per_s(settings.homing_speed_zero_mm_s),
            scaling.motor_counts(settings.home_position_mm),
        )
        if self._servo.homing_error:
            self.send_stop()  # ends a motion in progress
            raise CapabilityError(f"drive {self.name} has no homing method {settings.homing_method}")

    def begin_stream(self) -> DriveSample:
        sample = self.sample()
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {self.name} cannot stream: it is {sample.state.value}")
        self._servo.cyclic_position(self._servo.position_demand_counts)
        return sample

    def send_set_point(self, position_load_mm: float) -> None:
        self._servo.cyclic_position(self.scaling.motor_counts(position_load_mm))

    def end_stream(self) -> None:
        """The servo holds its last set-point by itself."""

    # -- touch probe, parameters, table ----------------------------------------------------------------------------
    def _touch_probe(self) -> TouchProbe:
        return VirtualTouchProbe(self.name, self.clock, self.probe, self.scaling)

    @property
    def parameters(self) -> VirtualParameters:
        """Ramps and homing, in the units of a drive on a wire."""
        self.require(Capability.PARAMETERS)
        return self._parameters

    @property
    def correction_table(self) -> VirtualCorrectionTable | None:
        self._require_open()
        return self._table

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        self._servo.move_absolute(
            self.scaling.motor_counts(position_load_mm),
            self.scaling.motor_counts_per_s(velocity_mm_s),
            self._counts_s2(self.settings.acceleration_mm_s2),
        )
        if self._servo.fault_code:
            raise DriveFaultError(f"drive {self.name} went into a fault", self._servo.fault_code)
