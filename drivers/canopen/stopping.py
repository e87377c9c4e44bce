"""StoppableDrive: the part of a CANopen drive that a stream needs: sampling, stopping, coming to rest, taking the power off.

A sample is requested: SYNC is sent and the synchronous TPDOs that answer it are waited for, so it is never older than the call.
While another producer owns SYNC (`sync.Sync`) the values are read by SDO.

A stop is sent over every channel, the fastest first, before anything is read: `send_stop`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial

from drivers.canopen import objects
from drivers.canopen.bus import STOP_SEND_S, CanLink
from drivers.canopen.cia402 import QUICK_STOP_ENDINGS, Command, Control, Mode, Status, decode_state
from drivers.canopen.connection import Connection
from drivers.canopen.eds import EdsFile
from drivers.canopen.homing import Homing
from drivers.canopen.motion import LOOK_S, RUN, ProfileMotion
from drivers.canopen.node import Node, NodeMonitor
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.power import PowerStage
from drivers.canopen.sampling import Sampler
from drivers.canopen.sdo import WAY_OUT_S, SdoClient
from drivers.canopen.settings import CanOpenSettings
from drivers.canopen.stream_axis import Axis
from drivers.canopen.sync import SYNC
from drivers.canopen.table_map import TableMap
from drivers.clock import Clock
from drivers.drive import FAULTS, WITHOUT_POWER, DriveLimits, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    BridgeError,
    CapabilityError,
    DriveFaultError,
    HeldUnderPowerError,
    InputError,
    LimitError,
    LinkLostError,
    MotionTimeoutError,
    StateError,
    TransportError,
)
from drivers.scaling import AxisScaling, MotionScaling
from drivers.shared_time import SharedTime
from drivers.standstill import Standstill

WITHOUT_TORQUE = (*WITHOUT_POWER, DriveState.SWITCHED_ON)
"""States in which a drive does not move its axis."""
HALT_TAKEN_S = 1.0
"""Time from a halt to the beginning of its ramp, and of the vibration of the load after it, s."""
STOP_SHOWN_S = 0.1
"""Time a drive may take to leave operation enabled after it confirmed the quick stop command, s: ten slow control cycles."""


class StoppableDrive(ServoDrive):
    """One node under power. `open` of the derived class creates the parts, with nothing enabled or moved.

    Raises from its methods, besides what ServoDrive names: NoAnswerError and LinkLostError (wire, heartbeat, restart of the node),
    AbortError (a refused access, naming object and reason), ProtocolError.
    """

    sdo: SdoClient
    monitor: NodeMonitor
    power: PowerStage
    sampler: Sampler
    connection: Connection
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
        self._open = False
        self._fault_code: int | None = None
        self._stream_axis: Axis | None = None
        self._braking_s = self.settings.power.stop_s
        self._stop_lets_go = True
        self._braking_awaited = False  # it had the time that braking needs, and did not answer since
        self.rpdo = PdoSpec(1, False, 0x200 + node_id, SYNC_EVERY, (objects.CONTROLWORD, objects.TARGET_POSITION))

    def _require_open(self) -> None:
        if not self._open:
            raise StateError(f"drive {self.name} is not open")

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
        if self.homing.without_bit_10 and self.motion.mode is Mode.HOMING:
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
        with self._stopped_if_it_fails():
            self.motion.set_mode(mode, until_enabled=until_enabled)
        self.homing.under_way = False

    # -- coming to rest and taking the power off -------------------------------------------------------------------------
    def disable(self) -> None:
        """Halt, and take the power off once the axis is at rest. Where the halt is not confirmed or no standstill is shown in its
        time: quick stop first, and the power is taken off all the same, unless the axis falls without it.

        Works without the node's heartbeat, and over SDO or PDO alone. Raises HeldUnderPowerError for an axis that falls and is held,
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
            self.motion.stay()  # a velocity left in the drive would move the axis at the next enabling
        if not at_rest:
            raise MotionTimeoutError(
                f"drive {self.name}: no standstill within {self.settings.power.stop_s:g} s; quick-stopped and disabled all the same"
            )

    def _brought_to_rest(self) -> bool:
        """Halt, else quick stop; False when no standstill was shown."""
        halted = False
        try:
            if not self.sampler.heard_by_sync():
                if self.sampler.by_own_sync:
                    self.send_stop()  # the drive should have answered: stop before anything is read
                self.sampler.refresh_somehow()
            state = decode_state(self.sampler.statusword)
            if state in WITHOUT_TORQUE:
                return True
            if state is DriveState.ENABLED:
                if not self.power.stopped:
                    self._send(RUN | Control.HALT, by_sdo=False)  # without SDO, whose answer would be waited for
                self.motion.halt()
                halted = True
            if self._comes_to_rest(self._halting_s if halted else self.settings.power.stop_s):
                return True
        except BridgeError:  # the halt is not confirmed
            pass
        if not (
            halted and self.falls_without_power and self._stop_lets_go
        ):  # then the halt holds it, a quick stop would not
            self.send_stop()
        try:
            return self._comes_to_rest(self.settings.power.stop_s)
        except BridgeError as error:  # no answer: it gets the time that braking needs, before its power is taken
            reached = self.link.takes_frames or not isinstance(error, LinkLostError)
            if reached and not self._braking_awaited:
                self.clock.sleep_s(self._braking_s)
                self._braking_awaited = True
            return False

    @property
    def _halting_s(self) -> float:
        """Longest time of a halt from the axis's highest velocity with a ramp three times flatter than the axis's, s. An axis that
        moves for longer does not obey, as where another master moves it: it is quick-stopped."""
        limits = self.limits
        return min(
            HALT_TAKEN_S + 3.0 * limits.max_velocity_mm_s / limits.max_acceleration_mm_s2, self.settings.power.stop_s
        )

    def _comes_to_rest(self, timeout_s: float) -> bool:
        """Sample until it is at rest, or has no torque; False when neither was shown in time. Raises TransportError without an
        answer."""
        standstill = Standstill(self.scaling.resolution_load_mm)
        sampler, deadline = self.sampler, self.clock.deadline(timeout_s)
        while True:
            sampler.refresh_somehow()
            self._braking_awaited = False
            status = sampler.statusword
            with suppress(BridgeError):  # an error of an observer does not prevent the stop
                self.looked_at(self._as_sample())
            velocity = sampler.values.get(objects.VELOCITY_ACTUAL)
            stands = standstill.look(
                sampler.heard_ns,
                self.scaling.load_mm(sampler.position_counts),
                None if velocity is None else self.units.load_mm_s(velocity),
                reached=bool(status & Status.TARGET_REACHED) if self.motion.arrived() is None else None,
            )
            if stands or decode_state(status) in WITHOUT_TORQUE:
                return True
            if deadline.expired:
                return False
            self.clock.sleep_s(LOOK_S)

    def _take_power(self) -> None:
        """Take the power over SDO, every step confirmed; else by RPDO, confirmed by TPDO. Raises SDO's error when it is not
        confirmed."""
        try:
            self.power.disable()
        except (TransportError, MotionTimeoutError):
            self._send(Command.DISABLE_VOLTAGE.word)
            if not self.sampler.heard_by_sync() or decode_state(self.sampler.statusword) not in WITHOUT_TORQUE:
                raise

    # -- stopping --------------------------------------------------------------------------------------------------------
    @property
    def way_out_s(self) -> float:
        return WAY_OUT_S

    def share_way_out(self, time: SharedTime) -> None:
        """Its time runs from now on, beside that of the other axes; a drive that answers is not limited."""
        del time
        if self._open:
            self.sdo.way_out.begin()

    def send_stop(self) -> None:
        """Send it by event-driven RPDO, or the synchronous one with SYNC, and by SDO. No command enables the axis until `enable`."""
        if not self._open:
            return
        self.power.stopped = True
        self._send(Command.QUICK_STOP.word)
        self.sdo.way_out.begin()

    def quick_stop(self) -> None:
        """Quick stop command; 605Ah decides what follows the ramp.

        Raises NoAnswerError, LinkLostError when it is not confirmed, AbortError when it is refused by SDO and not shown,
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
        """Whether a TPDO shows the stop; False where none comes."""
        axis = self._stream_axis
        if axis is None:
            return self.sampler.heard_by_sync() and decode_state(self.sampler.statusword) is not DriveState.ENABLED
        axis.fresh = False
        self.link.send(SYNC, b"")
        heard = self.link.wait(lambda: axis.fresh, self.settings.sample_timeout_s)
        return heard and decode_state(axis.status) is not DriveState.ENABLED

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
        self.notes = []
        self._stop_lets_go = not self._quick_stop_holds()
        if self.falls_without_power and self._stop_lets_go:
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
        # and delays of drive and bus, generously: ten samples
        self._braking_s = min(self.limits.max_velocity_mm_s / braking_mm_s2 + 10 * LOOK_S, self.settings.power.stop_s)

    @contextmanager
    def _stopped_if_it_fails(self) -> Iterator[None]:
        """Around orders that start or change a motion: no error is raised while the axis moves.

        An order that is not confirmed: the axis is quick-stopped and its power taken off, see `disable`. A refusal before anything
        was ordered leaves the axis as it is; in a fault the drive stops by itself. On an interrupt a stop is sent, and the caller
        handles the rest.
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
        """Quick stop, then `disable`. A quick stop that would let an axis fall is left to `disable`, which halts it first."""
        if not (self.falls_without_power and self._stop_lets_go):
            self.send_stop()
        try:
            self.disable()
        except HeldUnderPowerError as held:
            raise HeldUnderPowerError(f"{held}; {error}") from error
        except BridgeError as worse:
            error.add_note(str(worse))
