"""Streaming set-points to several drives, paced by SYNC: cyclic synchronous position, velocity or torque.

What may go in: the cycle. Set-points go out right away, take effect at the next SYNC (synchronous RPDOs), and the feedback that this
SYNC asked for comes back before the call returns. What goes wrong is counted, and acted on: once a limit is passed all axes are
quick-stopped and an error names what happened. SYNC comes from this process or from the kernel's broadcast manager (SocketCAN),
which keeps its time when Python does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from types import TracebackType
from typing import Any, NamedTuple, Self

import can

from drivers.canopen import objects
from drivers.canopen.bus import CanLink
from drivers.canopen.cia402 import Command, Mode, Status, decode_state
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.node import SYNC
from drivers.canopen.objects import Entry
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_lint import Cycle, lint, refuse_errors
from drivers.canopen.pdo_setup import PdoSetup
from drivers.clock import NS_PER_S
from drivers.drive import DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    FollowingErrorError,
    InputError,
    LimitError,
    LinkLostError,
    NoAnswerError,
    SafetyError,
    StateError,
)


class SyncSource(Enum):
    """Who sends SYNC."""

    HOST = "this process, when a cycle is due"
    BROADCAST_MANAGER = "the bus itself: the kernel's broadcast manager on SocketCAN"


@dataclass(frozen=True)
class StreamSettings:
    """period_s: the SYNC cycle. bitrate: for the prediction whether the cycle fits, bit/s; None skips it.

    The limits are cycles in a row: after that many the stream is stopped. following_error_mm: largest allowed difference between
    the set-point that was in force and the position that came back (position streams). torque_limit_percent bounds torque streams.
    """

    period_s: float
    mode: Mode = Mode.CYCLIC_POSITION
    bitrate: int | None = 1_000_000
    budget: float = 0.7
    sync: SyncSource = SyncSource.HOST
    missed_limit: int = 3
    late_limit: int = 3
    feedback_share: float = 0.8  # of the period, within which feedback must have come
    following_error_mm: float = 1.0
    torque_limit_percent: float = 100.0


@dataclass
class StreamCounters:
    """What happened since the start. jitter is how late the host was with SYNC at most."""

    cycles: int = 0
    missed_cycles: int = 0  # SYNCs that went by without new set-points
    late_feedback: int = 0
    sync_losses: int = 0
    worst_late_ns: int = 0


class Feedback(NamedTuple):
    """What an axis showed at a SYNC. late: this is an older value, the one of this cycle did not come in time."""

    time_ns: int
    status: int
    position_load_mm: float
    late: bool

    @property
    def state(self) -> DriveState:
        return decode_state(self.status)


_TARGETS: dict[Mode, Entry] = {
    Mode.CYCLIC_POSITION: objects.TARGET_POSITION,
    Mode.CYCLIC_VELOCITY: objects.TARGET_VELOCITY,
    Mode.CYCLIC_TORQUE: objects.TARGET_TORQUE,
}


_RUN = Command.ENABLE_OPERATION.word
_RUNNING = 0x0027 | int(Status.FOLLOWS_COMMAND)  # operation enabled, and the set-points are followed
_RUNNING_MASK = 0x006F | int(Status.FOLLOWS_COMMAND)


class _Axis:
    """One drive in the stream: its frames, its latest feedback, its limits in counts. Everything that a cycle needs is at hand."""

    def __init__(self, drive: CanOpenDrive, settings: StreamSettings) -> None:
        node_id, scaling, limits = drive.node_id, drive.scaling, drive.limits
        self.drive = drive
        self.rpdo = PdoSpec(1, False, 0x200 + node_id, SYNC_EVERY, (objects.CONTROLWORD, _TARGETS[settings.mode]))
        self.tpdo = PdoSpec(1, True, 0x180 + node_id, SYNC_EVERY, (objects.STATUSWORD, objects.POSITION_ACTUAL))
        self.setup = PdoSetup(drive.sdo, node_id, (self.rpdo, self.tpdo), alone=True)
        self.pack_into = self.rpdo.codec.pack_into
        self.unpack = self.tpdo.codec.unpack_from
        self.message = can.Message(
            arbitration_id=self.rpdo.cob_id, data=bytes(self.rpdo.codec.size), is_extended_id=False
        )
        self.status = 0
        self.position_counts = 0
        self.heard_ns = 0
        self.fresh = False
        self.awaited: set[_Axis] = set()  # the stream's: who has not answered the last SYNC
        self.late_in_a_row = 0
        self.demand_counts = 0  # in force at the last SYNC
        self.next_counts = 0  # sent for the next one
        self.sync_period_before: int | None = None
        self.taken = False  # the drive is ours for now
        self.mm_per_count = scaling.direction * scaling.resolution_load_mm
        self.counts_per_mm = scaling.direction * scaling.counts_per_load_mm
        # one count of rounding at either end is not a matter of speed
        self.max_step_counts = limits.max_velocity_mm_s * settings.period_s * scaling.counts_per_load_mm + 1
        self.travel_min_mm, self.travel_max_mm = limits.travel_min_mm, limits.travel_max_mm
        self.max_error_counts = settings.following_error_mm * scaling.counts_per_load_mm

    def receive(self, time_ns: int, data: bytes) -> None:
        """The TPDO of this axis."""
        if len(data) >= 6:
            self.status, self.position_counts = self.unpack(data)
            self.heard_ns = time_ns
            self.fresh = True
            self.awaited.discard(self)

    def send(self, link: CanLink, controlword: int, counts: int) -> None:
        """The RPDO of this axis."""
        self.next_counts = counts
        self.pack_into(self.message.data, 0, controlword, counts)
        link.send_message(self.message)

    def feedback(self) -> Feedback:
        return Feedback(self.heard_ns, self.status, self.position_counts * self.mm_per_count, not self.fresh)


class CyclicStream:
    """Use as a context manager around enabled drives on one link; call `cycle` once per period with a value for each drive.

    On leaving, the axes are held where they are, put back into profile position and stay enabled; after an error they are
    quick-stopped.
    """

    def __init__(self, drives: Sequence[CanOpenDrive], settings: StreamSettings) -> None:
        if not drives or len({id(drive.link) for drive in drives}) != 1:
            raise InputError("a stream needs drives, all on one link")
        if settings.mode not in _TARGETS:
            raise InputError(f"mode {settings.mode.name} is not a cyclic synchronous one")
        if not settings.period_s > 0:
            raise InputError(f"stream period is {settings.period_s} s, expected > 0")
        self.settings = settings
        self.counters = StreamCounters()
        self.link = drives[0].link
        self.clock = self.link.clock
        self._axes = [_Axis(drive, settings) for drive in drives]
        self._awaited: set[_Axis] = set()
        for axis in self._axes:
            axis.awaited = self._awaited
        self._by_host = settings.sync is SyncSource.HOST
        self._by_position = settings.mode is Mode.CYCLIC_POSITION
        self._sync_message = can.Message(arbitration_id=SYNC, data=b"", is_extended_id=False)
        self._period_ns = round(settings.period_s * NS_PER_S)
        self._feedback_s = settings.period_s * settings.feedback_share
        self._next_sync_ns = 0
        self._missed_in_a_row = 0
        self._sync_count = 0
        self._sync_taken = 0
        self._sync_task: Any = None
        self._running = False

    # -- coming and going ------------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self._check_fit()
        try:
            for axis in self._axes:
                self._prepare(axis)
            self._start()
        except BaseException:
            self._end(stopped=True)
            raise
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if exc_type is not None and self._running:
            self._quick_stop_all()
        self._end(stopped=exc_type is not None)

    def _check_fit(self) -> None:
        if self.settings.bitrate is None:
            return
        cycle = Cycle(self.settings.period_s * 1e6, self.settings.bitrate, self.settings.budget)
        refuse_errors(lint({axis.drive.node_id: (axis.rpdo, axis.tpdo) for axis in self._axes}, cycle=cycle))

    def _prepare(self, axis: _Axis) -> None:
        """Axis enabled and held, PDOs for the stream, then the mode; target := actual before the mode takes hold."""
        drive = axis.drive
        sample = drive.sample()
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {drive.name} cannot stream: it is {sample.state.value}")
        if not drive.motion.supports(self.settings.mode):
            raise CapabilityError(f"drive {drive.name} has no {self.settings.mode.name.lower().replace('_', ' ')} mode")
        value, exponent = _interpolation(self.settings.period_s)
        with suppress(AbortError):  # 60C2h is optional, and fixed in some drives
            drive.sdo.write(objects.INTERPOLATION_PERIOD, value)
            drive.sdo.write(objects.INTERPOLATION_EXPONENT, exponent)
        drive.begin_streaming()
        axis.taken = True
        axis.setup.apply()
        drive.set_mode(self.settings.mode)
        axis.position_counts = drive.sdo.read(objects.POSITION_ACTUAL)
        if self.settings.mode is Mode.CYCLIC_POSITION:
            axis.demand_counts = axis.next_counts = axis.position_counts
        axis.status = drive.sdo.read(objects.STATUSWORD)
        axis.heard_ns = self.clock.now_ns()
        self.link.subscribe(axis.tpdo.cob_id, axis.receive)

    def _start(self) -> None:
        for axis in self._axes:
            with suppress(
                AbortError
            ):  # 1006h, where there is one, lets the drive notice by itself that SYNC has stopped
                sdo = axis.drive.sdo
                before = sdo.read(objects.SYNC_PERIOD)
                sdo.write(objects.SYNC_PERIOD, round(self.settings.period_s * 1e6))
                axis.sync_period_before = before
        self._running = True
        self._next_sync_ns = self.clock.now_ns() + self._period_ns
        if self.settings.sync is SyncSource.BROADCAST_MANAGER:
            self.link.subscribe(SYNC, self._on_sync)
            message = can.Message(arbitration_id=SYNC, is_extended_id=False, data=b"")
            self._sync_task = self.link.bus.send_periodic(message, self.settings.period_s)

    def _end(self, *, stopped: bool) -> None:
        """Let the drives stop watching SYNC, then stop SYNC, then put everything else back."""
        self._running = False
        steps = [self._unwatch_sync, self._give_back]
        for step in steps:
            for axis in self._axes:
                if not axis.taken:
                    continue
                try:
                    step(axis, stopped)
                except BridgeError:
                    if not stopped:
                        raise
            if self._sync_task is not None:
                self._sync_task.stop()
                self._sync_task = None
                self.link.unsubscribe(SYNC, self._on_sync)

    @staticmethod
    def _unwatch_sync(axis: _Axis, _stopped: bool) -> None:
        if axis.sync_period_before is not None:
            axis.drive.sdo.write(objects.SYNC_PERIOD, axis.sync_period_before)

    def _give_back(self, axis: _Axis, stopped: bool) -> None:
        self.link.unsubscribe(axis.tpdo.cob_id, axis.receive)
        axis.taken = False
        try:
            axis.setup.restore()
        finally:
            axis.drive.end_streaming()
        if not stopped:
            axis.drive.set_mode(Mode.PROFILE_POSITION)

    # -- the cycle -------------------------------------------------------------------------------------------------------
    def cycle(self, values: Sequence[float]) -> list[Feedback]:
        """Send one value per drive (load mm, mm/s or percent of rated torque), wait for the SYNC that takes them, and for feedback.

        Raises LimitError before anything is sent; SafetyError (cycles missed), NoAnswerError (feedback missing), LinkLostError
        (no SYNC, heartbeat), DriveFaultError, FollowingErrorError, StateError - each with all axes quick-stopped.
        """
        if not self._running:
            raise StateError("the stream is not running")
        if len(values) != len(self._axes):
            raise InputError(f"{len(values)} values for {len(self._axes)} drives")
        try:
            checked = self._checked_position if self._by_position else self._checked_other
            counts = [checked(axis, value) for axis, value in zip(self._axes, values, strict=True)]
            if self._by_host:
                self._send_with_host_sync(counts)
            else:
                self._send_with_foreign_sync(counts)
            self.counters.cycles += 1
            if self._awaited and not self.link.wait(self._all_answered, self._feedback_s):
                self._account_for_late()
            feedback = []
            for axis in self._axes:
                if axis.fresh:
                    axis.late_in_a_row = 0
                    self._judge(axis)
                feedback.append(axis.feedback())
            return feedback
        except BaseException:
            self._quick_stop_all()
            self._running = False
            raise

    def _checked_position(self, axis: _Axis, value: float) -> int:
        """Load mm -> counts. Raises LimitError for a place outside the travel, or too far from the last one."""
        if not axis.travel_min_mm <= value <= axis.travel_max_mm:
            axis.drive.limits.check_target(value)
        counts = round(value * axis.counts_per_mm)
        if not -axis.max_step_counts <= counts - axis.next_counts <= axis.max_step_counts:
            step_mm = abs(counts - axis.next_counts) * abs(axis.mm_per_count)
            raise LimitError(
                f"drive {axis.drive.name}: step of {step_mm:.6f} mm in one cycle is"
                f" {step_mm / self.settings.period_s:g} mm/s, allowed are {axis.drive.limits.max_velocity_mm_s:g} mm/s"
            )
        return counts

    def _checked_other(self, axis: _Axis, value: float) -> int:
        """Velocity in load mm/s, or torque in percent -> the drive's units. Raises LimitError."""
        limits = axis.drive.limits
        if not math.isfinite(value):
            raise LimitError(f"drive {axis.drive.name}: {value} is no set-point")
        self._check_inside(axis, value)
        if self.settings.mode is Mode.CYCLIC_VELOCITY:
            if abs(value) > limits.max_velocity_mm_s:
                limits.check_velocity(abs(value))
            return round(value * axis.counts_per_mm)
        if abs(value) > self.settings.torque_limit_percent:
            raise LimitError(
                f"drive {axis.drive.name}: torque {value:g} %, allowed are ±{self.settings.torque_limit_percent:g} %"
            )
        return axis.drive.scaling.direction * round(10 * value)

    @staticmethod
    def _check_inside(axis: _Axis, value: float) -> None:
        """Velocity and torque streams must not push an axis further out of its travel."""
        limits, place_mm = axis.drive.limits, axis.position_counts * axis.mm_per_count
        if (place_mm >= limits.travel_max_mm and value > 0) or (place_mm <= limits.travel_min_mm and value < 0):
            raise LimitError(f"drive {axis.drive.name}: at {place_mm:.3f} mm, the end of its travel")

    def _send_with_host_sync(self, counts: list[int]) -> None:
        """Set-points out at once, SYNC when it is due."""
        now_ns = self.clock.now_ns()
        if not self.counters.cycles:
            self._next_sync_ns = now_ns + self._period_ns  # time runs from the first set-point on
        late_ns = now_ns - self._next_sync_ns
        if late_ns > 0:
            self.counters.worst_late_ns = max(self.counters.worst_late_ns, late_ns)
            missed = late_ns // self._period_ns
            self._next_sync_ns += missed * self._period_ns
            self._account_for_missed(missed)
        else:
            self._missed_in_a_row = 0
        for axis, count in zip(self._axes, counts, strict=True):
            axis.send(self.link, _RUN, count)
        self.clock.sleep_until_ns(self._next_sync_ns)
        self.link.poll()  # what came late belongs to the cycle before
        self._begin_cycle()
        self.link.send_message(self._sync_message)
        self._next_sync_ns += self._period_ns

    def _send_with_foreign_sync(self, counts: list[int]) -> None:
        """Set-points out at once, then wait for the SYNC that takes them."""
        self.link.poll()
        if not self.counters.cycles:
            self._sync_taken = self._sync_count
        missed = self._sync_count - self._sync_taken
        self._sync_taken = self._sync_count
        self._account_for_missed(missed)
        for axis, count in zip(self._axes, counts, strict=True):
            axis.send(self.link, _RUN, count)
        if not self.link.wait(lambda: self._sync_count > self._sync_taken, 2.5 * self.settings.period_s):
            self.counters.sync_losses += 1
            raise LinkLostError(f"stream: no SYNC on the bus for {2.5e3 * self.settings.period_s:g} ms")
        self._sync_taken = self._sync_count

    def _account_for_missed(self, missed: int) -> None:
        """SYNCs went by without new set-points: count them, and stop when it is too many in a row."""
        if not missed:
            self._missed_in_a_row = 0
            return
        self.counters.missed_cycles += missed
        self._missed_in_a_row += missed
        if self._missed_in_a_row > self.settings.missed_limit:
            raise SafetyError(
                f"stream: {self._missed_in_a_row} cycles of {1e3 * self.settings.period_s:g} ms missed in a row, the host is late"
            )

    def _begin_cycle(self) -> None:
        """At a SYNC: what was sent is in force now, and every axis owes an answer."""
        for axis in self._axes:
            axis.fresh = False
            axis.demand_counts = axis.next_counts
        self._awaited.update(self._axes)

    def _on_sync(self, _time_ns: int, _data: bytes) -> None:
        self._sync_count += 1
        self._begin_cycle()

    def _all_answered(self) -> bool:
        return not self._awaited

    def _account_for_late(self) -> None:
        """Somebody's feedback did not come in time."""
        for axis in self._axes:
            if axis.fresh:
                continue
            self.counters.late_feedback += 1
            axis.late_in_a_row += 1
            axis.drive.monitor.check()
            if axis.late_in_a_row > self.settings.late_limit:
                raise NoAnswerError(
                    f"drive {axis.drive.name}: no feedback for {axis.late_in_a_row} cycles of"
                    f" {1e3 * self.settings.period_s:g} ms"
                )

    def _judge(self, axis: _Axis) -> None:
        """Is the axis still doing what it was told?"""
        if axis.status & _RUNNING_MASK != _RUNNING:
            self._explain_status(axis)
        if (
            not -axis.max_error_counts <= axis.position_counts - axis.demand_counts <= axis.max_error_counts
            and self._by_position
        ):
            error_mm = abs(axis.position_counts - axis.demand_counts) * abs(axis.mm_per_count)
            raise FollowingErrorError(
                f"drive {axis.drive.name}: {error_mm:.3f} mm from its set-point,"
                f" allowed are {self.settings.following_error_mm:g} mm"
            )

    def _explain_status(self, axis: _Axis) -> None:
        """Raise what a statusword other than "enabled and following" means; the first cycle may not follow yet."""
        state, name = decode_state(axis.status), axis.drive.name
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            code = axis.drive.monitor.last_error_code() or None
            raise DriveFaultError(f"drive {name} went into {state.value} while streaming", code)
        if state is not DriveState.ENABLED:
            raise StateError(f"drive {name} left operation enabled while streaming: {state.value}")
        if self.counters.cycles > 1:
            raise StateError(f"drive {name} does not follow the set-points (bit 12 is 0)")

    def _quick_stop_all(self) -> None:
        """Whatever happens: every axis gets its quick stop, by RPDO at once and by SDO with an answer."""
        for axis in self._axes:
            with suppress(BridgeError):
                axis.send(self.link, Command.QUICK_STOP.word, axis.next_counts)
        with suppress(BridgeError):
            self.link.send(SYNC, b"")
        for axis in self._axes:
            with suppress(BridgeError):
                axis.drive.quick_stop()


def _interpolation(period_s: float) -> tuple[int, int]:
    """60C2h: value and exponent of ten for a period. Raises InputError for one that cannot be written so."""
    for exponent in (-3, -4, -5, -6):
        value = period_s / 10.0**exponent
        if value <= 255 and abs(value - round(value)) < 1e-6 * value:
            return round(value), exponent
    raise InputError(f"a period of {period_s} s cannot be written into 60C2h")
