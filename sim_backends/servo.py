"""SimulatedServo: the firmware of a servo drive without a protocol: power stage, set-point generator, homing, supervision.

Every face (in-process, CANopen, Modbus) shows the same `SimulatedServo`; none has physics of its own. Units are the drive's own:
motor counts, counts/s, counts/s², torque in 0.1 % of rated. Inside, positions are floats in the frame of the motor's shaft ("shaft
counts"); homing only shifts the shown positions.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from enum import Enum

from drivers.errors import InputError
from sim_backends.backlash_compensation import BacklashCompensation, Mechanics
from sim_backends.faults import Fault, FaultKind, FaultSchedule
from sim_backends.homing import HOMING_METHODS, HomingRun, HomingSensor, Switches
from sim_backends.motion_profile import Profile, plan_move, plan_stop, plan_velocity
from sim_backends.own_table import TableStage
from sim_backends.servo_parameters import ServoParameters

__all__ = ["FAULT_FOLLOWING_ERROR", "MotionMode", "ServoParameters", "SimulatedServo"]

FAULT_FOLLOWING_ERROR = 0x8611  # CiA-402 error code: following error

_FAR_NS = 1 << 62
_MOVING_NS = 10_000_000  # longest step of a moving axis
_AT_REST_NS = 60_000_000_000  # longest step of an axis at rest
_SETTLED_COUNTS = 0.02  # a smaller lag is ignored


class MotionMode(Enum):
    """Modes of the set-point generator."""

    IDLE = "idle"  # hold the demand position
    PROFILE_POSITION = "profile position"
    PROFILE_VELOCITY = "profile velocity"
    HOMING = "homing"
    CYCLIC_POSITION = "cyclic synchronous position"
    CYCLIC_VELOCITY = "cyclic synchronous velocity"
    CYCLIC_TORQUE = "cyclic synchronous torque"


class SimulatedServo:
    """A drive with its motor, turning a `Mechanics`. Readings are of the present simulated time.

    Motion orders are without effect while unpowered or while a stop runs or holds, as on a real drive.

    backlash, table: stages that a face connects to its parameters. fast_inputs: called with the number of the input, 1 or 2, at the
    time of a pulse on it. stopping: a quick stop or halt runs, or holds. fault_code: 0 = none, else an error code of CiA 402 (603Fh).
    """

    def __init__(
        self, mechanics: Mechanics, parameters: ServoParameters | None = None, faults: tuple[Fault, ...] = ()
    ) -> None:
        self.parameters = p = parameters or ServoParameters()
        self.mechanics = mechanics
        self.backlash = BacklashCompensation(mechanics, p.counts_per_rev)
        self.table = TableStage()
        self.fast_inputs: list[Callable[[int], None]] = []
        self._rng = random.Random(p.seed)
        self.powered = False
        self.stopping = False
        self.homed = False
        self.homing_error = False
        self.target_reached = True
        self.mode = MotionMode.IDLE
        self.fault_code = 0
        self._frame = 0.0  # shown position = shaft counts − frame
        self._actual = p.start_counts
        self._actual_velocity = 0.0
        self._demand = p.start_counts
        self._demand_velocity = 0.0
        self._acceleration = 0.0
        self._profile: Profile | None = None
        self._profile_s = 0.0
        self._target = p.start_counts
        self._in_window_s = 0.0
        self._lagging_s = 0.0
        self._moving = False  # whether anything but time has to be advanced
        self._cycle_left_s = 0.0
        self._cycle_s = p.default_cycle_s
        self._cycle_order_ns = -1
        self._torque_order = 0.0
        self._switches = Switches(p)
        self._homing: HomingRun | None = None
        self._homing_offset = 0
        self._now_ns = 0
        self.schedule(faults)
        self._encoder_rng = random.Random(p.seed + 1)
        self._noise_ns = -1
        self._noise = 0.0
        self._decay_dt_s = -1.0
        self._decay = 1.0
        self._max_velocity = p.max_velocity_rev_s * p.counts_per_rev
        self._max_acceleration = p.max_acceleration_rev_s2 * p.counts_per_rev
        self._homing_acceleration = p.homing_acceleration_rev_s2 * p.counts_per_rev

    # -- readings --------------------------------------------------------------------------------------------------
    @property
    def position_demand_counts(self) -> int:
        """Position demand in the shown frame, counts."""
        return round(self._demand - self._frame)

    @property
    def position_actual_counts(self) -> int:
        """Actual position in the shown frame, counts, with the encoder's noise."""
        noise = self.parameters.encoder_noise_counts
        return round(self._actual - self._frame + (self._encoder_rng.gauss(0.0, noise) if noise else 0.0))

    @property
    def velocity_actual_counts_s(self) -> int:
        return round(self._actual_velocity)

    @property
    def following_error_counts(self) -> int:
        """Demand − actual, counts."""
        return round(self._demand) - round(self._actual)

    @property
    def torque_actual_permille(self) -> int:
        """Torque, 0.1 % of rated."""
        if not self.powered:
            return 0
        p = self.parameters
        if self._noise_ns != self._now_ns:
            self._noise_ns = self._now_ns
            self._noise = self._rng.gauss(0.0, p.torque_noise_permille + self._more_noise)
        speed = self._actual_velocity / p.counts_per_rev
        torque = self.mechanics.friction_permille + self._noise
        if p.cogging_permille:
            torque += p.cogging_permille * math.sin(math.tau * p.cogging_per_rev * self._actual / p.counts_per_rev)
        if speed:
            torque += math.copysign(p.motor_friction_permille, speed) + p.viscous_permille * speed
            torque += p.inertia_permille * self._acceleration / p.counts_per_rev
        return round(max(-p.peak_torque_permille, min(p.peak_torque_permille, torque)))

    @property
    def positive_limit_switch(self) -> bool:
        return self._switches.positive_limit(self._actual)

    @property
    def negative_limit_switch(self) -> bool:
        return self._switches.negative_limit(self._actual)

    @property
    def home_switch(self) -> bool:
        return self._switches.home(self._actual)

    @property
    def motor_rev(self) -> float:
        """True position of the shaft, revolutions."""
        return self._actual / self.parameters.counts_per_rev

    def bearable(self, now_ns: int) -> int:
        """For SimClock: longest next step, ns; long for an axis at rest, short for a moving one."""
        if self._moving:
            return _MOVING_NS
        return min(_AT_REST_NS, max(1, self._fault_change_ns - now_ns))

    def schedule(self, faults: tuple[Fault, ...]) -> None:
        """Replace the schedule of faults; only those of the drive's kinds act."""
        self._faults = FaultSchedule(faults)
        self._jammed = False
        self._more_noise = 0.0
        self._fault_change_ns = 0
        self._plan_faults()

    def add_faults(self, faults: tuple[Fault, ...]) -> None:
        """Add to the schedule of faults, while the servo runs."""
        self._faults.add(faults)
        self._fault_change_ns = 0  # they may begin now

    def _plan_faults(self) -> None:
        change_s = self._faults.next_change_s(self._now_ns * 1e-9)
        self._fault_change_ns = _FAR_NS if math.isinf(change_s) else round(change_s * 1e9)

    def _meet_faults(self) -> None:
        """Apply faults that begin or end at this time."""
        self._jammed = False
        self._more_noise = 0.0
        for fault in self._faults.active(self._now_ns * 1e-9):
            if fault.kind is FaultKind.DRIVE_FAULT:
                self.raise_fault(int(fault.size))
            elif fault.kind is FaultKind.JAM:
                self._jammed = True
            elif fault.kind is FaultKind.TORQUE_NOISE:
                self._more_noise = fault.size
        self._plan_faults()

    # -- motion orders ---------------------------------------------------------------------------------------------
    def power_on(self) -> None:
        """Close the loop at the present position; does nothing in a fault."""
        if self.fault_code or self.powered:
            return
        self._hold_here()
        self.powered = True

    def power_off(self) -> None:
        """Open the loop; a moving axis coasts to rest."""
        if not self.powered:
            return
        self.powered = False
        self.stopping = False
        self._abort_homing()
        self.mode = MotionMode.IDLE
        self._coast(self.parameters.coast_rev_s2)

    def quick_stop(self, deceleration_counts_s2: float) -> None:
        self._stop(deceleration_counts_s2)

    def halt(self, deceleration_counts_s2: float) -> None:
        self._stop(deceleration_counts_s2)

    def resume(self) -> None:
        """End a halt or a quick stop that holds; the demand stays unchanged."""
        self.stopping = False

    def move_absolute(self, target_counts: int, velocity_counts_s: float, acceleration_counts_s2: float) -> None:
        """Profile move to a shown position, counts, whatever the demand does at present."""
        if not self._takes_orders():
            return
        self.mode = MotionMode.PROFILE_POSITION
        self._target = target_counts + self._frame
        acceleration = self._allowed(acceleration_counts_s2, self._max_acceleration)
        self._run(
            plan_move(
                self._demand,
                self._demand_velocity,
                self._target,
                max_velocity=self._allowed(velocity_counts_s, self._max_velocity),
                acceleration=acceleration,
                deceleration=acceleration,
            )
        )

    def move_velocity(self, velocity_counts_s: float, acceleration_counts_s2: float) -> None:
        """Profile velocity, signed counts/s."""
        if not self._takes_orders():
            return
        self.mode = MotionMode.PROFILE_VELOCITY
        self._ramp_to(velocity_counts_s, self._allowed(acceleration_counts_s2, self._max_acceleration))

    def start_homing(
        self, method: int, speed_switch_counts_s: float, speed_zero_counts_s: float, offset_counts: int
    ) -> None:
        """Home; the home position is then shown as `offset_counts`. An unknown method ends with homing_error at once."""
        if not self._takes_orders():
            return
        self.mode = MotionMode.HOMING
        self.homed = False
        self.homing_error = False
        plan = HOMING_METHODS.get(method)
        if plan is None or speed_switch_counts_s <= 0 or speed_zero_counts_s <= 0:
            self.homing_error = True
            return
        self._homing_offset = offset_counts
        self._switches.trip_anew()
        self._homing = HomingRun(
            plan,
            self._switches,
            self._allowed(speed_switch_counts_s, self._max_velocity),
            self._allowed(speed_zero_counts_s, self._max_velocity),
        )
        self._ramp_to(self._homing.begin(self._actual), self._homing_acceleration)

    def cyclic_position(self, target_counts: int) -> None:
        """Next target of a stream, counts; the demand goes there in a straight line within one period of the stream."""
        if not self._takes_orders():
            return
        if self.mode is MotionMode.CYCLIC_POSITION and self._now_ns > self._cycle_order_ns:
            self._cycle_s = min(0.1, (self._now_ns - self._cycle_order_ns) * 1e-9)
        elif self.mode is not MotionMode.CYCLIC_POSITION:
            self._cycle_s = self.parameters.default_cycle_s
        self._cycle_order_ns = self._now_ns
        self.mode = MotionMode.CYCLIC_POSITION
        target = target_counts + self._frame
        if (target > self._demand and self.positive_limit_switch) or (
            target < self._demand and self.negative_limit_switch
        ):
            return  # a stream does not push an axis further into its limit switch
        self._profile = None
        self._target = target
        self._cycle_left_s = self._cycle_s
        self._moving = True

    def cyclic_velocity(self, velocity_counts_s: float) -> None:
        """Next velocity of a stream, signed counts/s."""
        if not self._takes_orders():
            return
        self.mode = MotionMode.CYCLIC_VELOCITY
        self._ramp_to(velocity_counts_s, self._max_acceleration)

    def cyclic_torque(self, torque_permille: int) -> None:
        """Next torque of a stream, 0.1 % of rated."""
        if not self._takes_orders():
            return
        self.mode = MotionMode.CYCLIC_TORQUE
        self._profile = None
        self._torque_order = float(torque_permille)
        self._moving = True

    def raise_fault(self, code: int) -> None:
        """Switch power off with an error code; the axis is braked with the largest deceleration."""
        self.fault_code = code
        if self.powered:
            self.powered = False
            self.stopping = False
            self._abort_homing()
            self.mode = MotionMode.IDLE
            self._coast(self.parameters.max_acceleration_rev_s2)

    def reset_fault(self) -> None:
        """Clear the fault; the power stays off."""
        self.fault_code = 0

    # -- helpers of the motion orders --------------------------------------------------------------------------------
    def _takes_orders(self) -> bool:
        if not self.powered or self.stopping:
            return False
        self._abort_homing()
        return True

    def _abort_homing(self) -> None:
        if self._homing is not None:
            self._homing = None
            self.mode = MotionMode.IDLE

    @staticmethod
    def _allowed(value: float, largest: float) -> float:
        return min(abs(value), largest) or 1.0

    def _run(self, profile: Profile) -> None:
        self._profile = profile
        self._profile_s = 0.0
        self.target_reached = False
        self._in_window_s = 0.0
        self._moving = True

    def _ramp_to(self, velocity: float, acceleration: float) -> None:
        velocity = max(-self._max_velocity, min(self._max_velocity, velocity))
        self._run(plan_velocity(self._demand, self._demand_velocity, velocity, acceleration))

    def _stop(self, deceleration_counts_s2: float) -> None:
        if not self.powered:
            return
        self._abort_homing()
        self.mode = MotionMode.IDLE
        self.stopping = True
        self._brake(self._allowed(deceleration_counts_s2, self._max_acceleration))

    def _brake(self, deceleration: float) -> None:
        self._run(plan_stop(self._demand, self._demand_velocity, deceleration))
        self._target = math.nan

    def _coast(self, deceleration_rev_s2: float) -> None:
        self._demand, self._demand_velocity = self._actual, self._actual_velocity
        self._run(plan_stop(self._actual, self._actual_velocity, deceleration_rev_s2 * self.parameters.counts_per_rev))
        self._target = math.nan

    def _hold_here(self) -> None:
        self.mode = MotionMode.IDLE
        self._profile = None
        self._demand = self._target = self._actual
        self._demand_velocity = 0.0
        self._lagging_s = 0.0
        self.target_reached = True

    # -- time ------------------------------------------------------------------------------------------------------
    def advance(self, now_ns: int, dt_s: float) -> None:
        """Advance drive, motor and mechanics from now_ns − dt_s to now_ns."""
        self._now_ns = now_ns
        if now_ns >= self._fault_change_ns:
            self._meet_faults()
        if not self._moving:
            self._turn_shaft(dt_s)
            return
        before, velocity_before = self._actual, self._actual_velocity
        demand_before = self._demand
        self._advance_demand(dt_s)
        if self.powered:
            self._follow(demand_before, dt_s)
        else:
            self._actual, self._actual_velocity = self._demand, self._demand_velocity
        p = self.parameters
        if self._jammed:
            self._actual, self._actual_velocity = before, 0.0
        if not p.negative_stop_counts <= self._actual <= p.positive_stop_counts:
            self._actual = max(p.negative_stop_counts, min(p.positive_stop_counts, self._actual))
            self._actual_velocity = 0.0
        self._acceleration = (self._actual_velocity - velocity_before) / dt_s
        self._turn_shaft(dt_s)
        if self._homing is not None:
            self._advance_homing(self._homing, before)
        self._watch_limits()
        self._supervise(dt_s)

    def _turn_shaft(self, dt_s: float) -> None:
        """Add the drive's own table to the shown position, then its backlash compensation."""
        added = self.table.step(self._shown_demand, powered=self.powered, homed=self.homed, dt_s=dt_s)
        self.backlash.step(self._actual + added, dt_s)

    def _shown_demand(self) -> float:
        return self._demand - self._frame

    def _advance_demand(self, dt_s: float) -> None:
        if self._profile is not None:
            self._profile_s += dt_s
            self._demand, self._demand_velocity, _ = self._profile.at(self._profile_s)
            if math.isnan(self._demand):
                raise InputError("servo: a motion profile ended at no position, expected a number")
            if self._profile_s >= self._profile.duration_s:
                self._profile = None
        elif self.mode is MotionMode.CYCLIC_POSITION:
            if self._cycle_left_s > dt_s:
                moved = (self._target - self._demand) * dt_s / self._cycle_left_s
                self._cycle_left_s -= dt_s
            else:
                moved = self._target - self._demand
                self._cycle_left_s = 0.0
            self._demand += moved
            self._demand_velocity = moved / dt_s
        elif self.mode is MotionMode.CYCLIC_TORQUE and self.powered:
            self._advance_torque(dt_s)
        else:
            self._demand_velocity = 0.0

    def _advance_torque(self, dt_s: float) -> None:
        """Free motion under a torque: J·v' = M − friction − viscous·v; friction only brakes."""
        p = self.parameters
        speed = self._actual_velocity / p.counts_per_rev
        friction = p.motor_friction_permille + abs(self.mechanics.friction_permille)
        drive = self._torque_order - p.viscous_permille * speed
        if speed == 0.0:
            drive = math.copysign(max(0.0, abs(drive) - friction), drive)
        else:
            drive -= math.copysign(friction, speed)
        new_speed = speed + drive / p.inertia_permille * dt_s
        if speed * new_speed < 0.0:
            new_speed = 0.0
        new_speed = max(-p.max_velocity_rev_s, min(p.max_velocity_rev_s, new_speed))
        self._demand_velocity = new_speed * p.counts_per_rev
        self._demand = self._actual + 0.5 * (self._actual_velocity + self._demand_velocity) * dt_s

    def _follow(self, demand_before: float, dt_s: float) -> None:
        """First-order position loop with velocity feed-forward, exact for a demand of constant velocity within the step."""
        p = self.parameters
        if self.mode is MotionMode.CYCLIC_TORQUE:
            self._actual, self._actual_velocity = self._demand, self._demand_velocity
            return
        if dt_s != self._decay_dt_s:
            self._decay_dt_s = dt_s
            self._decay = math.exp(-p.position_gain_per_s * dt_s)
        velocity = (self._demand - demand_before) / dt_s
        steady = (1.0 - p.feed_forward) * velocity / p.position_gain_per_s
        lag = steady + (demand_before - self._actual - steady) * self._decay
        if velocity == 0.0 and -_SETTLED_COUNTS < lag < _SETTLED_COUNTS:
            lag = 0.0
        moved = self._demand - lag - self._actual
        largest = 1.1 * self._max_velocity * dt_s
        moved = max(-largest, min(largest, moved))
        self._actual += moved
        self._actual_velocity = moved / dt_s

    def _watch_limits(self) -> None:
        """End any motion into a limit switch with the steepest ramp; homing handles its own switch."""
        velocity = self._demand_velocity
        if velocity == 0.0 or not self.powered or self.stopping:
            return
        if velocity > 0.0 and self.positive_limit_switch:
            sensor = HomingSensor.POSITIVE_LIMIT
        elif velocity < 0.0 and self.negative_limit_switch:
            sensor = HomingSensor.NEGATIVE_LIMIT
        else:
            return
        if self._homing is not None:
            if self._homing.method.sensor is sensor:
                return
            self.homing_error = True
            self._abort_homing()
        elif self._profile is not None and self.mode is MotionMode.IDLE:
            return  # that ramp is already running
        self.mode = MotionMode.IDLE
        self._brake(self._max_acceleration)

    def _advance_homing(self, homing: HomingRun, before: float) -> None:
        at_rest = self._profile is None and self._actual == self._demand
        velocity = homing.step(before, self._actual, at_rest)
        if velocity is not None:
            self._ramp_to(velocity, self._homing_acceleration)
        elif homing.done:
            self._frame = homing.latch - self._homing_offset
            self.homed = True
            self._homing = None
            self._target = self._demand
            self.target_reached = True

    def _supervise(self, dt_s: float) -> None:
        p = self.parameters
        lag = self._demand - self._actual
        if self.powered and abs(lag) > p.following_window_counts:
            self._lagging_s += dt_s
            if self._lagging_s > p.following_timeout_s:
                self.raise_fault(FAULT_FOLLOWING_ERROR)
                return
        else:
            self._lagging_s = 0.0
        if self._profile is not None:
            if self.mode is MotionMode.PROFILE_VELOCITY:
                self.target_reached = self._demand_velocity == self._profile.end_velocity
            return
        if self.mode is MotionMode.CYCLIC_TORQUE or self._homing is not None:
            return
        if self.mode is MotionMode.PROFILE_POSITION and not self.target_reached:
            self._in_window_s = self._in_window_s + dt_s if abs(lag) <= p.position_window_counts else 0.0
            self.target_reached = self._in_window_s >= p.position_window_s
        resting = lag == 0.0 and self._actual_velocity == 0.0 and self._demand_velocity == 0.0
        if resting:
            if self.mode is not MotionMode.PROFILE_POSITION:
                # a ramp that ended on a limit switch has not reached its target
                self.target_reached = self.stopping or not math.isnan(self._target) or not self.powered
            if self.target_reached or self.mode is not MotionMode.PROFILE_POSITION:
                self._moving = False
                self._acceleration = 0.0
