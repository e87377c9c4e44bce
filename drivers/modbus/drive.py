"""ModbusDrive: any Modbus servo drive, driven by its register map alone.

There is no drive model in this file: states, transitions, hand-shakes and units come from a `DriveMap`. Fixed here are the rules for
every drive: the target is the actual position when power comes on; a fault is never left by enabling; a move that was not acknowledged
does not count as running; a start bit is never sent twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial

from drivers.clock import NS_PER_S, Clock
from drivers.drive import FAULTS, Capability, DriveLimits, DriveSample, DriveState, DriveZero, ServoDrive
from drivers.errors import (
    BridgeError,
    CapabilityError,
    DriveFaultError,
    HeldUnderPowerError,
    InputError,
    MotionTimeoutError,
    ProtocolError,
    StateError,
    TransportError,
    UndoError,
)
from drivers.modbus.codec import Raw
from drivers.modbus.correction_table import ModbusCorrectionTable
from drivers.modbus.drive_map import DriveMap, HomingMap, Need, RunMap, StreamMap, all_hold
from drivers.modbus.drive_values import DriveValues
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_facts import FactLedger, Proof
from drivers.modbus.map_roles import Writes
from drivers.modbus.order_evidence import judge_orders
from drivers.modbus.orders import POLL_S, Orders, hold
from drivers.modbus.parameters import ModbusParameters
from drivers.modbus.power import PowerStates
from drivers.modbus.profile_moves import ProfileMoves
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.touch_probe import ModbusTouchProbe
from drivers.modbus.way_out import POWER_OFF_S, WayOut
from drivers.modbus.wear import WearLedger
from drivers.paced_stream import PacedGroup, PacedStream
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.set_points import SetPointSettings
from drivers.shared_time import SharedTime
from drivers.standstill import FROZEN_S, FrozenValues, Standstill
from drivers.undo import undo_all

_CONFIRM_S = 0.5
"""Longest time for a drive to show that it obeys a quick stop, s: many times the scan of a slow drive's interface."""
_ATTAINED_S = 0.5
""""Homing attained" that did not go away after the start counts when it and the axis's position stay for this long, s."""


