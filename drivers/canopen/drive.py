"""CanOpenDrive: a CiA-402 servo drive behind the `ServoDrive` abstraction.

What may go in: what makes a CANopen node a ServoDrive - opening it safely, fresh samples, and who does what when it moves. Walking
the power states is `power`'s work, moves are `motion`'s, homing `homing`'s, SDO `sdo`'s, PDOs `pdo`'s, supervision `node`'s. One link
may carry several drives; whoever made the link closes it.

A sample is asked for: SYNC goes out and the synchronous TPDOs that answer it are waited for, so it is never older than the call.
While another owns SYNC (`sync.Sync`) the values are read by SDO.

A stop goes out by every way there is, the fastest first, before anything is asked: `send_stop`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING

from drivers.canopen import objects
from drivers.canopen.bus import STOP_SEND_S, CanLink
from drivers.canopen.cia402 import QUICK_STOP_ENDINGS, Command, Control, Mode, Status, decode_state
from drivers.canopen.connection import Connection
from drivers.canopen.correction_table import CanOpenCorrectionTable
from drivers.canopen.eds import EdsFile
from drivers.canopen.homing import Homing
from drivers.canopen.identity import Identity, error_history, read_identity, stores_on_command
from drivers.canopen.motion import FAULTS, LOOK_S, RUN, ProfileMotion, Standstill
from drivers.canopen.named_parameters import NamedParameters
from drivers.canopen.node import NmtCommand, NodeMonitor
from drivers.canopen.one_axis_stream import AxesInStep, OneAxisStream
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_lint import Finding
from drivers.canopen.power import PowerStage
from drivers.canopen.reported import readings
from drivers.canopen.sampling import Sampler, exists, sampled_pdos
from drivers.canopen.sdo import SdoClient
from drivers.canopen.settings import CanOpenSettings, HomingSettings
from drivers.canopen.sync import SYNC
from drivers.canopen.table_map import TableMap
from drivers.canopen.touch_probe import CanOpenTouchProbe
from drivers.canopen.units import read_units
from drivers.clock import Clock
from drivers.drive import Capability, DriveLimits, DriveSample, DriveState, DriveZero, ServoDrive
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    HeldUnderPowerError,
    InputError,
    LimitError,
    LinkLostError,
    MotionTimeoutError,
    NoAnswerError,
    StateError,
    TransportError,
    UndoError,
)
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.set_points import SetPointSettings
from drivers.undo import undo_all

if TYPE_CHECKING:
    from drivers.canopen.stream_axis import Axis  # which streams to the drives

__all__ = ["CanOpenDrive", "CanOpenSettings", "HomingSettings", "Identity"]

WITHOUT_TORQUE = (
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY,
    DriveState.SWITCHED_ON,
    DriveState.FAULT,
)
"""States in which a drive does not move its axis."""
STOP_SHOWN_S = 0.1
"""How long a drive may take to leave operation enabled after it confirmed the quick stop command, s: ten slow control cycles."""


class CanOpenDrive(ServoDrive):
    """One node as a drive.

    Raises from its methods, besides what ServoDrive names: NoAnswerError and LinkLostError (wire, heartbeat, restart of the node),
    AbortError (a refused access, naming object and reason), ProtocolError.
    """

    def __init__(
        self,
        name: str,
        scaling: AxisScaling,
        limits: DriveLimits,
        clock: Clock,
        *,
        link: CanLink,
        node_id: int,
        settings: CanOpenSettings | None = None,
        eds: EdsFile | None = None,
        table: TableMap | None = None,
    ) -> None:
        super().__init__(name, scaling, limits, clock)
        self.link = link
        self.node_id = node_id
        self.settings = settings or CanOpenSettings()
        self.eds = eds  # the PDO linter asks it what may be mapped
        self.table_map = table  # of the correction table that the drive holds itself
        self.identity: Identity | None = None
        self.notes: list[str] = []  # what open found worth telling an engineer
        self._open = False
        self._fault_code: int | None = None
        self._has_probe = self._stores = False
        self._stream_axis: Axis | None = None
        self._braking_s = self.settings.power.stop_s
        self._stop_lets_go = True
        self._braking_awaited = False  # it had the time that braking needs, and was not heard since
        self._parameters: NamedParameters | None = None
        self.rpdo = PdoSpec(1, False, 0x200 + node_id, SYNC_EVERY, (objects.CONTROLWORD, objects.TARGET_POSITION))

    # -- connection ------------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Find the node, read who it is and what it can, map the PDOs, supervise its heartbeat. Nothing is enabled or moved."""
        if self._open:
            raise StateError(f"drive {self.name} is already open")
        where = f"drive {self.name}"
        self.sdo = SdoClient(self.link, self.node_id, where, timeout_s=self.settings.sdo_timeout_s)
        self.monitor = NodeMonitor(self.link, self.node_id, where)
        self.power = PowerStage(self.sdo, self.clock, self.settings.power)
        self.sampler = Sampler(self.link, self.sdo, self.monitor, (), timeout_s=self.settings.sample_timeout_s)
        self._stream_axis = None
        dictionary = None if self.eds is None else self.eds.mappable_objects()
        self.connection = Connection(self.link, self.sdo, self.monitor, self.settings, dictionary)
        try:
            self.link.listen()
            self.identity = read_identity(self.sdo)
            self.sampler.specs = sampled_pdos(self.sdo, self.node_id)
            self.motion = ProfileMotion(
                self.sdo,
                self.power,
                self.sampler,
                self.clock,
                handshake_s=self.settings.handshake_timeout_s,
                mode_s=self.settings.mode_timeout_s,
            )
            self.homing = Homing(self.name, self.power, self.motion)
            self._has_probe = exists(self.sdo, objects.PROBE_FUNCTION)
            self._stores = stores_on_command(self.sdo)
            self._note_ramps()
            self._set_up()
            self.notes += self.connection.notes
            self._open = True
            self.sample()
        except BaseException as error:
            with self.sdo.way_out:
                undo_all([("", self.connection.put_back)], during=error)
            self._release()
            raise

    def _set_up(self) -> None:
        """PDOs, heartbeats, and SYNC as its owner needs."""
        self.sampler.subscribe()

        def settle() -> None:
            self.sampler.mapped()
            with suppress(AbortError):  # a drive whose TPDOs cannot be switched off answers whoever sends SYNC
                self.sampler.settle()

        self.connection.set_up((*self.sampler.specs, self.rpdo), settle)

    @property
    def pdo_findings(self) -> list[Finding]:
        """What the linter pointed out when the PDOs were set up."""
        self._require_open()
        return self.connection.pdo_findings

    def _note_ramps(self) -> None:
        """What an engineer should know of the quick stop; said once, changed never.

        One that brakes less than a move does overshoots the move's target; one that ends without power lets an axis fall that gravity
        can move.
        """
        self.notes = []
        self._stop_lets_go = not self._quick_stop_holds()
        if self.falls_without_power and self._stop_lets_go:
            self.notes.append(
                f"drive {self.name}: gravity can move this axis and no brake is stated, but after a quick stop (605Ah) its drive"
                " switches its power off"
            )
        quick = self.sdo.read_or(objects.QUICK_STOP_DECELERATION, 0)
        ordinary = self.scaling.motor_counts_per_s(self.limits.max_acceleration_mm_s2)
        if 0 < quick < ordinary:
            self.notes.append(
                f"drive {self.name}: quick stop (6085h) brakes with {quick * self.scaling.resolution_load_mm:g} mm/s²,"
                f" moves with up to {self.limits.max_acceleration_mm_s2:g} mm/s²: a stop may overshoot the target"
            )
        braking_mm_s2 = quick * self.scaling.resolution_load_mm or self.limits.max_acceleration_mm_s2
        # and what the drive and the bus take, generously: ten looks
        self._braking_s = min(self.limits.max_velocity_mm_s / braking_mm_s2 + 10 * LOOK_S, self.settings.power.stop_s)

    @contextmanager
    def as_found(self) -> Iterator[None]:
        """Communication, mode, speeds and ramps as `open` found them, for a store or a survey; afterwards set up again as they were.

        Raises StateError unless the axis is disabled.
        """
        self.require_disabled("be put back as it was found")
        self.monitor.expect_heartbeat(None)
        self.sampler.unsubscribe()
        self.motion.put_back()
        self.connection.put_back()
        try:
            yield
        finally:
            self._set_up()

    def require_disabled(self, verb: str) -> None:
        """Raise StateError unless the axis is without power."""
        state = self.sample().state
        if state not in (DriveState.SWITCH_ON_DISABLED, DriveState.READY, DriveState.FAULT):
            raise StateError(f"drive {self.name} cannot {verb}: it is {state.value}, disable it first")

    def restart(self, timeout_s: float = 5.0) -> None:
        """Start the node anew (NMT reset node) and open it again: stored parameters or restored defaults come into force.

        Raises StateError unless the axis is disabled, NoAnswerError when no boot-up comes within `timeout_s`.
        """
        self.require_disabled("be restarted")
        before = self.monitor.boot_ups
        self.monitor.expect_heartbeat(None)
        self.monitor.command(NmtCommand.RESET_NODE)
        started = self.link.wait(lambda: self.monitor.boot_ups > before, timeout_s)
        self._release()
        if not started:
            raise NoAnswerError(
                f"drive {self.name}: no boot-up of node {self.node_id} within {timeout_s:g} s of its reset"
            )
        self.open()

    def close(self) -> None:
        """Bring the axis to rest and take its power off, by whatever still reaches it; then put back what was found.

        Every step is tried. Raises what failed (`undo_all`), but not for a wire that is dead: there is nobody left to tell.
        """
        if not self._open:
            return
        try:
            with self.sdo.way_out:
                self._shut_down()
        except TransportError:
            pass
        except UndoError as error:
            if not all(isinstance(part, TransportError) for part in error.errors):
                raise
        finally:
            self._release()

    def _shut_down(self) -> None:
        """Leave the axis disabled, and mode, speeds, ramps and communication as they were found."""
        self.monitor.expect_heartbeat(None)  # a heartbeat that is missing keeps nobody from being stopped
        ended: list[BridgeError | None] = []

        def disable() -> None:
            try:
                self.disable()
            except BridgeError as error:
                ended.append(error)
                raise
            ended.append(None)

        def put_back() -> None:
            failed = ended[0] if ended else None
            self.sdo.read(objects.STATUSWORD)  # with nobody there each setting would cost a time-out of its own
            steps = [] if failed is not None or not ended else [("", self.motion.put_back)]
            may_move = not ended or (failed is not None and not isinstance(failed, HeldUnderPowerError))
            undo_all([*steps, ("", partial(self.connection.put_back, unwatched=not may_move))])

        undo_all([("", disable), ("", put_back)])

    def _release(self) -> None:
        self._open = False
        self.sampler.unsubscribe()
        self.monitor.close()
        self.sdo.close()

    @property
    def capabilities(self) -> frozenset[Capability]:
        """From 6502h and from which objects answered; known once open."""
        self._require_open()
        found = {Capability.PARAMETERS}
        for mode, capability in (
            (Mode.PROFILE_POSITION, Capability.PROFILE_POSITION),
            (Mode.PROFILE_VELOCITY, Capability.PROFILE_VELOCITY),
            (Mode.HOMING, Capability.HOMING),
            (Mode.CYCLIC_POSITION, Capability.STREAMING),
        ):
            if self.motion.supports(mode):
                found.add(capability)
        if objects.TORQUE_ACTUAL in self.sampler.specs[0].entries:
            found.add(Capability.TORQUE_ACTUAL)
        if self._has_probe:
            found.add(Capability.TOUCH_PROBE)
        if self._stores:
            found.add(Capability.STORE)
        return frozenset(found)

    def _require_open(self) -> None:
        if not self._open:
            raise StateError(f"drive {self.name} is not open")

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """608Fh, 6091h, 6092h and 60A8h."""
        self._require_open()
        return readings(read_units(self.sdo))

    # -- reading ---------------------------------------------------------------------------------------------------------
    def sample(self) -> DriveSample:
        """A fresh sample by SYNC. following_error_mm is demand − actual, as 60F4h has it.

        Raises NoAnswerError when the node does not answer SYNC (twice), LinkLostError when its heartbeat stopped or it restarted,
        DriveFaultError once when a homing that was started failed, LimitError (with a quick stop) when a velocity run comes to the
        end of the travel.
        """
        self._require_open()
        self.sampler.refresh()
        status = self.sampler.statusword
        state = decode_state(status)
        if state in FAULTS:
            if self._fault_code is None:
                self._fault_code = self.power.error_code()
            self.homing.under_way = False
        else:
            self._fault_code = None
        velocity = self.sampler.values.get(objects.VELOCITY_ACTUAL)
        slow = velocity is None or Standstill.is_slow(self.scaling.load_mm(velocity))
        self.homing.look(self.sampler.heard_ns, status, self.sampler.position_counts, slow=slow)
        sample = self._as_sample()
        if self.motion.mode is Mode.PROFILE_VELOCITY and state is DriveState.ENABLED:
            self._watch_travel(sample.position_load_mm, sample.velocity_mm_s)
        return sample

    def _as_sample(self) -> DriveSample:
        """What was heard last."""
        values, scaling, status = self.sampler.values, self.scaling, self.sampler.statusword
        velocity = values.get(objects.VELOCITY_ACTUAL)
        torque = values.get(objects.TORQUE_ACTUAL)
        error = values.get(objects.FOLLOWING_ERROR_ACTUAL)
        return DriveSample(
            self.sampler.heard_ns,
            decode_state(status),
            scaling.load_mm(self.sampler.position_counts),
            bool(status & Status.TARGET_REACHED) and not self.homing.under_way,
            None if velocity is None else scaling.load_mm(velocity),
            None if torque is None else scaling.direction * torque / 10.0,
            None if error is None else scaling.load_mm(error),
            self.homing.homed,
            self._fault_code,
            limited=bool(status & Status.INTERNAL_LIMIT),
        )

    def zero(self) -> DriveZero:
        """6098h and 607Ch as the next homing will use them, and 1018h."""
        self._require_open()
        asked, sdo, identity = self.settings.homing, self.sdo, self.identity
        method, home_mm = asked.method, asked.home_position_mm
        if self.motion.supports(Mode.HOMING):
            method = sdo.read(objects.HOMING_METHOD) if method is None else method
            home_mm = self.scaling.load_mm(sdo.read_or(objects.HOME_OFFSET, 0)) if home_mm is None else home_mm
        facts: dict[str, int | str] = {}
        if identity is not None:
            facts = {"vendor": identity.vendor_id, "product": identity.product_code, "serial": identity.serial}
        return DriveZero(method, home_mm, facts)

    def says_homed(self) -> bool | None:
        """6041h bit 12 in homing mode, which a disabled drive is put into; a drive may have forgotten it with the change of mode."""
        self._require_open()
        if self.homing.homed is not None or not self.motion.supports(Mode.HOMING):
            return self.homing.homed
        if decode_state(self.sdo.read(objects.STATUSWORD)) is DriveState.SWITCH_ON_DISABLED:
            self.set_mode(Mode.HOMING)
            self.homing.believe(self.sdo.read(objects.STATUSWORD))
        return self.homing.homed

    def complaints(self) -> tuple[str, ...]:
        """The warning bit of the last statusword, and the last emergency unless it said that the errors are gone."""
        self._require_open()
        told = ["a warning (bit 7 of the statusword)"] if self.sampler.statusword & Status.WARNING else []
        if self.monitor.last_error_code():
            told.append(f"emergency: {self.monitor.log[-1]}")
        return tuple(told)

    def error_history(self) -> list[int]:
        """The drive's own list of errors (1003h), the latest first; the lower 16 bits of each are an error code."""
        self._require_open()
        return error_history(self.sdo)

    # -- what stands beside the motion -------------------------------------------------------------------------------------
    def _touch_probe(self) -> CanOpenTouchProbe:
        return CanOpenTouchProbe(self.name, self.clock, self.scaling, lambda: self.sdo)

    @property
    def parameters(self) -> NamedParameters:
        """By the drive's EDS where it was given one, and the standard's objects."""
        self._require_open()
        if self._parameters is None:
            self._parameters = NamedParameters(self, self.eds)
        return self._parameters

    @property
    def correction_table(self) -> CanOpenCorrectionTable | None:
        """By the map that the drive was given."""
        self._require_open()
        return None if self.table_map is None else CanOpenCorrectionTable(self.name, lambda: self.sdo, self.table_map)

    # -- streaming ---------------------------------------------------------------------------------------------------------
    @property
    def is_streaming(self) -> bool:
        """Whether a `stream.CyclicStream` paces this drive; its samples come by SDO meanwhile, as SYNC belongs to the stream."""
        return self.sampler.by_sdo

    def _stream(self, settings: SetPointSettings) -> OneAxisStream:
        return OneAxisStream(self, settings)

    def _stream_with(self, others: Sequence[ServoDrive], settings: SetPointSettings) -> AxesInStep:
        in_step = [self, *(drive for drive in others if isinstance(drive, CanOpenDrive) and drive.link is self.link)]
        if len(in_step) <= len(others):
            names = ", ".join(drive.name for drive in (self, *others))
            raise CapabilityError(
                f"drives {names} are not all on one CAN bus, so that no SYNC could pace them together"
            )
        return AxesInStep(in_step, settings)

    def begin_streaming(self, axis: Axis) -> None:
        """A stream takes over SYNC and the PDOs; it puts the PDOs back before `end_streaming`."""
        self._require_open()
        if self.is_streaming:
            raise StateError(f"drive {self.name} is streaming already")
        self.sampler.by_sdo = True
        self.sampler.unsubscribe()
        self._stream_axis = axis

    def end_streaming(self) -> None:
        """The PDOs are those of `open` again."""
        self._stream_axis = None
        self.sampler.by_sdo = False
        self.sampler.subscribe()

    # -- states ----------------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self.power.stopped = self.power.disobeyed = self._braking_awaited = False
        self.sdo.way_out.end()
        self.set_mode(Mode.PROFILE_POSITION)
        if self.power.state() is DriveState.QUICK_STOP and self._quick_stop_holds():
            with self._stopped_if_it_fails():
                if not self._comes_to_rest(self.settings.power.stop_s):
                    raise MotionTimeoutError(f"drive {self.name}: still moving in quick stop, not enabled")
                self.power.resume_from_quick_stop(self.motion.stay)
            return
        try:
            self.power.enable(self.motion.stay)
        except BaseException as error:
            # a brake that opens later would complete an enabling that was given up
            self._send(Command.DISABLE_VOLTAGE.word)
            with self.sdo.way_out:
                undo_all([("", partial(self.power.write, Command.DISABLE_VOLTAGE.word))], during=error)
            raise

    def _quick_stop_holds(self) -> bool:
        ending = QUICK_STOP_ENDINGS.get(self.sdo.read_or(objects.QUICK_STOP_OPTION, 2))
        return ending is not None and ending.stays

    def disable(self) -> None:
        """Halt, and take the power off once the axis stands. Where the halt is not confirmed or no standstill is shown in its time:
        quick stop first, and the power goes all the same, unless the axis falls without it.

        Works without the node's heartbeat, and by SDO or PDO alone. Raises HeldUnderPowerError for an axis that falls and is held,
        MotionTimeoutError when it was disabled without having been seen at rest, or is not seen disabled, and what the wire raises.
        """
        self._require_open()
        with self.sdo.way_out:
            self._disable()

    def _disable(self) -> None:
        self.homing.under_way = False
        at_rest = self._brought_to_rest()
        if not at_rest and self.falls_without_power:
            raise HeldUnderPowerError(
                f"drive {self.name} was stopped but not seen at rest, and gravity can move its axis: it is left under power"
            )
        self._take_power()
        if self.motion.mode is Mode.PROFILE_VELOCITY:
            self.motion.stay()  # a speed that is left in the drive would come to life with the next enabling
        if not at_rest:
            raise MotionTimeoutError(
                f"drive {self.name}: no standstill within {self.settings.power.stop_s:g} s; quick-stopped and disabled all the same"
            )

    def _brought_to_rest(self) -> bool:
        """Halt, else quick stop; False when no standstill was seen."""
        halted = False
        try:
            if not self.sampler.heard_by_sync():
                if not (self.sampler.by_sdo or self.link.sync.taken):
                    self.send_stop()  # it should have answered: stop first, ask later
                self.sampler.refresh_somehow()
            state = decode_state(self.sampler.statusword)
            if state in WITHOUT_TORQUE:
                return True
            if state is DriveState.ENABLED:
                if not self.power.stopped:
                    self._send(RUN | Control.HALT, by_sdo=False)  # SDO may be dead, and its answer is waited for
                self.motion.halt()
                halted = True
            if self._comes_to_rest(self.settings.power.stop_s):
                return True
        except BridgeError:  # the halt is not confirmed
            pass
        if not (
            halted and self.falls_without_power and self._stop_lets_go
        ):  # then the halt holds it, a quick stop would not
            self.send_stop()
        try:
            return self._comes_to_rest(self.settings.power.stop_s)
        except LinkLostError:
            return False
        except BridgeError:  # nobody answers: it has the time that braking needs, before its power is taken
            if not self._braking_awaited:
                self.clock.sleep_s(self._braking_s)
                self._braking_awaited = True
            return False

    def _comes_to_rest(self, timeout_s: float) -> bool:
        """Look until it stands, or has no torque; False when neither was shown in time. Raises when nobody answers."""
        standstill = Standstill(self.scaling.counts_per_load_mm)
        sampler, deadline = self.sampler, self.clock.deadline(timeout_s)
        while True:
            sampler.refresh_somehow()
            self._braking_awaited = False
            status = sampler.statusword
            with suppress(BridgeError):  # whoever watches has no say in this
                self.looked_at(self._as_sample())
            velocity = sampler.values.get(objects.VELOCITY_ACTUAL)
            stands = standstill.look(
                sampler.heard_ns, sampler.position_counts, velocity, bool(status & Status.TARGET_REACHED)
            )
            if stands or decode_state(status) in WITHOUT_TORQUE:
                return True
            if deadline.expired:
                return False
            self.clock.sleep_s(LOOK_S)

    def _take_power(self) -> None:
        """By SDO, every step confirmed; else by RPDO, and seen by TPDO. Raises what SDO raised when it is not seen."""
        try:
            self.power.disable()
        except (TransportError, MotionTimeoutError):
            self._send(Command.DISABLE_VOLTAGE.word)
            if not self.sampler.heard_by_sync() or decode_state(self.sampler.statusword) not in WITHOUT_TORQUE:
                raise

    # -- stopping ----------------------------------------------------------------------------------------------------------
    def send_stop(self) -> None:
        """By event-driven RPDO, or the synchronous one with SYNC, and by SDO. No command enables the axis until `enable` is called."""
        if not self._open:
            return
        self.power.stopped = True
        self._send(Command.QUICK_STOP.word)
        self.sdo.way_out.begin()

    def quick_stop(self) -> None:
        """Quick stop command; what follows the ramp is up to the drive's 605Ah.

        Raises NoAnswerError, LinkLostError when nobody confirms it, AbortError when it is refused by SDO and not shown,
        MotionTimeoutError when the drive stays in operation enabled.
        """
        self._require_open()
        with self.sdo.way_out:
            self._quick_stop()

    def _quick_stop(self) -> None:
        self.send_stop()
        self.homing.under_way = False
        with suppress(LinkLostError):
            if self._stop_is_shown():
                return
        self.power.write(Command.QUICK_STOP.word)
        deadline = self.clock.deadline(STOP_SHOWN_S)
        while decode_state(status := self.power.statusword()) is DriveState.ENABLED:
            if deadline.expired:
                self.power.disobeyed = True
                raise MotionTimeoutError(
                    f"drive {self.name}: the quick stop was sent, but it stays enabled{self.power.why(DriveState.ENABLED, status)}"
                )
            self.clock.sleep_s(LOOK_S)

    def _stop_is_shown(self) -> bool:
        """By a TPDO; False where none comes."""
        axis = self._stream_axis
        if axis is None:
            return self.sampler.heard_by_sync() and decode_state(self.sampler.statusword) is not DriveState.ENABLED
        axis.fresh = False
        if axis.sync_by_host:
            self.link.send(SYNC, b"")
        heard = self.link.wait(lambda: axis.fresh, self.settings.sample_timeout_s)
        return heard and decode_state(axis.status) is not DriveState.ENABLED

    def _send(self, word: int, *, by_sdo: bool = True) -> None:
        """A controlword that stops the axis or takes its power, by every way there is; one that fails does not keep the others.

        Waits for nothing and takes no lock of ours: for any thread, and a signal handler.
        """
        ways = self._ways(word)
        for way in ways if by_sdo else ways[:-1]:
            with suppress(Exception):
                way()

    def _ways(self, word: int) -> list[Callable[[], None]]:
        """The fastest first. In a stream its RPDO carries the command too: what waits in the drive for the next SYNC would let the
        axis go on. SYNC is sent only where it is ours, or where nobody is heard to send it. SDO is the last."""
        stop, axis = self.connection.stop_rpdo, self._stream_axis
        ways: list[Callable[[], None]] = []
        if stop is not None:
            ways.append(partial(self.link.send, stop.cob_id, stop.codec.pack(word), STOP_SEND_S))
        if axis is not None:
            ways.append(partial(self.link.send_message, axis.command(word), STOP_SEND_S))
        elif stop is None and self.connection.mapped:
            place = self.sampler.values.get(objects.POSITION_ACTUAL, 0)
            ways.append(partial(self.link.send, self.rpdo.cob_id, self.rpdo.codec.pack(word, place), STOP_SEND_S))
        if stop is None and ways and not self.link.sync.foreign_runs and (axis is None or axis.sync_by_host):
            ways.append(partial(self.link.send, SYNC, b"", STOP_SEND_S))
        ways.append(partial(self.sdo.send_at_once, objects.CONTROLWORD, word))
        return ways

    @contextmanager
    def _stopped_if_it_fails(self) -> Iterator[None]:
        """Around what sets the axis in motion or changes how it moves: no error is raised beside a moving axis.

        An order that is not confirmed: the axis is halted (else quick-stopped) and its power taken off, see `disable`. A refusal
        before anything was ordered leaves the axis as it is; a fault has the drive stop by itself. On an interrupt a stop is sent, and
        the rest left to who handles it.
        """
        try:
            yield
        except (StateError, CapabilityError, InputError, DriveFaultError):
            raise
        except LimitError as error:  # refused by the drive after it was ordered, and halted
            if not self._seen_at_rest():
                self._bring_down(error)
            raise
        except BridgeError as error:
            self._bring_down(error)
            raise
        except BaseException:
            self.send_stop()
            raise

    def _seen_at_rest(self) -> bool:
        try:
            return self._comes_to_rest(self.settings.power.stop_s)
        except BridgeError:
            return False

    def _bring_down(self, error: BridgeError) -> None:
        try:
            self.disable()
        except HeldUnderPowerError as held:
            raise HeldUnderPowerError(f"{held}; {error}") from error
        except BridgeError as worse:
            error.add_note(str(worse))

    def reset_fault(self) -> None:
        """Rising edge of the reset bit; the axis stays disabled. Raises DriveFaultError when the fault's cause is still there."""
        self._require_open()
        self.power.reset_fault()

    # -- modes and profile moves -------------------------------------------------------------------------------------------
    def set_mode(self, mode: Mode) -> None:
        """Change the mode of operation; see `ProfileMotion.set_mode`."""
        self._require_open()
        with self._stopped_if_it_fails():
            self.motion.set_mode(mode)
        self.homing.under_way = False

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        self.homing.under_way = False
        self._move(position_load_mm, velocity_mm_s, after_the_present=False)

    def queue_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        """A set-point that follows the move under way without a stop between being asked for; the drive holds one.

        Raises as `start_move`, and StateError when the drive holds one already.
        """
        self.limits.check_target(position_load_mm)
        self.limits.check_velocity(velocity_mm_s)
        self._require_enabled("move")
        self._move(position_load_mm, velocity_mm_s, after_the_present=True)

    def _move(self, position_load_mm: float, velocity_mm_s: float, *, after_the_present: bool) -> None:
        scaling = self.scaling
        with self._stopped_if_it_fails():
            self.motion.move(
                scaling.motor_counts(position_load_mm),
                scaling.motor_counts_per_s(velocity_mm_s),
                scaling.motor_counts_per_s(self.limits.max_acceleration_mm_s2),
                after_the_present=after_the_present,
            )

    def _start_velocity(self, velocity_mm_s: float) -> None:
        self.homing.under_way = False
        counts = self.scaling.motor_counts_per_s(velocity_mm_s) if velocity_mm_s else 0
        sign = self.scaling.direction * (1 if velocity_mm_s > 0 else -1)
        with self._stopped_if_it_fails():
            self.motion.run_at(sign * counts, self.scaling.motor_counts_per_s(self.limits.max_acceleration_mm_s2))

    def halt(self) -> None:
        """Stop with the ramp of 605Dh and hold; `resume` goes on with the order under way."""
        self._require_enabled("halt")
        self.motion.halt()

    def resume(self) -> None:
        """End a halt."""
        self._require_enabled("resume")
        self.motion.resume()

    # -- homing ----------------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        with self._stopped_if_it_fails():
            self.homing.start(self.settings.homing, self.scaling)

    def home(self, timeout_s: float, *, attempts: int = 1) -> DriveSample:
        """Home and wait for it; a homing that fails is begun again, `attempts` times in all.

        Raises DriveFaultError after the last failure, MotionTimeoutError when an attempt does not end in time (the axis is stopped).
        """
        for attempt in range(1, max(1, attempts) + 1):
            self.start_homing()
            try:
                return self.wait_for(lambda sample: sample.homed is True or sample.state in FAULTS, timeout_s, "homed")
            except DriveFaultError:
                if attempt >= attempts:
                    raise
            except MotionTimeoutError:
                self.quick_stop()
                raise
        raise StateError(f"drive {self.name}: homing was given no attempt")
