"""Streaming positions to several drives, paced by SYNC: cyclic synchronous position, or interpolated position in its place.

Set-points are sent at once, take effect at the next SYNC (synchronous RPDOs), and the feedback that this SYNC requested is received
before the call returns. Deviations are counted, and acted on: once a limit is exceeded all axes are
quick-stopped and an error names what happened. SYNC comes from this process.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import partial
from types import TracebackType
from typing import Self

import can

from drivers.canopen import cia301
from drivers.canopen.bus import CanLink
from drivers.canopen.pdo import SYNC_EVERY
from drivers.canopen.pdo_lint import Cycle, lint, refuse_errors
from drivers.canopen.side_by_side import CanLine
from drivers.canopen.stopping import StoppableNode
from drivers.canopen.stream_axis import RUNNING, RUNNING_MASK, StreamAxis
from drivers.canopen.sync import SYNC, SyncFollower
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.cia402.state_machine import Command, decode_state
from drivers.clock import NS_PER_S
from drivers.drive import DriveState, ServoDrive
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    InputError,
    LinkLostError,
    NoAnswerError,
    SafetyError,
    StateError,
)
from drivers.set_points import SetPointSettings, SetPointStream
from drivers.shutdown import stop_together
from drivers.undo import undo_all

FEEDBACK_SHARE = 0.8
"""Share of the period within which feedback must have come."""
LATE_LIMIT = 3
"""Number of successive cycles without feedback after which a stream is stopped."""
HEARTBEATS_WATCHED_S = 0.05
"""Interval of the checks of every drive's heartbeat while its feedback comes, s."""
FOREIGN_SYNCS = 3
FOREIGN_SYNC_S = 10.0
"""Number of foreign SYNCs within `FOREIGN_SYNC_S` seconds above which the stream ends. A program that only samples sends at most two
before it hears the stream's and leaves SYNC to it; a third may come from a program that is started meanwhile."""