class ModbusDrive(ServoDrive):
    """One unit on a link as a drive. Several drives may share the link; it is closed when the last of them closes.

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
        wear: WearLedger | None = None,
        ledger: FactLedger | None = None,
    ) -> None:
        super().__init__(name, scaling, limits, clock)
        self._ledger = ledger
        self._weak = drive_map.weak()
        self._proving = False
        self._arranged: dict[str, Raw] = {}  # needs that are made to hold, and what was there before, in their order
        self._kept_alive_ns = 0  # when a jog was last ordered
        self._jog: Writes = ()  # the order of the jog under way
        self.link = link
        self.unit = unit
        self.map = drive_map
        self.registers = drive_map.registers
        self.access = RegisterAccess(link, unit, drive_map.registers)
        self._parameters = ModbusParameters(name, drive_map, self.access, clock, wear or WearLedger())
        self._open = False
        self._homed: bool | None = None
        self._homing = False
        self._attained_gone = False  # whether the "homing attained" of the last homing has gone since this one started
        self._attained_stands = Standstill(scaling.resolution_load_mm)  # while it is shown
        self._running = False  # a velocity other than 0 is written in the drive
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
        common = (name, drive_map, self.access, self.values, self.orders)
        self.power = PowerStates(*common, clock=clock, way_out=self.way_out, sample=self.sample)
        self.moves = ProfileMoves(*common, scaling=scaling, limits=limits)

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Connect and take one sample; writes nothing. Raises StateError when it is open already, LinkLostError, NoAnswerError."""
        if self._open:
            raise StateError(f"drive {self.name} is already open")
        self.link.open()
        self._open = True
        try:
            self._homed, self._homing, self._running = None, False, False
            self.moves.under_way = None
            self.orders.forget()
            self.way_out.over()
            self.link.limit_by(self.unit, self.way_out)
            self._require_needs()
            self.access.note(self.map.quick_stop)
            self.sample()
        except BaseException:
            self._open = False
            self.link.close()
            raise

    def close(self) -> None:
        """Disable, restore mode, speeds and ramps as they were found, and disconnect; every step is tried, see `undo_all`.

        Raises nothing when all of it failed without an answer: without a drive nothing can be done.
        """
        if not self._open:
            return
        try:
            with self.way_out.step(last=True):
                undo_all([("", self._disable_at_last), ("", self.orders.put_back), ("", self._put_back_needs)])
        except BridgeError as error:
            if not _is_silence(error) or self._answers():
                raise
        finally:
            self._open = False
            self.link.close()

    def _unmet(self) -> list[Need]:
        """The needs of the map that do not hold now."""
        needs = self.map.needs
        raw = self.access.of_conditions([need.condition for need in needs]) if needs else {}
        return [need for need in needs if not all_hold((need.condition,), raw)]

    def _require_needs(self) -> None:
        """Raise StateError, with the remedy, for a need that only the user can meet."""
        for need in self._unmet():
            if need.write is None:
                raise StateError(self._need_text(need))

    def _need_text(self, need: Need) -> str:
        register = self.registers[need.condition.register]
        value = self.access.integers([register.name])[register.name]
        expected = " or ".join(f"{each:#x}" for each in need.condition.values)
        word = "anything but" if need.condition.negate else "expected"
        place = f"{register.table.value} {register.span.start:#06x}"
        text = f"drive {self.name}: {register.name} ({place}) reads {value:#x}, {word} {expected}: {need.why}"
        return f"{text}; {need.remedy}" if need.remedy else text

    def _arrange_needs(self) -> None:
        """Make hold what the map may make hold; each is read back. Raises StateError for one that does not."""
        for need in self._unmet():
            if need.write is not None:
                name = need.write.register
                if name not in self._arranged:
                    self._arranged |= self.access.read([name])
                self.orders.give((need.write,))
        for need in self._unmet():
            raise StateError(self._need_text(need))

    def _put_back_needs(self) -> None:
        """Restore them, the first arranged last: it may be what keeps the others out of the EEPROM."""
        found, self._arranged = self._arranged, {}
        undo_all(
            [
                (f"{name} not put back", partial(self.access.write, {name: value}))
                for name, value in reversed(found.items())
            ]
        )

    def _disable_at_last(self) -> None:
        """Disable once more where the first try failed and the drive answers, such as one that answers late or was silent for a
        while."""
        try:
            self.disable()
        except HeldUnderPowerError:
            self.orders.forget()  # the mode of an axis under power is not changed
            raise
        except BridgeError:
            if not self._answers():
                raise
            with suppress(BridgeError):  # the error of disabling is reported
                self.quick_stop()
            self.disable()

    def _answers(self) -> bool:
        """Whether the unit gives any answer to one request without repeats."""
        try:
            self._stop_look()
        except TransportError:
            return False
        except BridgeError:
            return True
        return True

    def _require_open(self) -> None:
        if not self._open:
            raise StateError(f"drive {self.name} is not open")

    @property
    def capabilities(self) -> frozenset[Capability]:
        """The capabilities that the map describes."""
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
        """Units by the map's [drive.scaling]: constants of the model, or its registers."""
        self._require_open()
        return (self._parameters.reported_scaling(),)

    def unit_parameters(self) -> dict[str, int | float]:
        """The registers that the map's [drive.scaling] names."""
        self._require_open()
        return self._parameters.unit_parameters()

    # -- facts of the map --------------------------------------------------------------------------------------------
    def preflight(self) -> tuple[tuple[str, bool, str], ...]:
        """Needs of the map, word orders judged by the values found, and the facts that are still to be proven."""
        self._require_open()
        names = [name for name in self.map.wide() if self.registers[name].readable]
        order = judge_orders({name: (self.registers[name], words) for name, words in self.access.words(names).items()})
        good = order.agrees and (order.supported or self.map.speed_is_narrow)
        checks = [("word order", good, order.detail)] if names else []
        waiting = [text for proof in Proof if proof.value in self.unproven() for text in self._weak[proof]]
        if waiting:
            checks.append(("facts", True, f"to be proven on this drive before use: {'; '.join(waiting)}"))
        elif self._weak:
            checks.append(("facts", True, "everything in its map that is assumed was proven on this drive"))
        return tuple(checks)

    def unproven(self) -> frozenset[str]:
        done = frozenset[Proof]() if self._ledger is None else self._ledger.proven()
        return frozenset(proof.value for proof in self._weak if proof not in done and proof is not Proof.PERSON)

    @contextmanager
    def proving(self) -> Iterator[None]:
        before, self._proving = self._proving, True
        try:
            yield
        finally:
            self._proving = before

    def proven(self, what: frozenset[str]) -> None:
        if self._ledger is not None and self._weak:
            self._ledger.add(frozenset(Proof(each) for each in what) & self._weak.keys())

    def _require_proven(self, verb: str, *, homing: bool = False) -> None:
        """Raise StateError for facts that this order rests on and nobody has proven on this drive."""
        waiting = set() if self._proving else {each for each in self.unproven() if (each == "homing") is homing}
        if waiting:
            text = next(text for proof in Proof if proof.value in waiting for text in self._weak[proof])
            option = " --home" if homing else ""
            raise StateError(
                f"drive {self.name} cannot {verb}: its register map rests on facts that are not proven on this drive, such as"
                f" {text}; prove them by: hil doctor AXIS.toml{option}"
            )

    @property
    def correction_table(self) -> ModbusCorrectionTable | None:
        """The table by the map's [drive.correction_table]; None without one."""
        self._require_open()
        blocks = self.map.table
        return None if blocks is None else ModbusCorrectionTable(self.name, self.access, blocks, self._parameters.wear)

    # -- reading ---------------------------------------------------------------------------------------------------
    @property
    def sample_wire_s(self) -> float:
        """Predicted time on the wire of one sample, s."""
        return self.access.plan(self.map.sampled()).wire_s

    def sample(self) -> DriveSample:
        """A fresh sample, all its registers read in as few requests as the wire allows.

        following_error_mm is as the drive gives it, mm. Raises DriveFaultError once when a homing that was started failed, LimitError
        (with a quick stop) when a velocity run comes to the end of the travel, ProtocolError (with a stop) for values that are frozen
        while the axis was ordered to move.
        """
        sample = self._look()
        self._judge_alive(sample)
        self._keep_jogging()
        if self._running and sample.state is DriveState.ENABLED:
            velocity_mm_s = sample.velocity_mm_s or 0.0
            lag_mm = math.copysign(
                sample.following_error_mm or 0.0, velocity_mm_s
            )  # it brakes from its demand position
            self._watch_travel(sample.position_load_mm + lag_mm, velocity_mm_s)
        return sample

    def _judge_alive(self, sample: DriveSample) -> None:
        moving = self._homing or self._running or (self.moves.under_way is not None and not sample.target_reached)
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
        """A sample, without the supervision of a velocity run."""
        self._require_open()
        raw = self.access.read(self.map.sampled())
        time_ns = self.clock.now_ns()
        values, state = self.values, self.values.state(raw)
        if state in FAULTS:
            self._homing = False
        position_mm = self.scaling.load_mm(values.position_counts(raw))
        velocity_mm_s = values.load_mm(raw, self.map.velocity)
        self._look_at_homing(raw, time_ns, position_mm)
        return DriveSample(
            time_ns=time_ns,
            state=state,
            position_load_mm=position_mm,
            target_reached=self.moves.reached(raw) and not self._homing,
            velocity_mm_s=velocity_mm_s,
            torque_percent=values.torque_percent(raw),
            following_error_mm=values.load_mm(raw, self.map.following_error),
            homed=self._homed,
            fault_code=values.fault_code(raw),
        )

    def _look_at_homing(self, raw: dict[str, Raw], time_ns: int, position_mm: float) -> None:
        homing = self.map.homing
        if homing is None or not hold(homing.applies, raw):
            return
        if self._homing and homing.failed and hold(homing.failed, raw):
            self._homing, self._homed = False, False
            if self.values.load_mm(raw, self.map.velocity) != 0.0:
                self.send_stop()
            raise DriveFaultError(f"drive {self.name}: homing failed", self.values.fault_code(raw))
        attained = hold(homing.attained, raw)
        if self._homing and not (self._is_of_this_homing(attained, time_ns, position_mm) and attained):
            return
        self._homing, self._homed = False, attained

    def _is_of_this_homing(self, attained: bool, time_ns: int, position_mm: float) -> bool:
        """Whether the "attained" shown cannot be that of the last homing, which stays until the drive has processed its orders."""
        self._attained_gone = self._attained_gone or not attained
        stayed = self._attained_stands.look(time_ns, position_mm, still_s=_ATTAINED_S)
        return self._attained_gone or stayed

    def zero(self) -> DriveZero:
        """Zero by the map's [drive.homing] and identity."""
        self._require_open()
        identity: dict[str, int | str] = {"map": self.registers.name}
        identity |= {name: str(self._parameters.read(name)) for name in self.map.identity}
        homing = self.map.homing
        if homing is None:
            return DriveZero(identity=identity)
        names = [name for name in (homing.method, homing.home_position) if name is not None]
        raw = self.access.read(names) if names else {}
        method = None if homing.method is None else int(raw[homing.method])
        if (
            method is not None and homing.makers_method
        ):  # another one makes another zero; what it seeks only the manual says
            identity |= {"homing by the maker's method": method}
            method = None
        return DriveZero(method, self.values.load_mm(raw, homing.home_position), identity)

    def says_homed(self) -> bool | None:
        """A flag that is valid in homing mode only is read in that mode, which a disabled drive is put into; the drive may
        have lost it with the change of mode."""
        self._require_open()
        homing = self.map.homing
        if self._homed is None and homing is not None and self.power.state() is DriveState.SWITCH_ON_DISABLED:
            self.orders.set_mode(homing.mode, homing.mode_shown, homing.timeout_s)
            raw = self.access.of_conditions((*homing.applies, *homing.attained))
            return True if all_hold(homing.applies, raw) and all_hold(homing.attained, raw) else None
        return self._homed

    # -- states ----------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self._require_open()
        self._require_proven("enable")
        self.orders.stopped = False
        self.way_out.over()
        try:
            self._enable_by_steps()
        except BridgeError as error:  # a drive that was too slow for a step must not be enabled afterwards
            undo_all([("not disabled", self.disable)], during=error)
            raise

    def _enable_by_steps(self) -> None:
        state = self.power.state()
        if state is DriveState.NOT_READY:
            self.power.await_ready()
        elif state is DriveState.QUICK_STOP and not self._stands_within(self._braking_s()):
            raise MotionTimeoutError(
                f"drive {self.name}: standstill before enabling not within {self._braking_s():g} s"
            )
        self._end_run()
        self._arrange_needs()
        self.moves.set_mode()
        self.power.enable(self._target_here)

    def _target_here(self) -> None:
        """Target := actual, so that switching power on moves nothing."""
        with self.moves.target_kept():
            self._write_here(self.map.move.target)
        self.moves.under_way = None

    def _write_here(self, target: str) -> None:
        counts = 0.0
        if not (self.map.move.relative and target == self.map.move.target):
            counts = self.values.position_counts(self.access.read([self.map.position]))
        self.access.write({target: self.values.raw(counts, target)})

    def disable(self) -> None:
        """Halt, wait for standstill, then power off. An axis that does not come to rest is quick-stopped, and disabled all the same.

        Raises HeldUnderPowerError for an axis that would then fall: it stays under power, quick-stopped. After any other error of the
        wire or the drive a stop was sent.
        """
        self._require_open()
        self._homing = False
        try:
            with self.way_out.step(last=True):
                self._disable()
        except BaseException:
            self.send_stop()
            raise

    def _disable(self) -> None:
        state = self.power.state()
        if state in FAULTS or not self.power.can_disable(state):
            self._end_run()
            return  # the power stage is off
        if state in (DriveState.ENABLED, DriveState.QUICK_STOP):
            self._come_to_rest(state)
        undo_all([("", partial(self._power_off, state)), ("", self._end_run)])
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
        self._homing = False
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
        """Whether one sample, without repeats, shows the stop."""
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

    def reset_fault(self) -> None:
        """Acknowledge by the map's sequence; leaves the axis disabled. Raises DriveFaultError when the cause is still there."""
        self._require_open()
        self.power.reset_fault()

    # -- motion ----------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        homing = self.map.homing
        if homing is None:
            why = self.map.without_homing
            raise StateError(f"drive {self.name}: its register map has no homing{why and ': ' + why}")
        if homing.at_power_on and self.falls_without_power:
            raise StateError(
                f"drive {self.name} homes only as its power comes on, so it has to be taken off first: gravity can move the axis"
                " and no brake is stated"
            )
        self._require_proven("home", homing=True)
        self.moves.under_way = None
        with self._no_motion_after_errors():
            self._end_run()
            self._release_homing(homing)
            self.orders.set_mode(homing.mode, homing.mode_shown, homing.timeout_s)
            self._homed = False
            if homing.at_power_on:
                self._disable()
                self.orders.remember([write.register for write in homing.start if write.mask is None])
            self.orders.start(homing.start, "homing", homing.timeout_s)
            self.orders.wait_for(homing.accepted, "homing to be taken up", homing.timeout_s, homing.remedy)
            self._attained_gone, self._attained_stands = False, Standstill(self.scaling.resolution_load_mm)
            self._homing = True
            deadline = self.clock.deadline(homing.timeout_s)
            while not self._attained_seen(homing) and not deadline.expired:
                self.clock.sleep_s(POLL_S)

    def _attained_seen(self, homing: HomingMap) -> bool:
        """Whether one sample shows that "attained" has gone, or has stayed for long enough."""
        raw = self.access.read(self.map.sampled())
        position_mm = self.scaling.load_mm(self.values.position_counts(raw))
        attained = hold(homing.applies, raw) and hold(homing.attained, raw)
        return self._is_of_this_homing(attained, self.clock.now_ns(), position_mm)

    def _release_homing(self, homing: HomingMap) -> None:
        self.orders.give(homing.release)

    def _leave_homing(self, raw: dict[str, Raw]) -> None:
        """Take back a homing order that is still set: it would start another homing, or act as a new set-point."""
        homing = self.map.homing
        self._homing = False
        if homing is not None and homing.applies and hold(homing.applies, raw):
            self._release_homing(homing)

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        raw = self.access.read(self.map.sampled())
        move = self.moves.planned(position_load_mm, velocity_mm_s, raw)  # refuses before anything is written
        with self._no_motion_after_errors():
            self._leave_homing(raw)
            self._end_run()
            self.moves.make_ready(raw)
            self.moves.begin(move)

    # -- velocity runs and streams ---------------------------------------------------------------------------------------
    def _start_velocity(self, velocity_mm_s: float) -> None:
        run = self.map.run
        if run is None:
            raise CapabilityError(f"drive {self.name}: its register map has no velocity run")
        counts_per_s = self.scaling.direction * velocity_mm_s * self.scaling.counts_per_load_mm
        if run.forward:
            self._start_jog(run, counts_per_s)
            return
        target = {run.target: self.values.raw(counts_per_s, run.target)}  # refuses before anything is written
        raw = self.access.read(self.map.sampled())
        self.moves.under_way = None
        with self._no_motion_after_errors():
            self._leave_homing(raw)
            self.access.write(self.moves.ramp_settings(run.acceleration, run.deceleration))
            if not self._running:
                self._write_no_velocity()  # an old velocity must not take effect with the mode
            self.orders.set_mode(run.mode, run.mode_shown, run.timeout_s)
            self._running = True
            self.orders.start(run.start, "velocity run", run.timeout_s)
            self.orders.write(target)

    def _start_jog(self, run: RunMap, counts_per_s: float) -> None:
        """Jog: the speed without its sign, then the order of its direction, which `sample` repeats where it has to be."""
        target = self.values.raw_speed(abs(counts_per_s), run.target) if counts_per_s else None
        self.moves.under_way = None
        with self._no_motion_after_errors():
            self._end_run()
            if target is None:
                return
            self.orders.remember((run.target,))
            self.access.write({run.target: target, **self.moves.ramp_settings(run.acceleration, run.deceleration)})
            self._running, self._jog = True, run.forward if counts_per_s > 0 else run.backward
            self._kept_alive_ns = self.clock.now_ns()
            self.orders.start(self._jog, "jog", run.timeout_s)

    def _keep_jogging(self) -> None:
        """Order a jog again that would end by itself. Half the time is left for the wire; a sample that is late lets it end."""
        run = self.map.run
        if run is None or run.keep_alive_s is None or not (self._running and self._jog) or self.orders.stopped:
            return
        age_s = (self.clock.now_ns() - self._kept_alive_ns) / NS_PER_S
        if age_s >= 0.5 * run.keep_alive_s:
            self._kept_alive_ns = self.clock.now_ns()
            self.orders.give(self._jog)

    def _write_no_velocity(self) -> None:
        if self._jog and self.map.run is not None:
            self._jog = ()
            self.orders.give(self.map.run.stop)
            return
        if self.map.run is not None:
            self.access.write({self.map.run.target: self.values.raw(0.0, self.map.run.target)})

    def _end_run(self) -> None:
        """Write 0 to the velocity register, so that no velocity stays in the drive."""
        if self._running:
            self._write_no_velocity()
            self._running = False

    def _stream(self, settings: SetPointSettings) -> ModbusStream:
        if self.map.stream is None:
            raise CapabilityError(f"drive {self.name}: its register map has no cyclic set-point")
        return ModbusStream(self, self.map.stream, settings)

    def _stream_with(self, others: Sequence[ServoDrive], settings: SetPointSettings) -> PacedGroup:
        return PacedGroup([self, *others], settings)

    def begin_stream(self) -> DriveSample:
        """For `ModbusStream`: target := actual, then the mode in which the drive follows it; a sample. Raises CapabilityError."""
        stream = self.map.stream
        self._require_enabled("stream")
        if stream is None:
            raise CapabilityError(f"drive {self.name}: its register map has no cyclic set-point")
        with self._no_motion_after_errors():
            self._end_run()
            self._leave_homing(self.access.read(self.map.sampled()))
            self._write_here(stream.target)
            self.orders.set_mode(stream.mode, stream.mode_shown, stream.timeout_s)
            self.orders.start(stream.start, "stream", stream.timeout_s)
            return self.sample()

    def send_set_point(self, position_load_mm: float) -> None:
        """For `ModbusStream`: the next set-point, load mm."""
        target = self.map.stream.target if self.map.stream is not None else self.map.move.target
        counts = float(self.scaling.motor_counts(position_load_mm))
        self.orders.write({target: self.values.raw(counts, target)})

    def end_stream(self) -> None:
        """For `ModbusStream`: return to the mode of moves, held where it is."""
        with self._no_motion_after_errors():
            self._target_here()
            self.moves.set_mode()

    # -- touch probe and parameters --------------------------------------------------------------------------------------
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
        """Parameters by the names of the register map."""
        return self._parameters


