"""StoppableUnit: the part of a Modbus drive that is sampled: its samples, how a stop leaves, how its power is taken off.

A stop is posted, however long the unit has been silent.
"""

from __future__ import annotations

from contextlib import suppress

from drivers.clock import Clock
from drivers.drive import FAULTS, DriveSample, DriveState
from drivers.errors import ProtocolError
from drivers.limits import DriveLimits
from drivers.modbus.commands import Commands, hold
from drivers.modbus.drive_map import DriveMap
from drivers.modbus.drive_values import DriveValues, Unit
from drivers.modbus.homing import MappedHoming
from drivers.modbus.link import ModbusLink
from drivers.modbus.power import PowerStates
from drivers.modbus.profile_moves import ProfileMoves
from drivers.modbus.register_access import RegisterAccess
from drivers.scaling import AxisScaling
from drivers.shutdown import StoppableDrive
from drivers.standstill import FROZEN_S, FrozenValues


class StoppableUnit(StoppableDrive):
    """One unit on a link, with the parts that its register map describes. Nothing is read or written before `open`.

    Raises from its methods, besides what ServoDrive names: NoAnswerError and LinkLostError, AbortError (a refused access),
    ProtocolError (a state or hand-shake that is not in the map), MotionTimeoutError (a transition that does not come).
    """

    homing: MappedHoming

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
        self.shows_stop = any(rule.state is DriveState.QUICK_STOP for rule in drive_map.states)
        self._frozen = FrozenValues()
        self.values = DriveValues(name, drive_map, scaling)
        self.commands = Commands(
            name,
            self.access,
            clock,
            way_out=self.way_out,
            shown_state=lambda: self.power.state().value,
            post_stop=self.send_stop,
        )
        ours = Unit(name, drive_map, self.access, self.values, self.commands, clock, scaling)
        self.power = PowerStates(ours, way_out=self.way_out, sample=self.sample)
        self.moves = ProfileMoves(ours, limits)
        self.homing = MappedHoming(ours, post_stop=self.send_stop)

    # -- reading ---------------------------------------------------------------------------------------------------
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

    # -- how it is stopped and disabled ----------------------------------------------------------------------------------
    @property
    def stopped(self) -> bool:
        return self.commands.stopped

    def send_stop(self) -> None:
        """The map's quick stop, posted: without waiting for the lock, the back-off or the exchange in progress."""
        self.commands.stopped = True
        if self._open:
            with suppress(Exception):  # send_stop never raises
                self.access.post(self.map.quick_stop)

    def _glance(self) -> DriveSample:
        """The values that show whether a stop is obeyed; also of a unit in back-off."""
        names = dict.fromkeys((*self.map.state_registers, self.map.position))
        raw = self.access.read(tuple(names), urgent=True, repeats=0)
        position_mm = self.scaling.load_mm(self.values.position_counts(raw))
        return DriveSample(self.clock.now_ns(), self.values.state(raw), position_mm, target_reached=False)

    def _halt(self) -> None:
        self.commands.give(self.map.halt)

    def _repeat_stop(self) -> None:
        for write in self.map.quick_stop:
            self.access.command(write, stops=True)

    def _power_off(self) -> None:
        state = self.power.state()
        if self.power.can_disable(state):  # else it is off
            self.power.disable(state)
        self.moves.under_way = None

    def _send_power_off(self, shown: DriveState) -> None:
        self.power.post_off(DriveState.QUICK_STOP if self.commands.stopped else shown)

    def _ask(self) -> None:
        self._glance()
