"""StoppableDrive: the part of a Modbus drive that samples, comes to rest, stops and takes the power off.

A stop is posted before anything is read, however long the unit has been silent; then the drive has to show that it obeys.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from drivers.clock import Clock
from drivers.drive import FAULTS, DriveLimits, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    BridgeError,
    HeldUnderPowerError,
    MotionTimeoutError,
    ProtocolError,
    StateError,
    TransportError,
)
from drivers.modbus.drive_map import DriveMap
from drivers.modbus.drive_values import DriveValues, Unit
from drivers.modbus.homing import Homing
from drivers.modbus.link import ModbusLink
from drivers.modbus.orders import Orders, hold
from drivers.modbus.power import PowerStates
from drivers.modbus.profile_moves import ProfileMoves
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.way_out import POWER_OFF_S, WayOut
from drivers.scaling import AxisScaling
from drivers.shared_time import SharedTime
from drivers.standstill import FROZEN_S, FrozenValues, Standstill
from drivers.undo import undo_all

_CONFIRM_S = 0.5
"""Longest time for a drive to show that it obeys a quick stop, s: many times the scan of a slow drive's interface."""


class StoppableDrive(ServoDrive):
    """One unit on a link, with the parts that its register map describes. Nothing is read or written before `open`.

    Raises from its methods, besides what ServoDrive names: NoAnswerError and LinkLostError, AbortError (a refused access),
    ProtocolError (a state or hand-shake that is not in the map), MotionTimeoutError (a transition that does not come).
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
    ) -> None:
        super().__init__(name, scaling, limits, clock)
        self.link = link
        self.unit = unit
        self.map = drive_map
        self.registers = drive_map.registers
        self.access = RegisterAccess(link, unit, drive_map.registers)
        self._open = False
        self._frozen = FrozenValues()
        self.values = DriveValues(name, drive_map, scaling)
        self.way_out = WayOut(clock, limits)
        self.orders = Orders(
            name,
            self.access,
            clock,
            way_out=self.way_out,
            shown_state=lambda: self.power.state().value,
            post_stop=self.send_stop,
        )
        ours = Unit(name, drive_map, self.access, self.values, self.orders, clock, scaling)
        self.power = PowerStates(ours, way_out=self.way_out, sample=self.sample)
        self.moves = ProfileMoves(ours, limits)
        self.homing = Homing(ours, post_stop=self.send_stop)

    def _require_open(self) -> None:
        if not self._open:
            raise StateError(f"drive {self.name} is not open")

    # -- reading ---------------------------------------------------------------------------------------------------
    @property
    def sample_wire_s(self) -> float:
        """Predicted time on the wire of one sample, s."""
        return self.access.plan(self.map.sampled()).wire_s

    def sample(self) -> DriveSample:
        """A fresh sample, all its registers read in as few requests as the wire allows.

        following_error_mm is as the drive gives it, mm. Raises DriveFaultError once when a homing that was started failed,
        ProtocolError (with a stop) for values that are frozen while the axis was ordered to move.
        """
        sample = self._look()
        self._judge_alive(sample)
        return sample

    def _judge_alive(self, sample: DriveSample) -> None:
        moving = self.homing.under_way or (self.moves.under_way is not None and not sample.target_reached)
        if not moving or sample.state is not DriveState.ENABLED:
            self._frozen.forget()
        elif self._frozen.look(sample.time_ns, sample.position_load_mm, sample.velocity_mm_s):
            self._frozen.forget()
            self.send_stop()
            raise ProtocolError(
                f"drive {self.name}: its values are frozen: it shows {sample.velocity_mm_s:.3f} mm/s and has stayed at"
                f" {sample.position_load_mm:.4f} mm for {FROZEN_S:g} s"
            )

    def _look(self) -> DriveSample:
        """A sample, not judged."""
        self._require_open()
        asked_ns = self.clock.now_ns()
        raw = self.access.read(self.map.sampled())
        time_ns = self.clock.now_ns()
        values, state = self.values, self.values.state(raw)
        if state in FAULTS:
            self.homing.under_way = False
        position_mm = self.scaling.load_mm(values.position_counts(raw))
        velocity_mm_s = values.load_mm(raw, self.map.velocity)
        homing = self.homing.under_way
        self.homing.look(raw, time_ns, position_mm)
        if homing and self.homing.homed:
            self.homing.homed, self.homing.elsewhere = False, True
            self.check_home(position_mm)
            self.homing.homed, self.homing.elsewhere = True, False
        return DriveSample(
            time_ns=time_ns,
            state=state,
            position_load_mm=position_mm,
            target_reached=state is DriveState.ENABLED and self.moves.reached(raw) and not self.homing.under_way,
            velocity_mm_s=velocity_mm_s,
            torque_percent=values.torque_percent(raw),
            following_error_mm=values.load_mm(raw, self.map.following_error),
            homed=self.homing.homed,
            fault_code=values.fault_code(raw),
            limited=hold(self.map.move.limited, raw) if self.map.move.limited else None,
            since_ns=asked_ns,
        )

    # -- coming to rest, stopping --------------------------------------------------------------------------------------
    def disable(self) -> None:
        """Halt, wait for standstill, then power off. An axis that does not come to rest is quick-stopped, and disabled all the same.

        Raises HeldUnderPowerError for an axis that would then fall: it stays under power, quick-stopped. After any other error of the
        wire or the drive a stop was sent.
        """
        self._require_open()
        self.homing.under_way = False
        try:
            with self.way_out.step(last=True):
                self._disable()
        except BaseException:
            self.send_stop()
            raise

    def _disable(self) -> None:
        state = self.power.state()
        if state in FAULTS or not self.power.can_disable(state):
            return  # the power stage is off
        if state in (DriveState.ENABLED, DriveState.QUICK_STOP):
            self._come_to_rest(state)
        self._power_off(state)
        self.moves.under_way = None

    def _power_off(self, state: DriveState) -> None:
        """state: the last one seen. Without an answer the writes that take power off are sent all the same, after the time of
        braking."""
        try:
            now = self.power.state()
            if self.power.can_disable(now):
                self.power.disable(now)
        except TransportError:
            self.power.post_off(DriveState.QUICK_STOP if self.orders.stopped else state)
            raise

    def _come_to_rest(self, state: DriveState) -> None:
        if state is DriveState.ENABLED and not self.orders.stopped and self._halted():
            return
        self.send_stop()
        braking_s = self.way_out.within_s(self._braking_s(), leave_s=POWER_OFF_S)
        if not self._stands_within(braking_s) and self.falls_without_power:
            raise HeldUnderPowerError(
                f"drive {self.name}: not seen at rest within {braking_s:.3g} s of a quick stop; gravity can move the axis and no"
                " brake is stated, so it stays under power, held by its drive"
            )

    def _halted(self) -> bool:
        """Halt by the map, within the time of braking from the axis's highest velocity: half of the limit of shutting down, at
        most."""
        try:
            self.orders.give(self.map.halt)
        except BridgeError:
            return False
        limits = self.limits
        braking_s = 1.0 + 3.0 * limits.max_velocity_mm_s / limits.max_acceleration_mm_s2
        return self._stands_within(self.way_out.within_s(braking_s, leave_s=0.5 * self.way_out.budget_s))

    def _braking_s(self) -> float:
        """Longest time of braking, s, also with a ramp ten times flatter than the axis's."""
        return 5.0 + 10.0 * self.limits.max_velocity_mm_s / self.limits.max_acceleration_mm_s2

    def _stands_within(self, timeout_s: float) -> bool:
        standstill = Standstill(self.scaling.resolution_load_mm)

        def stands() -> bool:
            sample = self._look()
            self.looked_at(sample)
            powered = sample.state in (DriveState.ENABLED, DriveState.QUICK_STOP)
            return not powered or standstill.look(sample.time_ns, sample.position_load_mm, sample.velocity_mm_s)

        return self.orders.becomes(stands, timeout_s)

    @property
    def way_out_s(self) -> float:
        return self.way_out.budget_s

    def share_way_out(self, time: SharedTime) -> None:
        self.way_out.share(time)

    def send_stop(self) -> None:
        """The map's quick stop, posted: without waiting for the lock, the back-off or the exchange in progress."""
        self.orders.stopped = True
        if self._open:
            with suppress(Exception):  # send_stop never raises
                self.access.post(self.map.quick_stop)

    def quick_stop(self) -> None:
        """Sent at once, in any state and however long the unit has been silent; then the drive must show that it obeys.

        Where the drive does not show it, it is sent again until it is acknowledged. Raises NoAnswerError, LinkLostError,
        AbortError, and MotionTimeoutError for a drive that moves on.
        """
        self._require_open()
        self.homing.under_way = False
        self.send_stop()
        with self.way_out.step(last=False):
            self._confirm_stop()

    def _confirm_stop(self) -> None:
        if self._stop_shown():
            return
        for write in self.map.quick_stop:
            self.access.command(write, stops=True)
        standstill = Standstill(self.scaling.resolution_load_mm)
        confirm_s = self.way_out.within_s(_CONFIRM_S)
        if not self.orders.becomes(lambda: self._obeys(self._stop_look(), standstill), confirm_s):
            raise MotionTimeoutError(
                f"drive {self.name}: quick stop acknowledged, but not obeyed within {confirm_s:.3g} s"
            )

    def _stop_shown(self) -> bool:
        """Whether one sample, without repeats, shows the stop; a busy unit, which drops a posted one, does not."""
        try:
            return self._stop_look().state is not DriveState.ENABLED
        except BridgeError:
            return False

    def _stop_look(self) -> DriveSample:
        """The values that show whether a stop is obeyed; also of a unit in back-off."""
        names = [rule.condition.register for rule in self.map.states] + [self.map.position]
        raw = self.access.read(tuple(dict.fromkeys(names)), urgent=True, repeats=0)
        position_mm = self.scaling.load_mm(self.values.position_counts(raw))
        return DriveSample(self.clock.now_ns(), self.values.state(raw), position_mm, target_reached=False)

    @staticmethod
    def _obeys(sample: DriveSample, standstill: Standstill) -> bool:
        """Whether a sample shows the stop; some drives stop without leaving "operation enabled"."""
        return sample.state is not DriveState.ENABLED or standstill.look(sample.time_ns, sample.position_load_mm)

    @contextmanager
    def _no_motion_after_errors(self) -> Iterator[None]:
        """An error inside stops the axis and takes its power off; another exception (the operator's stop) sends a stop."""
        try:
            yield
        except BridgeError as error:
            undo_all([("not stopped", self.quick_stop), ("not disabled", self.disable)], during=error)
            raise
        except BaseException:
            self.send_stop()
            raise
