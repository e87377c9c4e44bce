"""ModbusDrive: any Modbus servo drive, by what its register map says and nothing else.

There is no drive model in this file: states, transitions, hand-shakes and units come from a `DriveMap`. What is fixed here is what
every drive must be spared: a target that is not the actual position when power comes on, a fault left by enabling, a move that the
drive never acknowledged but is believed to run, a start bit sent twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.drive import Capability, DriveLimits, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    BridgeError,
    CapabilityError,
    DriveFaultError,
    MotionTimeoutError,
    ProtocolError,
    StateError,
    TransportError,
)
from drivers.modbus.codec import Raw
from drivers.modbus.correction_table import ModbusCorrectionTable
from drivers.modbus.drive_map import FAULTS, DriveMap, HomingMap, Transition, all_hold
from drivers.modbus.drive_units import from_counts, to_counts, to_percent
from drivers.modbus.link import ModbusLink
from drivers.modbus.orders import POLL_S, Orders, hold
from drivers.modbus.parameters import ModbusParameters
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.modbus.stream import ModbusStream
from drivers.modbus.touch_probe import ModbusTouchProbe
from drivers.modbus.wear import WearLedger
from drivers.paced_stream import PacedGroup
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.set_points import SetPointSettings

_BOOT_S = 5.0  # how long a drive may be not ready to switch on
_LOOKS = 50  # at a position that does not change, before an axis is believed to be at rest

StateTest = Callable[[DriveState], bool]


@dataclass(frozen=True)
class _Move:
    """The move under way, in motor counts."""

    start_counts: float
    target_counts: float


class ModbusDrive(ServoDrive):
    """One unit on a link as a drive. Several drives may share the link; it is let go when the last of them closes.

    Raises from its methods, besides what ServoDrive names: NoAnswerError and LinkLostError, AbortError (a refused access),
    ProtocolError (a state or hand-shake that the map does not know), MotionTimeoutError (a transition that does not come).
    """

    def __init__(
        self,
        name: str,
        scaling: AxisScaling,
        limits: DriveLimits,
        clock: Clock,
        *,
        link: ModbusLink,
        unit: int,
        drive_map: DriveMap,
        wear: WearLedger | None = None,
    ) -> None:
        super().__init__(name, scaling, limits, clock)
        self.link = link
        self.unit = unit
        self.map = drive_map
        self.registers = drive_map.registers
        self.access = RegisterAccess(link, unit, drive_map.registers)
        self._parameters = ModbusParameters(name, drive_map, self.access, clock, wear or WearLedger())
        self._open = False
        self._homed: bool | None = None
        self._homing = False
        self._move: _Move | None = None
        self._running = False  # at a velocity that stands in the drive
        self.orders = Orders(name, self.access, clock, lambda: self._state().value)

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Connect and take one sample; writes nothing."""
        if self._open:
            raise StateError(f"drive {self.name} is already open")
        self.link.open()
        self._open = True
        try:
            self._homed, self._homing, self._move, self._running = None, False, None, False
            self.orders.forget()
            self.sample()
        except BaseException:
            self._open = False
            self.link.close()
            raise

    def close(self) -> None:
        """Disable, put mode, speeds and ramps back as they were found, and disconnect."""
        if not self._open:
            return
        try:
            try:
                self.disable()
            except TransportError:
                raise
            except BridgeError:
                self.quick_stop()
                raise
            self.orders.put_back()
        except TransportError:
            pass  # the link is dead: there is nobody left to tell
        finally:
            self._open = False
            self.link.close()

    def _require_open(self) -> None:
        if not self._open:
            raise StateError(f"drive {self.name} is not open")

    @property
    def capabilities(self) -> frozenset[Capability]:
        """What the map describes."""
        found = {Capability.PROFILE_POSITION, Capability.PARAMETERS}
        if self.map.homing is not None:
            found.add(Capability.HOMING)
        if self.map.run is not None:
            found.add(Capability.PROFILE_VELOCITY)
        if self.map.stream is not None:
            found.add(Capability.STREAMING)
        if self.map.probes:
            found.add(Capability.TOUCH_PROBE)
        if self.map.torque is not None:
            found.add(Capability.TORQUE_ACTUAL)
        if self.map.store is not None:
            found.add(Capability.STORE)
        return frozenset(found)

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """By the map's [drive.scaling]: constants of the model, or its registers."""
        self._require_open()
        return (self._parameters.reported_scaling(),)

    @property
    def correction_table(self) -> ModbusCorrectionTable | None:
        """By the map's [drive.correction_table]."""
        self._require_open()
        blocks = self.map.table
        return None if blocks is None else ModbusCorrectionTable(self.name, self.access, blocks, self._parameters.wear)

    # -- reading ---------------------------------------------------------------------------------------------------
    @property
    def sample_wire_s(self) -> float:
        """Predicted time on the wire of one sample."""
        return self.access.plan(self.map.sampled()).wire_s

    def sample(self) -> DriveSample:
        """A fresh sample, all its registers asked for in as few requests as the wire is best served with.

        following_error_mm is as the drive gives it. Raises DriveFaultError once when a homing that was started failed, LimitError
        (with a quick stop) when a velocity run comes to the end of the travel.
        """
        self._require_open()
        raw = self.access.read(self.map.sampled())
        time_ns = self.clock.now_ns()
        state = self._state_of(raw)
        if state in FAULTS:
            self._homing = False
        self._look_at_homing(raw)
        position_mm = self.scaling.load_mm(self._counts(raw, self.map.position))
        if self._running and state is DriveState.ENABLED:
            self._watch_travel(position_mm, self._load_mm(raw, self.map.velocity))
        return DriveSample(
            time_ns=time_ns,
            state=state,
            position_load_mm=position_mm,
            target_reached=self._reached(raw) and not self._homing,
            velocity_mm_s=self._load_mm(raw, self.map.velocity),
            torque_percent=self._torque_percent(raw),
            following_error_mm=self._load_mm(raw, self.map.following_error),
            homed=self._homed,
            fault_code=self._fault_code(raw),
        )

    def _state_of(self, raw: dict[str, Raw]) -> DriveState:
        for rule in self.map.states:
            if hold((rule.condition,), raw):
                return rule.state
        shown = ", ".join(
            f"{name} {whole(raw[name], name):#x}"
            for name in dict.fromkeys(rule.condition.register for rule in self.map.states)
        )
        raise ProtocolError(f"drive {self.name}: {shown} is no state that its register map knows")

    def _counts(self, raw: dict[str, Raw], name: str) -> float:
        return to_counts(raw[name], self.registers[name], self.scaling.encoder_counts_per_motor_rev)

    def _load_mm(self, raw: dict[str, Raw], name: str | None) -> float | None:
        return None if name is None else self.scaling.load_mm(self._counts(raw, name))

    def _torque_percent(self, raw: dict[str, Raw]) -> float | None:
        name = self.map.torque
        return None if name is None else self.scaling.direction * to_percent(raw[name], self.registers[name])

    def _fault_code(self, raw: dict[str, Raw]) -> int | None:
        name = self.map.fault_code
        return None if name is None else whole(raw[name], name) or None

    def _reached(self, raw: dict[str, Raw]) -> bool:
        move = self.map.move
        if not hold(move.reached, raw):
            return False
        if self._move is None or move.window is None:
            return True
        off_counts = abs(self._counts(raw, self.map.position) - self._move.target_counts)
        return off_counts <= self._window_counts()

    def _window_counts(self) -> float:
        target = self.registers[self.map.move.target]
        window = self.map.move.window or 0.0
        return window if target.unit == "counts" else window * self.scaling.encoder_counts_per_motor_rev

    def _look_at_homing(self, raw: dict[str, Raw]) -> None:
        homing = self.map.homing
        if homing is None or not hold(homing.applies, raw):
            return
        if self._homing and homing.failed and hold(homing.failed, raw):
            self._homing, self._homed = False, False
            raise DriveFaultError(f"drive {self.name}: homing failed", self._fault_code(raw))
        attained = hold(homing.attained, raw)
        if attained:
            self._homing = False
        self._homed = attained

    # -- states ----------------------------------------------------------------------------------------------------
    def _state(self) -> DriveState:
        names = [rule.condition.register for rule in self.map.states]
        return self._state_of(dict(self.access.integers(names)))

    def _enable(self) -> None:
        self._require_open()
        state = self._state()
        if state is DriveState.NOT_READY:
            self._await_state("ready", lambda now: now is not DriveState.NOT_READY, _BOOT_S)
        elif state is DriveState.QUICK_STOP:
            self._await_standstill()  # the way out of a quick stop may lead through power off
        self._end_run()
        self.orders.set_mode(self.map.move.mode, self.map.move.mode_shown, self.map.move.timeout_s)
        for _ in range(len(self.map.enable) + 1):
            state = self._state()
            if state is DriveState.ENABLED:
                return
            transition = self._transition_from(self.map.enable, state, "enable")
            if DriveState.ENABLED in transition.targets:
                self._target_here()
            self._walk(transition, "enable")
        raise ProtocolError(f"drive {self.name}: enabling goes round in circles, it is {self._state().value}")

    def _target_here(self) -> None:
        """Target := actual, so that power coming on moves nothing."""
        self._write_here(self.map.move.target)
        self._move = None

    def _write_here(self, target: str) -> None:
        counts = self._counts(self.access.read([self.map.position]), self.map.position)
        self.access.write({target: self._raw(counts, target)})

    def _raw(self, counts: float, name: str) -> Raw:
        return from_counts(counts, self.registers[name], self.scaling.encoder_counts_per_motor_rev)

    def disable(self) -> None:
        """Halt, wait for standstill, then power off. Raises MotionTimeoutError when it does not come to rest; it is then still on."""
        self._require_open()
        self._homing = False
        state = self._state()
        if state in FAULTS or not any(state in transition.sources for transition in self.map.disable):
            self._end_run()
            return  # nothing is powered
        if state is DriveState.ENABLED:
            self.orders.give(self.map.halt)
        if state in (DriveState.ENABLED, DriveState.QUICK_STOP):
            self._await_standstill()
        self._end_run()
        state = self._state()
        if any(state in transition.sources for transition in self.map.disable):
            self._walk(self._transition_from(self.map.disable, state, "disable"), "disable", fault_ends=True)
        self._move = None

    def _await_standstill(self) -> None:
        """Velocity zero, or, where a drive shows none or a noisy one, the position within a count over several looks."""
        limits = self.limits
        slowest_s = 5.0 + 10.0 * limits.max_velocity_mm_s / limits.max_acceleration_mm_s2
        count_mm = 1.5 * self.scaling.resolution_load_mm
        seen: list[float] = []

        def stands(sample: DriveSample) -> bool:
            seen.append(sample.position_load_mm)
            return (
                sample.state not in (DriveState.ENABLED, DriveState.QUICK_STOP)
                or sample.velocity_mm_s == 0.0
                or (len(seen) >= _LOOKS and max(seen[-_LOOKS:]) - min(seen[-_LOOKS:]) <= count_mm)
            )

        self.wait_for(stands, slowest_s, "standstill before power off")

    def quick_stop(self) -> None:
        """Sent at once and repeated without asking, whatever the state and however long the unit has been silent."""
        self._require_open()
        self._homing = False
        for write in self.map.quick_stop:
            self.access.command(write, urgent=True)

    def reset_fault(self) -> None:
        """Acknowledge by the map's sequence; leaves the axis disabled. Raises DriveFaultError when the cause is still there."""
        self._require_open()
        state = self._state()
        if state is DriveState.FAULT_REACTION:
            state = self._await_state("end of the fault reaction", lambda now: now is not state, _BOOT_S)
        if state not in FAULTS:
            return
        transition = self._transition_from(self.map.reset_fault, state, "reset the fault")
        self.orders.give(transition.writes)
        try:
            self._await_state("reset", lambda now: now in transition.targets, transition.timeout_s)
        except MotionTimeoutError as error:
            sample = self.sample()
            if sample.state not in FAULTS:
                raise
            raise DriveFaultError(
                f"drive {self.name}: the fault stays, its cause is still there", sample.fault_code
            ) from error

    def _transition_from(self, transitions: tuple[Transition, ...], state: DriveState, verb: str) -> Transition:
        for transition in transitions:
            if state in transition.sources:
                return transition
        if state in FAULTS:
            raise DriveFaultError(f"drive {self.name} cannot {verb}: it is in {state.value}", self.sample().fault_code)
        raise StateError(f"drive {self.name} cannot {verb} from {state.value}")

    def _walk(self, transition: Transition, verb: str, *, fault_ends: bool = False) -> None:
        self.orders.give(transition.writes)
        state = self._await_state(
            f"{verb}: {' or '.join(target.value for target in transition.targets)} (mains, STO and enable input in order?)",
            lambda now: now in transition.targets or now in FAULTS,
            transition.timeout_s,
        )
        if state in FAULTS and not fault_ends:
            raise DriveFaultError(f"drive {self.name}: fault while trying to {verb}", self.sample().fault_code)

    def _await_state(self, what: str, good: StateTest, timeout_s: float) -> DriveState:
        deadline = self.clock.deadline(timeout_s)
        while True:
            state = self._state()
            if good(state):
                return state
            if deadline.expired:
                raise MotionTimeoutError(f"drive {self.name}: {what} not within {timeout_s:g} s, it is {state.value}")
            self.clock.sleep_s(POLL_S)

    # -- motion ----------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        homing = self.map.homing
        if homing is None:
            raise StateError(f"drive {self.name}: its register map has no homing")
        self._move = None
        self._end_run()
        self._release_homing(homing)
        self.orders.set_mode(homing.mode, homing.mode_shown, homing.timeout_s)
        self._homed = False
        self.orders.start(homing.start, "homing", homing.timeout_s)
        self.orders.wait_for(homing.accepted, "homing to be taken up", homing.timeout_s)
        self._homing = True
        # an "attained" of the last time may stand until the drive has looked at the order
        deadline = self.clock.deadline(homing.timeout_s)
        while self._attained_now(homing) and not deadline.expired:
            self.clock.sleep_s(POLL_S)

    def _attained_now(self, homing: HomingMap) -> bool:
        raw = self.access.of_conditions((*homing.applies, *homing.attained))
        return all_hold(homing.applies, raw) and all_hold(homing.attained, raw)

    def _release_homing(self, homing: HomingMap) -> None:
        self.orders.give(homing.release)

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        move = self.map.move
        raw = self.access.read(self.map.sampled())
        start_counts = self._counts(raw, self.map.position)
        target_counts = float(self.scaling.motor_counts(position_load_mm))
        values = self._profile(target_counts, velocity_mm_s)  # refused here, before anything is written
        self._leave_homing(raw)
        self._end_run()
        self.orders.set_mode(move.mode, move.mode_shown, move.timeout_s, raw)
        if not self.orders.hold_now(move.idle, raw):
            self.orders.give(move.release)
            self.orders.wait_for(move.idle, "set-point hand-shake to be idle", move.timeout_s)
        try:
            self.access.write(values)
            self._move = _Move(start_counts, target_counts)
            self.orders.start(move.start, "move", move.timeout_s, lambda: not self._reached_now())
            self.orders.wait_for(move.accepted, "new target to be accepted", move.timeout_s)
            self.orders.give(move.release)
            self.orders.wait_for(move.released, "set-point hand-shake to end", move.timeout_s)
            self._await_departure(velocity_mm_s)
        except BaseException:
            with suppress(BridgeError):  # it may be moving, and nobody watches a move that was never confirmed
                self.quick_stop()
            raise

    def _profile(self, target_counts: float, velocity_mm_s: float) -> dict[str, Raw]:
        """All that a move needs, speeds before the target, as some drives start on the target; neighbours are joined when written."""
        move, scaling = self.map.move, self.scaling
        velocity = velocity_mm_s * scaling.counts_per_load_mm
        ramp = self._ramp_counts_s2()
        wanted: dict[str, float] = {move.velocity: velocity}
        for name in (move.acceleration, move.deceleration):
            if name is not None:
                wanted[name] = ramp
        values = self._settings(wanted)
        values[move.target] = self._raw(target_counts, move.target)
        if not move.start:
            return values
        return dict(sorted(values.items(), key=lambda item: self.registers[item[0]].span))

    def _ramp_counts_s2(self) -> float:
        return self.limits.max_acceleration_mm_s2 * self.scaling.counts_per_load_mm

    def _settings(self, wanted: dict[str, float]) -> dict[str, Raw]:
        """Speeds and ramps in counts -> raw, after noting what stood there."""
        self.orders.remember(tuple(wanted))
        return {name: self._raw(self._at_least_one_step(name, counts), name) for name, counts in wanted.items()}

    def _at_least_one_step(self, name: str, counts: float) -> float:
        """A speed that rounds to 0 would never arrive."""
        register = self.registers[name]
        one = to_counts(1, register, self.scaling.encoder_counts_per_motor_rev)
        return counts if register.layout.type.is_float else max(counts, one)

    # -- velocity runs and streams ---------------------------------------------------------------------------------------
    def _start_velocity(self, velocity_mm_s: float) -> None:
        run = self.map.run
        if run is None:
            raise CapabilityError(f"drive {self.name}: its register map has no velocity run")
        counts_per_s = self.scaling.direction * velocity_mm_s * self.scaling.counts_per_load_mm
        target = {run.target: self._raw(counts_per_s, run.target)}  # refused here, before anything is written
        ramps = dict.fromkeys((name for name in (run.acceleration, run.deceleration) if name), self._ramp_counts_s2())
        raw = self.access.read(self.map.sampled())
        self._leave_homing(raw)
        self._move = None
        self.access.write(self._settings(ramps))
        if not self._running:
            self._write_no_velocity()  # what is left there from before must not come to life with the mode
        self.orders.set_mode(run.mode, run.mode_shown, run.timeout_s)
        self._running = True
        try:
            self.orders.start(run.start, "velocity run", run.timeout_s)
            self.access.write(target)
        except BaseException:
            with suppress(BridgeError):  # it may be running
                self.quick_stop()
            raise

    def _write_no_velocity(self) -> None:
        if self.map.run is not None:
            self.access.write({self.map.run.target: self._raw(0.0, self.map.run.target)})

    def _end_run(self) -> None:
        """No velocity stays behind in the drive."""
        if self._running:
            self._write_no_velocity()
            self._running = False

    def _stream(self, settings: SetPointSettings) -> ModbusStream:
        if self.map.stream is None:
            raise CapabilityError(f"drive {self.name}: its register map has no cyclic set-point")
        return ModbusStream(self, self.map.stream, settings)

    def _stream_with(self, others: Sequence[ServoDrive], settings: SetPointSettings) -> PacedGroup:
        return PacedGroup([self, *others], settings)

    def begin_stream(self) -> None:
        """For `ModbusStream`: target := actual, then the mode in which the drive follows it."""
        stream = self.map.stream
        self._require_enabled("stream")
        if stream is None:
            raise CapabilityError(f"drive {self.name}: its register map has no cyclic set-point")
        self._end_run()
        self._leave_homing(self.access.read(self.map.sampled()))
        self._write_here(stream.target)
        self.orders.set_mode(stream.mode, stream.mode_shown, stream.timeout_s)
        self.orders.start(stream.start, "stream", stream.timeout_s)

    def send_set_point(self, position_load_mm: float) -> None:
        """For `ModbusStream`: the next set-point."""
        target = self.map.stream.target if self.map.stream is not None else self.map.move.target
        counts = float(self.scaling.motor_counts(position_load_mm))
        self.access.write({target: self._raw(counts, target)})

    def end_stream(self) -> None:
        """For `ModbusStream`: back to the mode of moves, held where it is."""
        self._target_here()
        self.orders.set_mode(self.map.move.mode, self.map.move.mode_shown, self.map.move.timeout_s)

    # -- what stands beside the motion -----------------------------------------------------------------------------------
    def _touch_probe(self) -> ModbusTouchProbe:
        return ModbusTouchProbe(
            self.name,
            self.clock,
            self.map.probes,
            self.access,
            lambda raw, name: self.scaling.load_mm(
                to_counts(raw, self.registers[name], self.scaling.encoder_counts_per_motor_rev)
            ),
        )

    @property
    def parameters(self) -> ModbusParameters:
        """By the names of the register map."""
        return self._parameters

    def _leave_homing(self, raw: dict[str, Raw]) -> None:
        """A homing order that still stands would come to life again, or be taken for a new set-point."""
        homing = self.map.homing
        self._homing = False
        if homing is not None and homing.applies and hold(homing.applies, raw):
            self._release_homing(homing)

    def _reached_now(self) -> bool:
        return self._reached(self.access.read(self.map.sampled()))

    def _await_departure(self, velocity_mm_s: float) -> None:
        """See "in position" of the last move go, so that nobody takes it for the end of this one.

        Raises MotionTimeoutError when the drive accepted the target but stays where it is and says that it is there.
        """
        move = self._move
        if move is None:
            return
        way_counts = abs(move.target_counts - move.start_counts)
        way_mm = abs(self.scaling.load_mm(way_counts))
        longest_s = way_mm / velocity_mm_s + 2.0 * velocity_mm_s / self.limits.max_acceleration_mm_s2 + 0.05
        if way_counts <= self._window_counts() or self.orders.becomes(
            lambda: not self._reached_now(), min(longest_s, self.map.move.timeout_s)
        ):
            return
        raw = self.access.read([self.map.position])
        left = abs(self._counts(raw, self.map.position) - move.target_counts)
        if left > max(1.0, 0.5 * way_counts):
            raise MotionTimeoutError(
                f"drive {self.name}: accepted a target {way_mm:.6f} mm away, says it is in position, and does not move"
            )
