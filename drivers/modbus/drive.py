"""ModbusDrive: any Modbus servo drive, by what its register map says and nothing else.

There is no drive model in this file: states, transitions, hand-shakes and units come from a `DriveMap`. What is fixed here is what
every drive must be spared: a target that is not the actual position when power comes on, a fault left by enabling, a move that the
drive never acknowledged but is believed to run, a start bit sent twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from drivers.clock import Clock
from drivers.drive import Capability, DriveLimits, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    BridgeError,
    CapabilityError,
    DriveFaultError,
    StateError,
    TransportError,
)
from drivers.modbus.codec import Raw
from drivers.modbus.correction_table import ModbusCorrectionTable
from drivers.modbus.drive_map import FAULTS, DriveMap, HomingMap, all_hold
from drivers.modbus.drive_values import DriveValues
from drivers.modbus.link import ModbusLink
from drivers.modbus.orders import POLL_S, Orders, hold
from drivers.modbus.parameters import ModbusParameters
from drivers.modbus.power import PowerStates
from drivers.modbus.profile_moves import ProfileMoves
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.stream import ModbusStream
from drivers.modbus.touch_probe import ModbusTouchProbe
from drivers.modbus.wear import WearLedger
from drivers.paced_stream import PacedGroup
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.set_points import SetPointSettings

_LOOKS = 50  # at a position that does not change, before an axis is believed to be at rest


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
        self._running = False  # at a velocity that stands in the drive
        self.values = DriveValues(name, drive_map, scaling)
        self.orders = Orders(name, self.access, clock, lambda: self.power.state().value)
        common = (name, drive_map, self.access, self.values, self.orders)
        self.power = PowerStates(*common, clock=clock, sample=self.sample)
        self.moves = ProfileMoves(*common, scaling=scaling, limits=limits)

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Connect and take one sample; writes nothing."""
        if self._open:
            raise StateError(f"drive {self.name} is already open")
        self.link.open()
        self._open = True
        try:
            self._homed, self._homing, self._running = None, False, False
            self.moves.under_way = None
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
        values, state = self.values, self.values.state(raw)
        if state in FAULTS:
            self._homing = False
        self._look_at_homing(raw)
        position_mm = self.scaling.load_mm(values.position_counts(raw))
        if self._running and state is DriveState.ENABLED:
            self._watch_travel(position_mm, values.load_mm(raw, self.map.velocity))
        return DriveSample(
            time_ns=time_ns,
            state=state,
            position_load_mm=position_mm,
            target_reached=self.moves.reached(raw) and not self._homing,
            velocity_mm_s=values.load_mm(raw, self.map.velocity),
            torque_percent=values.torque_percent(raw),
            following_error_mm=values.load_mm(raw, self.map.following_error),
            homed=self._homed,
            fault_code=values.fault_code(raw),
        )

    def _look_at_homing(self, raw: dict[str, Raw]) -> None:
        homing = self.map.homing
        if homing is None or not hold(homing.applies, raw):
            return
        if self._homing and homing.failed and hold(homing.failed, raw):
            self._homing, self._homed = False, False
            raise DriveFaultError(f"drive {self.name}: homing failed", self.values.fault_code(raw))
        attained = hold(homing.attained, raw)
        if attained:
            self._homing = False
        self._homed = attained

    # -- states ----------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self._require_open()
        state = self.power.state()
        if state is DriveState.NOT_READY:
            self.power.await_ready()
        elif state is DriveState.QUICK_STOP:
            self._await_standstill()  # the way out of a quick stop may lead through power off
        self._end_run()
        self.moves.set_mode()
        self.power.enable(self._target_here)

    def _target_here(self) -> None:
        """Target := actual, so that power coming on moves nothing."""
        self._write_here(self.map.move.target)
        self.moves.under_way = None

    def _write_here(self, target: str) -> None:
        counts = self.values.position_counts(self.access.read([self.map.position]))
        self.access.write({target: self.values.raw(counts, target)})

    def disable(self) -> None:
        """Halt, wait for standstill, then power off. Raises MotionTimeoutError when it does not come to rest; it is then still on."""
        self._require_open()
        self._homing = False
        state = self.power.state()
        if state in FAULTS or not self.power.can_disable(state):
            self._end_run()
            return  # nothing is powered
        if state is DriveState.ENABLED:
            self.orders.give(self.map.halt)
        if state in (DriveState.ENABLED, DriveState.QUICK_STOP):
            self._await_standstill()
        self._end_run()
        state = self.power.state()
        if self.power.can_disable(state):
            self.power.disable(state)
        self.moves.under_way = None

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
        self.power.reset_fault()

    # -- motion ----------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        homing = self.map.homing
        if homing is None:
            raise StateError(f"drive {self.name}: its register map has no homing")
        self.moves.under_way = None
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

    def _leave_homing(self, raw: dict[str, Raw]) -> None:
        """A homing order that still stands would come to life again, or be taken for a new set-point."""
        homing = self.map.homing
        self._homing = False
        if homing is not None and homing.applies and hold(homing.applies, raw):
            self._release_homing(homing)

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        raw = self.access.read(self.map.sampled())
        move = self.moves.planned(position_load_mm, velocity_mm_s, raw)  # refused here, before anything is written
        self._leave_homing(raw)
        self._end_run()
        self.moves.make_ready(raw)
        try:
            self.moves.begin(move)
        except BaseException:
            with suppress(BridgeError):  # it may be moving, and nobody watches a move that was never confirmed
                self.quick_stop()
            raise

    # -- velocity runs and streams ---------------------------------------------------------------------------------------
    def _start_velocity(self, velocity_mm_s: float) -> None:
        run = self.map.run
        if run is None:
            raise CapabilityError(f"drive {self.name}: its register map has no velocity run")
        counts_per_s = self.scaling.direction * velocity_mm_s * self.scaling.counts_per_load_mm
        target = {run.target: self.values.raw(counts_per_s, run.target)}  # refused here, before anything is written
        raw = self.access.read(self.map.sampled())
        self._leave_homing(raw)
        self.moves.under_way = None
        self.access.write(self.moves.ramp_settings(run.acceleration, run.deceleration))
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
            self.access.write({self.map.run.target: self.values.raw(0.0, self.map.run.target)})

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
        self.access.write({target: self.values.raw(counts, target)})

    def end_stream(self) -> None:
        """For `ModbusStream`: back to the mode of moves, held where it is."""
        self._target_here()
        self.moves.set_mode()

    # -- what stands beside the motion -----------------------------------------------------------------------------------
    def _touch_probe(self) -> ModbusTouchProbe:
        return ModbusTouchProbe(
            self.name,
            self.clock,
            self.map.probes,
            self.access,
            lambda raw, name: self.scaling.load_mm(self.values.counts(raw, name)),
        )

    @property
    def parameters(self) -> ModbusParameters:
        """By the names of the register map."""
        return self._parameters
