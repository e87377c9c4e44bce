"""CiA-402 as the simulated drive obeys it: power state machine, modes, set-point handshake, homing, supervision.

Implements the objects 6007h to 60FFh over a `SimulatedServo`. State patterns and transitions come from the tables of `drivers.cia402`,
which the master uses too (checked against literal vectors); everything else is written for the drive's side alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.cia402.state_machine import (
    QUICK_STOP_ENDINGS,
    Command,
    Ramp,
    TransitionCause,
    decode_command,
    is_fault_reset,
    next_state,
    state_bits,
)
from drivers.drive import DriveState
from sim_backends.canopen_dictionary import INVALID_VALUE, Dictionary, RefusedError
from sim_backends.canopen_touch_probe import TouchProbeUnit
from sim_backends.control_wires import Wires
from sim_backends.faults import CanFaultKind
from sim_backends.servo import MotionMode, SimulatedServo

PP, PV, HM, CSP, CSV, CST = 1, 3, 6, 8, 9, 10
NO_MODE = 0

VOLTAGE, QUICK_STOP_OFF, REMOTE, REACHED, INTERNAL_LIMIT = 0x0010, 0x0020, 0x0200, 0x0400, 0x0800
BIT_12, BIT_13 = 0x1000, 0x2000
NEW_SETPOINT, IMMEDIATELY, RELATIVE, HALT = 0x0010, 0x0020, 0x0040, 0x0100

FOLLOWING_ERROR = 0x8611
POWERED_STATES = (DriveState.SWITCHED_ON, DriveState.ENABLED, DriveState.QUICK_STOP, DriveState.FAULT_REACTION)
FAULT_STATES = (DriveState.FAULT, DriveState.FAULT_REACTION)


@dataclass(frozen=True)
class _Setpoint:
    target: int
    velocity: int
    acceleration: int


class DriveProfile:
    """The drive's application behind its dictionary. `tick` is called whenever simulated or real time has advanced.

    emergency(code): called when a fault came (code) or went (0).
    """

    def __init__(self, dictionary: Dictionary, servo: SimulatedServo, emergency: Callable[[int], None]) -> None:
        self._od = dictionary
        self._servo = self.servo = servo
        self._emergency = emergency
        self.state = DriveState.SWITCH_ON_DISABLED
        self.defects: set[CanFaultKind] = set()  # in force, those of the firmware and its inputs among them
        self.brake_delay_ns = 0  # time from power on until the brake is open and operation enabled
        self._control = 0
        self._mode = NO_MODE
        self._now_ns = 0
        self._enabling_since_ns: int | None = None
        self._last_demand: int | None = None
        self._still = True
        self._acknowledged = False
        self._setpoint: _Setpoint | None = None
        self._buffered: _Setpoint | None = None
        self._homing_started = False
        self._homing_interrupted = False
        self._limited = False
        self._lag_since_ns: int | None = None
        self._known_fault = 0
        self.probe = TouchProbeUnit(dictionary, servo)
        self.wires = Wires()
        self._bind()

    def _bind(self) -> None:
        servo, od = self._servo, self._od
        od.on_read(0x6041, 0, self.statusword)
        od.on_read(0x6061, 0, lambda: self._mode)
        od.on_read(0x603F, 0, lambda: servo.fault_code)
        od.on_read(0x6062, 0, lambda: servo.position_demand_counts)
        od.on_read(0x6064, 0, lambda: servo.position_actual_counts)
        od.on_read(0x606C, 0, lambda: servo.velocity_actual_counts_s)
        od.on_read(0x6077, 0, lambda: servo.torque_actual_permille)
        od.on_read(0x60F4, 0, lambda: servo.following_error_counts)
        od.on_read(0x60FD, 0, self._digital_inputs)
        od.on_write(0x60FE, 1, lambda value: self._switch_outputs(value, od.number(0x60FE, 2)))
        od.on_write(0x60FE, 2, lambda value: self._switch_outputs(od.number(0x60FE, 1), value))
        od.on_write(0x6040, 0, self._write_controlword)
        od.on_write(0x6060, 0, self._write_mode)
        od.on_write(0x607A, 0, self._write_target_position)
        od.on_write(0x60FF, 0, self._write_target_velocity)
        od.on_write(0x6071, 0, self._write_target_torque)

    def reset(self) -> None:
        """Power-on of the electronics: power stage off, mode and controlword reset."""
        self._servo.power_off()
        if self._servo.fault_code:
            self._servo.reset_fault()
        self.state = DriveState.SWITCH_ON_DISABLED
        self._control = 0
        self._known_fault = 0
        self._mode = NO_MODE
        self.probe.reset()
        self._forget_motion()

    def lose_power(self) -> None:
        """Cut the supply: the axis coasts, nothing is supervised until `reset`."""
        self._servo.power_off()
        self.state = DriveState.SWITCH_ON_DISABLED
        self._enabling_since_ns = None

    @property
    def _torque_off(self) -> bool:
        return CanFaultKind.SAFE_TORQUE_OFF in self.defects

    def _forget_motion(self) -> None:
        self._acknowledged = False
        self._setpoint = self._buffered = None
        self._homing_started = self._homing_interrupted = False
        self._limited = False

    @property
    def cyclic(self) -> bool:
        """Whether it is enabled in a cyclic mode, with set-points that come with SYNC."""
        return self.state is DriveState.ENABLED and self._mode in (CSP, CSV, CST)

    # -- readings ------------------------------------------------------------------------------------------------------
    def _digital_inputs(self) -> int:
        servo = self._servo
        return (
            servo.negative_limit_switch
            | servo.positive_limit_switch << 1
            | servo.home_switch << 2
            | self.probe.inputs << 16
            | self.wires.inputs
        )

    def _switch_outputs(self, levels: int, mask: int) -> None:
        """60FEh: only outputs that the mask enables follow sub-index 1."""
        self.wires.outputs = levels & mask

    def statusword(self) -> int:
        """6041h as the drive shows it, defects included."""
        word = self._true_statusword()
        if self.defects:
            if CanFaultKind.LOCAL_CONTROL in self.defects:
                word &= ~REMOTE
            if CanFaultKind.NEVER_ARRIVES in self.defects:
                word &= ~REACHED
            if CanFaultKind.SETPOINT_NOT_TAKEN in self.defects and self._mode == PP:
                word &= ~BIT_12
            if CanFaultKind.ACKNOWLEDGE_STUCK in self.defects and self._mode == PP:
                word |= BIT_12
            if CanFaultKind.STATUS_IMPOSSIBLE in self.defects:
                word = word & ~0x6F | 0x04
        return word

    def _true_statusword(self) -> int:
        word = state_bits(self.state) | REMOTE
        if not self._torque_off:
            word |= VOLTAGE
        if self.state is DriveState.SWITCH_ON_DISABLED and self._control & 0x04:
            word |= QUICK_STOP_OFF
        if self._limited:
            word |= INTERNAL_LIMIT
        if self._mode == PP:
            word |= BIT_12 if self._acknowledged else 0
        elif self._mode == HM:
            return word | self._homing_bits()
        elif self._mode == PV:
            word |= BIT_12 if self._still else 0
        elif self._mode in (CSP, CSV, CST) and self.state is DriveState.ENABLED and not self._servo.stopping:
            word |= BIT_12
        if self._mode in (PP, CSP) and abs(self._servo.following_error_counts) > self._od.number(0x6065):
            word |= BIT_13
        if self._reached():
            word |= REACHED
        return word

    def _reached(self) -> bool:
        if self._servo.stopping:
            return self._still
        return self._buffered is None and self._servo.target_reached

    def _homing_bits(self) -> int:
        if self._servo.homing_error:
            return BIT_13 | (REACHED if self._still else 0)
        if self._homing_started and self._servo.mode is MotionMode.HOMING and not self._servo.homed:
            return 0
        if self._homing_started and self._servo.homed and not self._homing_interrupted:
            return BIT_12 | (REACHED if self._still else 0)
        return REACHED

    # -- time ----------------------------------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        """Evaluate what the servo did since, and do what is due without a command."""
        if now_ns > self._now_ns:
            demand = self._servo.position_demand_counts
            self._still = demand == self._last_demand and self._servo.velocity_actual_counts_s == 0
            self._last_demand = demand
            self._now_ns = now_ns
            self.probe.tick(now_ns)
        self._supervise()
        if self.state is DriveState.FAULT_REACTION:
            if self._still:
                self._servo.power_off()
                self._go(TransitionCause.AUTOMATIC)
        elif self.state is DriveState.QUICK_STOP:
            ending = QUICK_STOP_ENDINGS[self._od.number(0x605A)]
            if self._still and not ending.stays:
                self._servo.power_off()
                self._go(TransitionCause.AUTOMATIC)
        elif self._enabling_since_ns is not None:
            self._finish_enabling()
        elif self.state is DriveState.ENABLED and self._buffered is not None and self._servo.target_reached:
            self._start(self._buffered)
            self._buffered = None
            self._update_acknowledge()

    def _supervise(self) -> None:
        fault = self._servo.fault_code
        if not fault and self.state is DriveState.ENABLED:
            self._watch_following_error()
            fault = self._servo.fault_code
        if self._torque_off and self.state in (*POWERED_STATES, DriveState.READY):
            self._servo.power_off()
            self._enabling_since_ns = None
            if self.state not in FAULT_STATES:
                self.state = DriveState.SWITCH_ON_DISABLED
                self._forget_motion()
        if fault and fault != self._known_fault:
            self._known_fault = fault
            self._enabling_since_ns = None
            self._go(TransitionCause.FAULT)
            self._forget_motion()
            self._react_to_fault()
            self._emergency(fault)

    def _watch_following_error(self) -> None:
        if abs(self._servo.following_error_counts) <= self._od.number(0x6065):
            self._lag_since_ns = None
        elif self._lag_since_ns is None:
            self._lag_since_ns = self._now_ns
        elif self._now_ns - self._lag_since_ns >= 1_000_000 * self._od.number(0x6066):
            self._lag_since_ns = None
            self._servo.raise_fault(FOLLOWING_ERROR)

    def _react_to_fault(self) -> None:
        option = self._od.number(0x605E)
        if option == 0:
            self._servo.power_off()
        elif self._servo.powered:
            self._servo.quick_stop(self._od.number(0x6084 if option == 1 else 0x6085))

    # -- controlword ---------------------------------------------------------------------------------------------------
    def _write_controlword(self, word: int) -> None:
        previous, self._control = self._control, word
        if CanFaultKind.LOCAL_CONTROL in self.defects:
            return
        if (
            is_fault_reset(previous, word)
            and self.state is DriveState.FAULT
            and CanFaultKind.FAULT_STAYS not in self.defects
        ):
            self._servo.reset_fault()
            if not self._servo.fault_code:
                self._known_fault = 0
                self._go(TransitionCause.FAULT_RESET)
                self._emergency(0)
        command = decode_command(word)
        if command is not None:
            self._obey(command)
        if self.state is DriveState.ENABLED:
            self._watch_halt(previous, word)
            if self._mode == PP:
                self._watch_setpoint(previous, word)
            elif self._mode == HM:
                self._watch_homing(previous, word)

    def _obey(self, command: Command) -> None:
        if self._torque_off and command is not Command.DISABLE_VOLTAGE:
            return
        if self._enabling_since_ns is not None:
            if command is Command.ENABLE_OPERATION:
                return
            self._enabling_since_ns = None
            self._servo.power_off()
        if self.state is DriveState.QUICK_STOP and command is Command.ENABLE_OPERATION:
            if QUICK_STOP_ENDINGS[self._od.number(0x605A)].stays:
                self._servo.resume()
                self._go(command)
            return
        if self.state is DriveState.SWITCHED_ON and command is Command.ENABLE_OPERATION:
            self._servo.power_on()
            self._enabling_since_ns = self._now_ns
            self._finish_enabling()
            return
        before = self.state
        self._go(command)
        if self.state is before:
            return
        if self.state is DriveState.QUICK_STOP:
            self._begin_quick_stop()
        elif before in (DriveState.ENABLED, DriveState.QUICK_STOP):
            self._servo.power_off()
            self._forget_motion()
        if self.state is DriveState.SWITCHED_ON and command is Command.ENABLE_OPERATION:
            self._obey(command)  # the standard lets 4 follow 3 when both were asked for in one word

    def _finish_enabling(self) -> None:
        since_ns = self._enabling_since_ns
        if CanFaultKind.BRAKE_STUCK in self.defects:
            return
        if since_ns is not None and self._servo.powered and self._now_ns - since_ns >= self.brake_delay_ns:
            self._enabling_since_ns = None
            self._forget_motion()
            self._go(Command.ENABLE_OPERATION)
            if self._mode == CSP:
                self._write_target_position(self._od.number(0x607A))

    def _begin_quick_stop(self) -> None:
        self._forget_motion()
        ramp = QUICK_STOP_ENDINGS[self._od.number(0x605A)].ramp
        if ramp is Ramp.NONE:
            self._servo.power_off()
            self._go(TransitionCause.AUTOMATIC)
            return
        self._still = False
        self._servo.quick_stop(self._od.number(0x6084 if ramp is Ramp.SLOW_DOWN else 0x6085))

    def abort_connection(self) -> None:
        """React as 6007h says to a lost master (heartbeat lost, node stopped)."""
        # without 6007h (it is optional) a communication error is a malfunction, as for its value 1
        option = self._od.number(0x6007) if (0x6007, 0) in self._od.items else 1
        if self.state is not DriveState.ENABLED or option == 0:
            return
        if option == 1:
            self._servo.raise_fault(0x8130)
            self._supervise()
        else:
            self._obey(Command.DISABLE_VOLTAGE if option == 2 else Command.QUICK_STOP)

    def _go(self, cause: Command | TransitionCause) -> None:
        step = next_state(self.state, cause)
        if step is not None:
            self.state = step[1]

    # -- modes ---------------------------------------------------------------------------------------------------------
    def _write_mode(self, mode: int) -> None:
        if mode < 0 or (
            mode and not self._od.number(0x6502) & 1 << (mode - 1)
        ):  # negative modes are the manufacturer's
            raise RefusedError(INVALID_VALUE)
        if mode == self._mode or CanFaultKind.MODE_STUCK in self.defects:
            return
        if self.state is DriveState.ENABLED and self._mode in (PV, HM, CSV, CST):
            self._servo.halt(self._od.number(0x6084))  # the motion of the old mode ends; the axis stays held
            self._servo.resume()
        self._mode = mode
        self._forget_motion()

    def _write_target_position(self, target: int) -> None:
        if self._mode == CSP and self.state is DriveState.ENABLED:
            self._servo.cyclic_position(self._clamp(target + self._od.number(0x60B0)))

    def _write_target_velocity(self, velocity: int) -> None:
        if self.state is not DriveState.ENABLED:
            return
        if self._mode == CSV:
            self._servo.cyclic_velocity(velocity + self._od.number(0x60B1))
        elif self._mode == PV and not self._control & HALT:
            self._servo.move_velocity(velocity, self._od.number(0x6083))

    def _write_target_torque(self, torque: int) -> None:
        if self._mode == CST and self.state is DriveState.ENABLED:
            self._servo.cyclic_torque(torque + self._od.number(0x60B2))

    def _clamp(self, target: int) -> int:
        low, high = self._od.number(0x607D, 1), self._od.number(0x607D, 2)
        allowed = max(low, min(high, target)) if low < high else target
        self._limited = allowed != target
        return allowed

    def _watch_halt(self, previous: int, word: int) -> None:
        if word & ~previous & HALT:
            self._still = False
            self._servo.halt(self._od.number(0x6084 if self._od.number(0x605D) == 1 else 0x6085))
        elif previous & ~word & HALT:
            self._servo.resume()
            if self._mode == PP and self._setpoint is not None:
                self._start(self._setpoint)
            elif self._mode == PV:
                self._servo.move_velocity(self._od.number(0x60FF), self._od.number(0x6083))

    # -- profile position ------------------------------------------------------------------------------------------------
    def _watch_setpoint(self, previous: int, word: int) -> None:
        if CanFaultKind.SETPOINT_NOT_TAKEN in self.defects:
            return
        if word & ~previous & NEW_SETPOINT and not self._acknowledged:
            target = self._od.number(0x607A)
            if word & RELATIVE:
                target += self._setpoint.target if self._setpoint else self._servo.position_demand_counts
            velocity = self._od.number(0x6081)
            velocity = min(velocity, self._od.number(0x607F) or velocity)
            setpoint = _Setpoint(self._clamp(target), velocity, self._od.number(0x6083))
            self._acknowledged = True
            if word & IMMEDIATELY or self._servo.target_reached:
                self._buffered = None
                self._start(setpoint)
            else:
                self._buffered = setpoint
        self._update_acknowledge()

    def _update_acknowledge(self) -> None:
        """Bit 12 falls once bit 4 has fallen and a further set-point can be taken."""
        if not self._control & NEW_SETPOINT and self._buffered is None:
            self._acknowledged = False

    def _start(self, setpoint: _Setpoint) -> None:
        self._setpoint = setpoint
        self._servo.move_absolute(setpoint.target, setpoint.velocity, setpoint.acceleration)

    # -- homing --------------------------------------------------------------------------------------------------------
    def _watch_homing(self, previous: int, word: int) -> None:
        if word & ~previous & NEW_SETPOINT:
            self._homing_started, self._homing_interrupted = True, False
            self._still = False
            self._servo.start_homing(
                self._od.number(0x6098),
                self._od.number(0x6099, 1),
                self._od.number(0x6099, 2),
                self._od.number(0x607C),
            )
        elif previous & ~word & NEW_SETPOINT and self._homing_started and not self._servo.homed:
            self._homing_interrupted = True
            self._servo.halt(self._od.number(0x6084))
            self._servo.resume()