class ModbusStream(PacedStream):
    """Each cycle writes one set-point and reads one sample. Entering raises InputError for a period that map or wire cannot keep."""

    def __init__(self, drive: ModbusDrive, stream: StreamMap, settings: SetPointSettings) -> None:
        super().__init__(drive, settings)
        self._modbus = drive
        self._stream = stream

    def _begin(self) -> DriveSample:
        drive, period_s = self._modbus, self.settings.period_s
        target = drive.registers[self._stream.target]
        wire_s = drive.sample_wire_s + drive.link.cost.write_s(target.table, target.span.count)
        for least_s, whose in ((self._stream.least_period_s, "the drive by its register map"), (wire_s, "the wire")):
            if period_s < least_s:
                raise InputError(
                    f"drive {drive.name}: stream period is {1e3 * period_s:g} ms, {whose} needs {1e3 * least_s:.3g} ms"
                )
        return drive.begin_stream()

    def _send(self, position_load_mm: float) -> None:
        self._modbus.send_set_point(position_load_mm)

    def _end(self) -> None:
        self._modbus.end_stream()


def _is_silence(error: BridgeError) -> bool:
    """Whether the error consists of unanswered requests only."""
    if isinstance(error, UndoError):
        return all(_is_silence(each) for each in error.errors)
    return isinstance(error, TransportError)