class CyclicStream(SetPointStream):
    """Set-points to drives on one link. On leaving they are set to profile position. An axis that cannot be put back, or does not
    confirm its stop, is disabled. While it runs no other drive on the link answers SYNC.

    cycles: number of those begun. late_feedback: number of answers that did not come in time. foreign_syncs: of SYNCs that the stream
    did not send.
    """

    def __init__(self, drives: Sequence[ServoDrive], settings: SetPointSettings) -> None:
        """Raises CapabilityError for drives that are not all on one bus."""
        nodes = [drive for drive in drives if isinstance(drive, StoppableNode)]
        if len(nodes) < len(drives) or any(node.link is not nodes[0].link for node in nodes):
            names = ", ".join(drive.name for drive in drives)
            raise CapabilityError(
                f"drives {names} are not all on one CAN bus, so that no SYNC could pace them together"
            )
        self.settings = settings
        self.cycles = self.missed_cycles = self.late_feedback = self.foreign_syncs = 0
        self.reached_ns = 0  # when SYNC is sent next, too
        self.found = [(0, math.nan)] * len(drives)
        self.link = nodes[0].link
        self.clock = self.link.clock
        self._drives = tuple(nodes)
        self._axes = [
            StreamAxis(
                drive.node,
                drive.power,
                drive.scaling,
                drive.limits,
                settings,
                stop=drive.connection.stop_rpdo,
                mode=drive.modes.streaming or Mode.CYCLIC_POSITION,
                kind=SYNC_EVERY if drive.connection.rpdo is None else drive.connection.rpdo.kind,
            )
            for drive in nodes
        ]
        self._last_first = sorted(self._axes, key=lambda axis: -axis.tpdo.cob_id)
        self._sync_message = can.Message(arbitration_id=SYNC, data=b"", is_extended_id=False)
        self._period_ns = round(settings.period_s * NS_PER_S)
        self._watch_every = max(1, round(HEARTBEATS_WATCHED_S / settings.period_s))
        self._feedback_s = settings.period_s * FEEDBACK_SHARE
        self._missed_in_a_row = 0
        self._running = False
        self._stopped = False  # whether a stop was sent to the axes
        self._foreign: list[int] = []  # times of recent SYNCs that are not the owner's

    # -- entering and leaving --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self._check_fit()
        try:
            self.link.claim_sync(self)
            self._silence_neighbours()
            for drive, axis in zip(self._drives, self._axes, strict=True):
                self._prepare(drive, axis)
            self.found = [(axis.heard_ns, axis.position_counts * axis.mm_per_count) for axis in self._axes]
            self._start()
        except BaseException as error:  # nothing was moved: the axes are restored, and stay in their state
            if not isinstance(error, BridgeError):
                self._send_stops()
            self._end(error)
            raise
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if exc is not None and self._running:
            self._stop_all(exc)
        self._end(exc)

    def _check_fit(self, *staying: SyncFollower) -> None:
        """Raise InputError unless the cycle fits the bus, with the TPDOs of other drives that answer its SYNC."""
        cycle = Cycle(self.settings.period_s * 1e6, self.link.bitrate)
        pdos = {axis.node.node_id: (axis.rpdo, axis.tpdo) for axis in self._axes}
        refuse_errors(lint(pdos | {follower.node_id: tuple(follower.specs) for follower in staying}, cycle=cycle))

    def _silence_neighbours(self) -> None:
        """Take drives on this bus that do not stream out of SYNC; one that cannot counts in the load."""
        streaming = [drive.sampler for drive in self._drives]
        others = [follower for follower in self.link.sync.followers if follower not in streaming]
        staying = [follower for follower in others if not follower.leave_sync()]
        if staying:
            self._check_fit(*staying)

    def _prepare(self, drive: StoppableNode, axis: StreamAxis) -> None:
        """Axis enabled and held, PDOs for the stream, then the mode; target := actual before the mode takes effect.

        Raises StateError, CapabilityError, ProtocolError."""
        sample = drive.sample()
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {drive.name} cannot stream: it is {sample.state.value}")
        if not drive.modes.has(axis.mode):
            raise CapabilityError(f"drive {drive.name} has no {axis.mode.name.lower().replace('_', ' ')} mode")
        if drive.connection.no_stream:
            raise CapabilityError(f"drive {drive.name} cannot stream: {drive.connection.no_stream}")
        value, exponent = _interpolation(self.settings.period_s)
        with suppress(AbortError):  # 60C2h is optional, and fixed in some drives
            drive.kept.set(objects.INTERPOLATION_PERIOD, value)
            drive.kept.set(objects.INTERPOLATION_EXPONENT, exponent)
        drive.begin_streaming(axis)
        axis.taken = True
        axis.setup.apply(interrupted=self._send_stops)
        if axis.mode is Mode.INTERPOLATED_POSITION:
            with suppress(AbortError):  # 60C4h is optional: set-points of an earlier stream are cleared
                drive.kept.set(objects.BUFFER_CLEAR, 1, always=True)
        drive.set_mode(axis.mode)
        axis.position_counts = drive.sdo.read(objects.POSITION_ACTUAL)
        axis.demand_counts = axis.next_counts = axis.position_counts
        axis.status = drive.sdo.read(objects.STATUSWORD)
        axis.heard_ns = self.clock.now_ns()
        self.link.subscribe(axis.tpdo.cob_id, axis.receive)

    def _start(self) -> None:
        for axis in self._axes:
            with suppress(AbortError):  # 1006h is optional; by it a drive notices itself that SYNC has stopped
                sdo = axis.node.sdo
                axis.sync_period_before = sdo.read(cia301.SYNC_PERIOD)
                sdo.write(cia301.SYNC_PERIOD, round(self.settings.period_s * 1e6))
        self._running = True
        self.reached_ns = self.clock.now_ns() + self._period_ns
        self.link.subscribe(SYNC, self._on_sync)

    def _stop_all(self, error: BaseException) -> None:
        self._running, self._stopped = False, True
        stop_together(self._drives, error)

    def _send_stops(self) -> None:
        self._stopped = True
        for drive in self._drives:
            drive.send_stop()

    def _end(self, error: BaseException | None) -> None:
        """The drives stop supervising SYNC, SYNC stops, every axis is given back; every step is tried, see `undo_all`."""
        self._running = False
        taken = [(drive, axis) for drive, axis in zip(self._drives, self._axes, strict=True) if axis.taken]
        held = ExitStack()
        with ExitStack() as stack:
            for drive, _ in taken:
                stack.enter_context(drive.way_out.step(last=False))
            undo_all(
                [
                    ("", partial(self._sync_until_free, held)),
                    ("", partial(_unwatch_sync, self.link, [axis for _, axis in taken])),
                    ("", held.close),
                    ("", partial(self.link.unsubscribe, SYNC, self._on_sync)),
                    *(("", partial(self._give_back, drive, axis)) for drive, axis in taken),
                    ("", partial(self.link.sync.release, self)),
                ],
                during=error,
                interrupted=self._send_stops,
            )

    def _sync_until_free(self, held: ExitStack) -> None:
        """Where drives supervise SYNC, send it while another thread is in the middle of an SDO access: before that is over they cannot
        be told that SYNC ends. Then no other thread begins an access until `held` is closed."""
        if all(axis.sync_period_before is None for axis in self._axes):
            return
        talking, clock = self.link.talking, self.clock
        while not talking.acquire(timeout=max(0, self.reached_ns - clock.now_ns()) / NS_PER_S):
            clock.check_interrupt()
            clock.sleep_until_ns(self.reached_ns)  # returns at once where waiting for the lock advances the clock
            with suppress(LinkLostError):
                self.link.send_message(self._sync_message)
            self.reached_ns = max(self.reached_ns, clock.now_ns()) + self._period_ns
        held.callback(talking.release)

    def _give_back(self, drive: StoppableNode, axis: StreamAxis) -> None:
        """Restore the PDOs, and profile position unless it was stopped; an axis that cannot be restored is disabled."""
        self.link.unsubscribe(axis.tpdo.cob_id, axis.receive)
        axis.taken = False
        try:
            try:
                axis.setup.restore()
            finally:
                drive.end_streaming()
            if not self._stopped:
                if axis.mode is Mode.INTERPOLATED_POSITION:
                    drive.power.write(Command.ENABLE_OPERATION.word)  # bit 4 means a new set-point in profile position
                drive.set_mode(drive.modes.resting)
        except BaseException as error:
            drive.send_stop()
            undo_all([("", drive.disable)], during=error)
            raise

    # -- the cycle -------------------------------------------------------------------------------------------------------
    def cycle(self, positions_load_mm: Sequence[float]) -> None:
        """As `SetPointStream.cycle`: the set-points wait for the SYNC that applies them, and this for the feedback that it requests. A
        position that did not come in time is the last one."""
        axes = self._axes
        if not self._running:
            raise StateError("the stream is not running")
        if len(positions_load_mm) != len(axes):
            raise InputError(f"{len(positions_load_mm)} set-points for {len(axes)} axes")
        try:
            self._end_when_stopped()
            for axis, place_mm in zip(axes, positions_load_mm, strict=False):
                axis.plan(place_mm)
            self._exchange()
            self.cycles += 1
            answered = self.link.wait(self._all_answered, self._feedback_s)
            if len(self._foreign) > FOREIGN_SYNCS:
                raise SafetyError(
                    f"stream: a second SYNC producer is on the bus: {len(self._foreign)} SYNCs within {FOREIGN_SYNC_S:g} s were not"
                    " ours"
                )
            if not answered:
                self._account_for_late()
            if self.cycles % self._watch_every == 0:
                for axis in axes:
                    axis.node.monitor.check()
            synced_ns = self.reached_ns - self._period_ns
            for index, axis in enumerate(axes):
                counts = axis.position_counts
                if axis.fresh:
                    axis.late_in_a_row = 0
                    if axis.status & RUNNING_MASK != RUNNING:
                        self._judge_status(axis)
                    if abs(counts - axis.demand_counts) > axis.max_error_counts:
                        raise axis.explain_error()
                    self.found[index] = synced_ns, counts * axis.mm_per_count
        except BaseException as error:
            self._stop_all(error)
            raise

    def _exchange(self) -> None:
        """Send the set-points at once, SYNC when it is due."""
        link, clock = self.link, self.clock
        now_ns = clock.now_ns()
        if not self.cycles:
            self.reached_ns = now_ns + self._period_ns  # the first set-point is the zero of time
        if now_ns > self.reached_ns:
            self._account_for_missed((now_ns - self.reached_ns) // self._period_ns)
        else:
            self._missed_in_a_row = 0
        for axis in self._axes:
            axis.next_counts = axis.planned_counts
            link.send_message(axis.message)
        self._end_when_stopped()  # before SYNC: a stop that came just now was sent before the set-point, which would cancel it
        clock.sleep_until_ns(self.reached_ns)
        link.poll()  # late frames belong to the cycle before
        for axis in self._axes:  # the set-points sent are in force at SYNC, and the answer of every axis is awaited
            axis.fresh = False
            axis.demand_counts = axis.next_counts
        link.send_message(self._sync_message)
        self.reached_ns += self._period_ns

    def _account_for_missed(self, missed: int) -> None:
        """Count whole periods that went by without new set-points. Raises SafetyError when too many follow each other."""
        self.reached_ns += missed * self._period_ns
        self.missed_cycles += missed
        self._missed_in_a_row = self._missed_in_a_row + missed if missed else 0
        if self._missed_in_a_row > self.settings.missed_limit:
            raise SafetyError(
                f"stream: {self._missed_in_a_row} cycles of {1e3 * self.settings.period_s:g} ms missed in a row, the host is late"
            )

    def _end_when_stopped(self) -> None:
        """End the stream when a stop was sent to an axis: no further set-point enables it. Raises StateError."""
        for axis in self._axes:
            if axis.power.stopped:
                raise axis.explain_status()

    def _on_sync(self, time_ns: int, _data: bytes) -> None:
        """Account for a SYNC that is not the owner's; a program that only samples stops sending them when it hears ours. Above
        `FOREIGN_SYNCS` the cycle ends the stream: this may run in another thread, which dispatches."""
        if not self._running or len(self._foreign) > FOREIGN_SYNCS:
            return
        self.foreign_syncs += 1
        self._foreign.append(time_ns)
        self._foreign = [heard_ns for heard_ns in self._foreign if time_ns - heard_ns <= FOREIGN_SYNC_S * NS_PER_S]

    def _all_answered(self) -> bool:
        for axis in self._last_first:  # noqa: SIM110 - each cycle comes here, a generator would cost as much as a frame
            if not axis.fresh:  # arbitration keeps the order of answers: one check is enough until the last has come
                return False
        return True

    def _account_for_late(self) -> None:
        """Account for axes without feedback in this cycle. Raises NoAnswerError after too many cycles."""
        for axis in self._axes:
            if axis.fresh:
                continue
            self.late_feedback += 1
            axis.late_in_a_row += 1
            axis.node.monitor.check()
            if axis.late_in_a_row > LATE_LIMIT:
                raise NoAnswerError(
                    f"drive {axis.node.name}: no feedback for {axis.late_in_a_row} cycles of"
                    f" {1e3 * self.settings.period_s:g} ms"
                )

    def _judge_status(self, axis: StreamAxis) -> None:
        """Raise the error of a statusword other than "enabled and following"; the first cycle may not follow yet."""
        if self.cycles > 1 or decode_state(axis.status) is not DriveState.ENABLED:
            raise axis.explain_status()


def _unwatch_sync(link: CanLink, axes: Sequence[StreamAxis]) -> None:
    """1006h as before, of all drives at once: SYNC has ended, and a drive that is told late goes into a fault (8700h)."""
    watching = [(axis, before) for axis in axes if (before := axis.sync_period_before) is not None]
    for axis, _ in watching:
        axis.sync_period_before = None
    errors = CanLine(link).run([axis.node.sdo.putting(cia301.SYNC_PERIOD, before) for axis, before in watching])
    undo_all(
        [
            (f"drive {axis.node.name}: 1006h not put back", partial(_fail, error))
            for (axis, _), error in zip(watching, errors, strict=True)
            if error is not None
        ]
    )


def _fail(error: BridgeError) -> None:
    raise error


def _interpolation(period_s: float) -> tuple[int, int]:
    """60C2h: value and exponent of ten for a period. Raises InputError for one that cannot be written so."""
    for exponent in (-3, -4, -5, -6):
        value = period_s / 10.0**exponent
        if value <= 255 and abs(value - round(value)) < 1e-6 * value:
            return round(value), exponent
    raise InputError(f"a period of {period_s} s cannot be written into 60C2h")
