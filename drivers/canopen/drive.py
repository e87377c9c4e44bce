"""CanOpenDrive: a CiA-402 servo drive behind the `ServoDrive` abstraction.

What may go in: what makes a CANopen node a ServoDrive - opening it safely, fresh samples, and who does what when it moves. Walking
the power states is `power`'s work, moves are `motion`'s, homing `homing`'s, SDO `sdo`'s, PDOs `pdo`'s, supervision `node`'s. One link
may carry several drives; whoever made the link closes it.

A sample is asked for: SYNC goes out and the synchronous TPDOs that answer it are waited for, so it is never older than the call.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from drivers.canopen import objects
from drivers.canopen.bus import CanLink
from drivers.canopen.cia402 import QUICK_STOP_ENDINGS, Command, Mode, Status, decode_state
from drivers.canopen.connection import Connection
from drivers.canopen.correction_table import CanOpenCorrectionTable
from drivers.canopen.eds import EdsFile
from drivers.canopen.homing import Homing
from drivers.canopen.identity import Identity, error_history, read_identity, stores_on_command
from drivers.canopen.motion import FAULTS, ProfileMotion
from drivers.canopen.named_parameters import NamedParameters
from drivers.canopen.node import SYNC, NmtCommand, NodeMonitor
from drivers.canopen.one_axis_stream import AxesInStep, OneAxisStream
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_lint import Finding
from drivers.canopen.power import PowerStage
from drivers.canopen.reported import readings
from drivers.canopen.sampling import Sampler, exists, sampled_pdos
from drivers.canopen.sdo import SdoClient
from drivers.canopen.settings import CanOpenSettings, HomingSettings
from drivers.canopen.table_map import TableMap
from drivers.canopen.touch_probe import CanOpenTouchProbe
from drivers.canopen.units import read_units
from drivers.clock import Clock
from drivers.drive import Capability, DriveLimits, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    LinkLostError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    StateError,
    TransportError,
)
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.set_points import SetPointSettings

__all__ = ["CanOpenDrive", "CanOpenSettings", "HomingSettings", "Identity"]


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
        dictionary = None if self.eds is None else self.eds.mappable_objects()
        self.connection = Connection(self.link, self.sdo, self.monitor, self.settings, dictionary)
        try:
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
            self.connection.set_up((*self.sampler.specs, self.rpdo))
            self.notes += self.connection.notes
            self.sampler.subscribe()
            self._open = True
            self.sample()
        except BaseException:
            with suppress(BridgeError):  # the error under way matters more
                self.connection.put_back()
            self._release()
            raise

    @property
    def pdo_findings(self) -> list[Finding]:
        """What the linter pointed out when the PDOs were set up."""
        self._require_open()
        return self.connection.pdo_findings

    def _note_ramps(self) -> None:
        """A quick stop that brakes less than a move does overshoots the move's target; said once, changed never."""
        self.notes = []
        quick = self.sdo.read_or(objects.QUICK_STOP_DECELERATION, 0)
        ordinary = self.scaling.motor_counts_per_s(self.limits.max_acceleration_mm_s2)
        if 0 < quick < ordinary:
            self.notes.append(
                f"drive {self.name}: quick stop (6085h) brakes with {quick * self.scaling.resolution_load_mm:g} mm/s²,"
                f" moves with up to {self.limits.max_acceleration_mm_s2:g} mm/s²: a stop may overshoot the target"
            )

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
            self.connection.set_up((*self.sampler.specs, self.rpdo))
            self.sampler.subscribe()

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
        if not self._open:
            return
        try:
            self._shut_down()
        except TransportError:
            pass  # the link is dead: there is nobody left to tell
        finally:
            self._release()

    def _shut_down(self) -> None:
        """Leave the axis disabled, and mode, speeds, ramps and communication as they were found."""
        self.link.poll()
        self.monitor.check()
        try:
            self.disable()
        except TransportError:
            raise
        except BridgeError:
            self.power.write(Command.QUICK_STOP.word)
            raise
        finally:
            self.monitor.expect_heartbeat(None)
        self.motion.put_back()
        self.sampler.unsubscribe()
        self.connection.put_back()

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
        values, scaling = self.sampler.values, self.scaling
        status = self.sampler.statusword
        state = decode_state(status)
        velocity = values.get(objects.VELOCITY_ACTUAL)
        torque = values.get(objects.TORQUE_ACTUAL)
        error = values.get(objects.FOLLOWING_ERROR_ACTUAL)
        if state in FAULTS:
            if self._fault_code is None:
                self._fault_code = self.power.error_code()
            self.homing.under_way = False
        else:
            self._fault_code = None
        self.homing.look(status)
        position_mm = scaling.load_mm(self.sampler.position_counts)
        velocity_mm_s = None if velocity is None else scaling.load_mm(velocity)
        if self.motion.mode is Mode.PROFILE_VELOCITY and state is DriveState.ENABLED:
            self._watch_travel(position_mm, velocity_mm_s)
        return DriveSample(
            self.sampler.heard_ns,
            state,
            position_mm,
            bool(status & Status.TARGET_REACHED) and not self.homing.under_way,
            velocity_mm_s,
            None if torque is None else scaling.direction * torque / 10.0,
            None if error is None else scaling.load_mm(error),
            self.homing.homed,
            self._fault_code,
        )

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

    def begin_streaming(self) -> None:
        """A stream takes over SYNC and the PDOs; it puts the PDOs back before `end_streaming`."""
        self._require_open()
        if self.is_streaming:
            raise StateError(f"drive {self.name} is streaming already")
        self.sampler.by_sdo = True
        self.sampler.unsubscribe()

    def end_streaming(self) -> None:
        """The PDOs are those of `open` again."""
        self.sampler.by_sdo = False
        self.sampler.subscribe()

    # -- states ----------------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self.set_mode(Mode.PROFILE_POSITION)
        if self.power.state() is DriveState.QUICK_STOP and self._quick_stop_holds():
            self._await_standstill()
            self.power.resume_from_quick_stop(self.motion.stay)
            return
        self.power.enable(self.motion.stay)

    def _quick_stop_holds(self) -> bool:
        ending = QUICK_STOP_ENDINGS.get(self.sdo.read_or(objects.QUICK_STOP_OPTION, 2))
        return ending is not None and ending.stays

    def _await_standstill(self) -> None:
        self.wait_for(
            lambda sample: sample.target_reached or sample.state not in (DriveState.ENABLED, DriveState.QUICK_STOP),
            self.settings.power.stop_s,
            "standstill",
        )

    def disable(self) -> None:
        """Halt, then walk down to switch on disabled. Raises MotionTimeoutError when it does not come to rest."""
        self._require_open()
        state = self.sample().state
        if state is DriveState.ENABLED:
            self.motion.halt()
            self._await_standstill()
        elif state is DriveState.QUICK_STOP:
            self._await_standstill()
        self.homing.under_way = False
        if self.motion.mode is Mode.PROFILE_VELOCITY:
            self.motion.stay()  # a speed that is left in the drive would come to life with the next enabling
        self.power.disable()

    def quick_stop(self) -> None:
        """Quick stop command; what follows the ramp is up to the drive's 605Ah. When SDO fails the RPDO is tried as well."""
        self._require_open()
        self.homing.under_way = False
        try:
            self.power.write(Command.QUICK_STOP.word)
        except (TransportError, ProtocolError, AbortError):
            with suppress(LinkLostError):
                target = self.sampler.values.get(objects.POSITION_ACTUAL, 0)
                self.link.send(self.rpdo.cob_id, self.rpdo.codec.pack(Command.QUICK_STOP.word, target))
                self.link.send(SYNC, b"")
            raise

    def reset_fault(self) -> None:
        """Rising edge of the reset bit; the axis stays disabled. Raises DriveFaultError when the fault's cause is still there."""
        self._require_open()
        self.power.reset_fault()

    # -- modes and profile moves -------------------------------------------------------------------------------------------
    def set_mode(self, mode: Mode) -> None:
        """Change the mode of operation; see `ProfileMotion.set_mode`."""
        self._require_open()
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
