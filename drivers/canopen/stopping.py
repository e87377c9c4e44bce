"""StoppableNode: the part of a CANopen drive that a stream needs: its samples, how a stop leaves, how its power is taken off.

A sample is requested: SYNC is sent and the synchronous TPDOs that answer it are waited for, so it is never older than the call.
While another producer owns SYNC (`sync.Sync`) the values are read by SDO.

A stop is sent over every channel, the fastest first, before anything is read: `send_stop`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial

from drivers.canopen.bus import STOP_SEND_S, CanLink
from drivers.canopen.connection import Connection
from drivers.canopen.eds import EdsFile
from drivers.canopen.homing import Homing
from drivers.canopen.kept_settings import KeptSettings
from drivers.canopen.modes import OperationModes
from drivers.canopen.motion import RUN, ProfileMotion
from drivers.canopen.node import Node, NodeMonitor
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.power import PowerStage
from drivers.canopen.sampling import Sampler
from drivers.canopen.sdo import SdoClient
from drivers.canopen.settings import CanOpenSettings
from drivers.canopen.stream_axis import Axis
from drivers.canopen.sync import SYNC
from drivers.canopen.table_map import TableMap
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.cia402.state_machine import QUICK_STOP_ENDINGS, Command, Control, Status, decode_state
from drivers.clock import Clock
from drivers.drive import FAULTS, DriveLimits, DriveSample, DriveState
from drivers.errors import BridgeError, StateError
from drivers.scaling import AxisScaling, MotionScaling
from drivers.shutdown import StoppableDrive
from drivers.standstill import Standstill


class StoppableNode(StoppableDrive):
    """One node under power. `open` of the derived class creates the parts, with nothing enabled or moved.

    Raises from its methods, besides what ServoDrive names: NoAnswerError and LinkLostError (wire, heartbeat, restart of the node),
    AbortError (a refused access, naming object and reason), ProtocolError.
    """

    sdo: SdoClient
    monitor: NodeMonitor
    power: PowerStage
    sampler: Sampler
    connection: Connection
    kept: KeptSettings
    modes: OperationModes
    motion: ProfileMotion
    homing: Homing
    units: MotionScaling
    """Of its velocities and accelerations on the wire; known once open."""

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
        self.node = Node(name, link, node_id, eds, table)
        self.link = link
        self.node_id = node_id
        self.settings = settings or CanOpenSettings()
        self.notes: list[str] = []  # findings of open for an engineer
        self._fault_code: int | None = None
        self._stream_axis: Axis | None = None
        self.stop_lets_go = True
        self.rpdo = PdoSpec(1, False, 0x200 + node_id, SYNC_EVERY, (objects.CONTROLWORD, objects.TARGET_POSITION))

    # -- reading ---------------------------------------------------------------------------------------------------------
    def sample(self) -> DriveSample:
        """A fresh sample by SYNC. following_error_mm is demand − actual, as in 60F4h, mm.

        Raises NoAnswerError when the node does not answer SYNC (twice), LinkLostError when its heartbeat stopped or it restarted,
        DriveFaultError once when a homing that was started failed, ProtocolError once when it ended elsewhere than announced,
        LimitError (with a halt) when the drive limits the target of the move in progress.
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
        slow = velocity is None or Standstill.is_slow(self.units.load_mm_s(velocity))
        homing = self.homing.under_way
        self.homing.look(self.sampler.heard_ns, status, self.sampler.position_counts, slow=slow)
        if homing and self.homing.homed:
            self.homing.homed = False
            self.check_home(self.scaling.load_mm(self.sampler.position_counts))
            self.homing.homed = True
        self.motion.look(status)
        return self._as_sample()

    def _as_sample(self) -> DriveSample:
        """The values received last."""
        values, scaling, status = self.sampler.values, self.scaling, self.sampler.statusword
        velocity = values.get(objects.VELOCITY_ACTUAL)
        torque = values.get(objects.TORQUE_ACTUAL)
        error = values.get(objects.FOLLOWING_ERROR_ACTUAL)
        arrived = self.motion.arrived()
        reached = bool(status & Status.TARGET_REACHED) if arrived is None else arrived
        if self.homing.without_bit_10 and self.modes.mode is Mode.HOMING:
            reached = velocity is None or Standstill.is_slow(self.units.load_mm_s(velocity))
        return DriveSample(
            self.sampler.heard_ns,
            decode_state(status),
            scaling.load_mm(self.sampler.position_counts),
            reached and not self.homing.under_way and decode_state(status) is DriveState.ENABLED,
            None if velocity is None else self.units.load_mm_s(velocity),
            None if torque is None else scaling.direction * torque / 10.0,
            None if error is None else scaling.load_mm(error),
            self.homing.homed,
            self._fault_code,
            limited=bool(status & Status.INTERNAL_LIMIT),
            since_ns=self.sampler.asked_ns,
        )

    # -- streaming -------------------------------------------------------------------------------------------------------
    @property
    def is_streaming(self) -> bool:
        """Whether a `stream.CyclicStream` paces this drive; its samples are read by SDO meanwhile, as SYNC belongs to the stream."""
        return self.sampler.tpdos_in_stream

    def begin_streaming(self, axis: Axis) -> None:
        """A stream takes SYNC and the PDOs; it restores the PDOs before `end_streaming`. Raises StateError while another one does."""
        self._require_open()
        if self.is_streaming:
            raise StateError(f"drive {self.name} is streaming already")
        self.sampler.tpdos_in_stream = True
        self.sampler.unsubscribe()
        self._stream_axis = axis

    def end_streaming(self) -> None:
        """To be called when the PDOs are those of `open` again."""
        self._stream_axis = None
        self.sampler.tpdos_in_stream = False
        self.sampler.subscribe()

    def set_mode(self, mode: Mode, *, until_enabled: bool = False) -> None:
        """Change the mode of operation; see `ProfileMotion.set_mode`, also for the errors."""
        self._require_open()
        with self._no_motion_after_errors():
            self.motion.set_mode(mode, until_enabled=until_enabled)
        self.homing.under_way = False

    # -- how it is stopped and disabled ------------------------------------------------------------------------------------
    @property
    def stopped(self) -> bool:
        return self.power.stopped

    def send_stop(self) -> None:
        """Send it by event-driven RPDO, or the synchronous one with SYNC, and by SDO. No command enables the axis until `enable`."""
        if self._open:
            self.power.stopped = True
            self._send(Command.QUICK_STOP.word)

    def _glance(self) -> DriveSample | None:
        axis = self._stream_axis
        if axis is not None:
            axis.fresh = False
            self.link.send(SYNC, b"")
            if not self.link.wait(lambda: axis.fresh, self.settings.sample_timeout_s):
                return None
            place_mm = self.scaling.load_mm(axis.position_counts)
            return DriveSample(axis.heard_ns, decode_state(axis.status), place_mm, target_reached=False)
        if not self.sampler.by_own_sync:
            return self._look()
        return self._as_sample() if self.sampler.heard_by_sync() else None

    def _look(self) -> DriveSample:
        self.sampler.refresh_somehow()
        return self._as_sample()

    def _halt(self) -> None:
        self._send(RUN | Control.HALT, by_sdo=False)  # without SDO, whose answer would be waited for
        self.motion.halt()

    def _repeat_stop(self) -> None:
        self.power.write(Command.QUICK_STOP.word)

    def _why_enabled(self) -> str:
        return self.power.why(DriveState.ENABLED, self.power.statusword())

    def _power_off(self) -> None:
        self.power.disable()

    def _send_power_off(self, shown: DriveState) -> None:
        del shown  # it is one command in every state
        self._send(Command.DISABLE_VOLTAGE.word)

    def _stop_arrives(self, error: BridgeError) -> bool:
        return self.link.takes_frames or super()._stop_arrives(error)

    def _send(self, word: int, *, by_sdo: bool = True) -> None:
        """Send a controlword that stops the axis or takes its power over every channel; a failure does not prevent the others.

        Never waits and takes no lock of this program: for any thread, and a signal handler.
        """
        ways = self._ways(word)
        for way in ways if by_sdo else ways[:-1]:
            with suppress(Exception):
                way()

    def _ways(self, word: int) -> list[Callable[[], None]]:
        """The channels, the fastest first. Where the set-points of a stream carry a controlword they carry the command too: one that
        waits in the drive for the next SYNC would enable the axis. SYNC is sent only where it is ours, or where no other producer is
        heard. SDO is the last."""
        stop, axis = self.connection.stop_rpdo, self._stream_axis
        by_set_point = None if axis is None else axis.command(word)
        ways: list[Callable[[], None]] = []
        if stop is not None:
            ways.append(partial(self.link.send, stop.cob_id, stop.codec.pack(word), STOP_SEND_S))
        if by_set_point is not None:
            ways.append(partial(self.link.send_message, by_set_point, STOP_SEND_S))
        elif axis is None and stop is None and self.connection.mapped and self.connection.rpdo is not None:
            place = self.sampler.values.get(objects.POSITION_ACTUAL, 0)
            ways.append(partial(self.link.send, self.rpdo.cob_id, self.rpdo.codec.pack(word, place), STOP_SEND_S))
        if stop is None and ways and not self.link.sync.foreign_runs:
            ways.append(partial(self.link.send, SYNC, b"", STOP_SEND_S))
        ways.append(partial(self.sdo.send_at_once, objects.CONTROLWORD, word))
        return ways

    def _quick_stop_holds(self) -> bool:
        ending = QUICK_STOP_ENDINGS.get(self.sdo.read_if_shown(objects.QUICK_STOP_OPTION, 2))
        return ending is not None and ending.stays

    def _note_ramps(self) -> None:
        """Note, once, properties of the quick stop that an engineer should know; nothing is written.

        A ramp flatter than that of a move overshoots the move's target; one that ends without power lets an axis fall that gravity
        can move.
        """
        self.stop_lets_go = not self._quick_stop_holds()
        if self.falls_without_power and self.stop_lets_go:
            self.notes.append(
                f"drive {self.name}: gravity can move this axis and no brake is stated, but after a quick stop (605Ah) its drive"
                " switches its power off"
            )
        quick = self.sdo.read_if_shown(objects.QUICK_STOP_DECELERATION, 0)
        quick_mm_s2 = self.units.mm_s2(quick)
        if 0 < quick_mm_s2 < self.limits.max_acceleration_mm_s2 * (1 - 1e-6):
            self.notes.append(
                f"drive {self.name}: quick stop (6085h) brakes with {quick_mm_s2:g} mm/s²,"
                f" moves with up to {self.limits.max_acceleration_mm_s2:g} mm/s²: a stop may overshoot the target"
            )
        braking_mm_s2 = quick_mm_s2 or self.limits.max_acceleration_mm_s2
        self.way_out.braking_s = min(self.limits.max_velocity_mm_s / braking_mm_s2, self.settings.power.stop_s)
