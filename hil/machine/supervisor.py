"""Supervisor: moves the axes of one machine, watches them during every wait, stops them together, and disables them at the end.

Every wait of every procedure goes through `watch` or `watch_until`. Any exception, KeyboardInterrupt included, quick-stops all axes
of the machine before it reaches the procedure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import TracebackType
from typing import Self

from drivers.clock import NS_PER_S
from drivers.drive import Capability, DriveSample, DriveState, HomingSpeeds
from drivers.errors import (
    BridgeError,
    FollowingErrorError,
    LimitError,
    LocalError,
    MeasurementLostError,
    MotionTimeoutError,
    SafetyError,
)
from drivers.instrument import Reading, ReadingStatus
from drivers.limits import DriveLimits
from drivers.shutdown import share_time
from drivers.standstill import ARRIVED_WITHIN_MM
from drivers.undo import Step, undo_all
from hil.machine.time_out import Motion, drive_report, likely_reason
from hil.machine.watched_axis import STALLED_S, WatchedAxis

SLICE_S = 0.05
"""Interval between samples of an axis in motion, s."""
REST_SLICE_S = 0.2
"""Interval between samples at rest, s: shorter than the time for which instruments buffer their readings."""
UNSEEN_S, UNSEEN_TIMES = 0.5, 5
"""A motion ends when the looks at its axes take longer than this, s, so many times in a row. A request that is lost once takes up to a
second and is no reason; at 50 mm/s five such looks are 125 mm seen at five places only."""
FIRST_READING_S = 2.0
"""Time limit from opening an instrument to its first reading, s: some send it only after their air sensors have reported in turn."""
LONGER, LONGER_S = 3.0, 5.0
"""Time limit of a move: this factor times its duration by speed and ramps, and so many seconds more (an override of 50 %, a slow
start)."""
HOMING_SHARE, HOMING_S = 0.01, 30.0
"""Time limit of a homing: the whole travel at this share of the largest velocity, or at the drive's own speed of homing where that is
lower, and so many seconds more."""

Look = Callable[[DriveSample], None]
"""Called with every sample of the axis in motion; an exception that it raises stops the machine."""


def finish_despite_interrupt(undo: Callable[[], None]) -> None:
    """Call `undo`. After an interrupt meanwhile (Ctrl-C, the operator's stop), `undo` is called again, as it may be half done, and
    then the interrupt is raised. Raises what `undo` raises; after an interrupt, BridgeErrors are added to it as notes."""
    try:
        undo()
    except KeyboardInterrupt as interrupt:
        try:
            undo()
        except BridgeError as error:
            interrupt.add_note(str(error))
        raise


def homing_time_s(limits: DriveLimits, speeds: HomingSpeeds | None = None) -> float:
    """Time limit of a homing, s (`HOMING_SHARE`, `HOMING_S`). speeds: of the drive, as far as they are known."""
    slowest_mm_s = HOMING_SHARE * limits.max_velocity_mm_s
    known = speeds or HomingSpeeds()
    search_mm_s = min(slowest_mm_s, known.switch_mm_s or slowest_mm_s)
    to_index_s = (
        2.0 * known.turn_mm / known.zero_mm_s if known.zero_mm_s else 0.0
    )  # back over the switch, and a turn to the index
    return HOMING_S + (limits.travel_max_mm - limits.travel_min_mm) / search_mm_s + to_index_s


def _time_limit_s(limits: DriveLimits, travel_mm: float, speed_mm_s: float) -> float:
    """Time limit of a move, s (`LONGER`, `LONGER_S`)."""
    return LONGER_S + LONGER * (travel_mm / speed_mm_s + speed_mm_s / limits.max_acceleration_mm_s2)


class Supervisor:
    """Supervisor of axes whose drives and instruments are open. A method without an `axis` argument concerns the first axis.

    beside: other axes of the machine, watched and stopped with these; their own supervisor disables them.
    As a context manager: `begin` on entering, `leave` on leaving.
    """

    def __init__(self, axes: Sequence[WatchedAxis]) -> None:
        self.axes = tuple(axes)
        self.beside: tuple[WatchedAxis, ...] = ()
        self.clock = self.axes[0].drive.clock
        self._found_enabled: set[WatchedAxis] = set()
        self._stopped_for: BaseException | None = None

    # -- coming and going --------------------------------------------------------------------------------------------
    def begin(self) -> None:
        """Note which axes are enabled, and drop earlier readings. Raises what sampling the drives raises."""
        self._stopped_for = None
        self._found_enabled.clear()
        for axis in self.axes:
            axis.begin()
            if axis.drive.sample().state is DriveState.ENABLED:
                self._found_enabled.add(axis)

    def leave(self, error: BaseException | None, *more: Step) -> None:
        """Stop the axes if `error` is not None, disable each axis that was not enabled at `begin`, then do the steps `more`.

        Every step is tried. Failures are raised, or added to `error` as notes (`drivers.undo`).
        """
        steps: list[Step] = []
        if error is not None:
            steps.append(("", partial(self.stop_for, error)))
        for axis in self.axes:
            if axis not in self._found_enabled:
                power_off = partial(finish_despite_interrupt, axis.drive.disable)
                steps.append((f"drive {axis.drive.name} may still be under power", power_off))
        self._found_enabled.clear()
        share_time([axis.drive for axis in (*self.axes, *self.beside)])
        undo_all((*steps, *more), during=error)
        self._stopped_for = None

    @contextmanager
    def leaving(self) -> Iterator[None]:
        """Call `leave` at the end of the block, with the error that ended it."""
        try:
            yield
        except BaseException as error:
            self.leave(error)
            raise
        self.leave(None)

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.leave(exc)

    # -- stopping ----------------------------------------------------------------------------------------------------
    @contextmanager
    def stopping_on_error(self) -> Iterator[None]:
        """Stop all axes on any exception inside the block, KeyboardInterrupt included, and raise it."""
        try:
            yield
        except BaseException as error:
            self.stop_for(error)
            raise

    def stop_for(self, error: BaseException) -> None:
        """Stop all axes, once for each error: nested blocks see the same one. Stops again where the first stop was not confirmed."""
        if error is self._stopped_for:
            return
        earlier = list(getattr(error, "__notes__", ()))
        self.stop(during=error)
        notes = list(getattr(error, "__notes__", ()))
        if notes == earlier:
            self._stopped_for = error
        else:
            error.__notes__ = list(dict.fromkeys(notes))  # a failure that occurred twice is noted once

    def stop(self, *, during: BaseException | None = None) -> None:
        """Quick stop of all axes: a stop is sent to each before any is waited for.

        A stop that is not confirmed is raised, or added to `during` as a note.
        """
        axes = (*self.axes, *self.beside)
        share_time([axis.drive for axis in (*self.axes, *self.beside)])
        for axis in axes if len(axes) > 1 else ():
            axis.drive.send_stop()
        undo_all([(f"drive {axis.drive.name} may still move", partial(_stop, axis)) for axis in axes], during=during)

    # -- looking -----------------------------------------------------------------------------------------------------
    def _look_beside(self, axis: WatchedAxis) -> None:
        """Sample all other axes that were not sampled for `SLICE_S`."""
        for other in (*self.axes, *self.beside):
            if other is not axis and self.clock.now_ns() - other.looked_ns >= SLICE_S * NS_PER_S:
                if other.kept_for:
                    other.look_enabled(other.kept_for)
                else:
                    other.look()

    def readings(self) -> list[tuple[int, Reading]]:
        """New readings of the first axis's instrument, each with its number; for use while a stream samples the drive."""
        with self.stopping_on_error():
            return self.axes[0].readings()

    # -- waiting -----------------------------------------------------------------------------------------------------
    def await_instrument(self) -> None:
        """Wait for the first good reading of the first axis's instrument; call before any motion.

        Raises MeasurementLostError when none comes within `FIRST_READING_S`.
        """
        axis, deadline = self.axes[0], self.clock.deadline(FIRST_READING_S)
        status: ReadingStatus | None = None
        with self.stopping_on_error():
            while (status := axis.latest_status() or status) is not ReadingStatus.GOOD:
                if deadline.expired:
                    what = f"no reading within {FIRST_READING_S:g} s" if status is None else status.value
                    raise MeasurementLostError(f"instrument {axis.instrument_name}: {what}; nothing was enabled")
                self.clock.sleep_s(SLICE_S)

    def watch(self, duration_s: float, look: Look | None = None) -> list[Reading]:
        """Watch the axes at rest for `duration_s`; returns the readings of the first axis's instrument that arrived meanwhile.

        look: called with each sample of the first axis. Raises what `WatchedAxis.look` raises.
        """
        axis, deadline = self.axes[0], self.clock.deadline(duration_s)
        asked = axis.instrument is not None and axis.instrument.answers_when_asked
        slice_ns = round((SLICE_S if asked else REST_SLICE_S) * NS_PER_S)
        arrived: list[Reading] = []
        with self.stopping_on_error():
            while not deadline.expired:
                self.clock.sleep_until_ns(min(self.clock.now_ns() + slice_ns, deadline.end_ns))
                self._look_beside(axis)
                sample, readings = axis.look()
                arrived.extend(readings)
                if look is not None:
                    look(sample)
        return arrived

    def watch_until(
        self,
        condition: Callable[[DriveSample], bool],
        timeout_s: float,
        what: str,
        *,
        axis: WatchedAxis | None = None,
        slice_s: float = SLICE_S,
        look: Look | None = None,
    ) -> DriveSample:
        """Watch until a sample of the axis fulfils the condition; returns that sample.

        what: name of the motion, for messages; slice_s: interval between samples; look: called with each sample.
        Raises MotionTimeoutError, with the likely reason, when no sample does within `timeout_s`, or when an axis that was commanded
        to move has stood for `STALLED_S`; SafetyError when looks take too long (`UNSEEN_S`); StateError for a drive that is no longer
        enabled, and what `WatchedAxis.look` raises.
        """
        axis = axis or self.axes[0]
        deadline, unseen = self.clock.deadline(timeout_s), 0
        with self.stopping_on_error():
            while True:
                began_ns = self.clock.now_ns()
                self._look_beside(axis)
                sample = axis.look_enabled(what)
                took_s = (self.clock.now_ns() - began_ns) / NS_PER_S
                unseen = unseen + 1 if took_s > UNSEEN_S else 0
                if unseen == UNSEEN_TIMES:
                    raise SafetyError(
                        f"drive {axis.drive.name}: {what} cannot be watched, {unseen} looks in a row took longer than {UNSEEN_S:g} s"
                        f" (the last {took_s:.1f} s); the line loses answers, or the host is busy"
                    )
                if look is not None:
                    look(sample)
                if condition(sample):
                    return sample
                if stalled := axis.stalled:
                    raise self._not_over(axis, sample, f"{what} not over, and the axis {stalled} for {STALLED_S:g} s")
                if deadline.expired:
                    raise self._not_over(axis, sample, f"{what} not over within {timeout_s:.1f} s")
                self.clock.sleep_s(slice_s)

    @staticmethod
    def _not_over(axis: WatchedAxis, sample: DriveSample, what: str) -> MotionTimeoutError:
        speed_mm_s = axis.seen_mm_s
        reason = likely_reason(axis.motion or Motion(what), sample, speed_mm_s)
        said = drive_report(sample, speed_mm_s, axis.drive.complaints())
        return MotionTimeoutError(f"drive {axis.drive.name}: {what}; likely {reason}; it says: {said}")

    # -- motion ------------------------------------------------------------------------------------------------------
    def enable(self) -> None:
        """Enable each axis that is not enabled; one that a quick stop holds is disabled before. Raises what enabling raises."""
        for axis in self.axes:
            state = axis.drive.sample().state
            if state is DriveState.QUICK_STOP:
                axis.drive.disable()
            if state is not DriveState.ENABLED:
                axis.drive.enable()

    def get_ready(self, *, home: bool) -> None:
        """Enable the axes and, with `home`, home each whose drive does not report that it is homed.

        Raises CapabilityError, before any axis is enabled, for a drive that cannot home; and as `home`.
        """
        for axis in self.axes:
            if home and not axis.drive.sample().homed:
                axis.drive.require(Capability.HOMING)
        self.enable()
        for axis in self.axes:
            if home and not axis.drive.sample().homed:
                self.home(axis=axis)

    def home(self, *, axis: WatchedAxis | None = None, look: Look | None = None) -> None:
        """Run the drive's own homing, watched to its end. Raises as `watch_until`; time limit: `homing_time_s`."""
        axis = axis or self.axes[0]
        drive = axis.drive
        speeds = drive.homing_speeds()
        with self._ordered(axis, Motion("homing"), drive.start_homing):
            self.watch_until(
                lambda sample: bool(sample.homed) and sample.target_reached,
                homing_time_s(drive.limits, speeds),
                "homing",
                axis=axis,
                look=look,
            )
        if axis.instrument is not None:  # travel is compared from before the next motion on
            with self.stopping_on_error():
                axis.look()
            self.watch(REST_SLICE_S)

    def move(
        self,
        target_mm: float,
        speed_mm_s: float,
        *,
        axis: WatchedAxis | None = None,
        started: Callable[[], None] = lambda: None,
        within_mm: float = ARRIVED_WITHIN_MM,
        slice_s: float = SLICE_S,
        look: Look | None = None,
    ) -> DriveSample:
        """Move to a target, mm, and return the sample of the arrival. started: called once the drive has the command.

        within_mm: tolerance of the arrival check; slice_s, look: as for `watch_until`. Raises LimitError and StateError before any
        motion, FollowingErrorError for an arrival outside the tolerance, and as `watch_until`.
        """
        axis = axis or self.axes[0]
        what = f"the move to {target_mm:.4f}"

        def arrived(sample: DriveSample) -> bool:
            return sample.target_reached

        sample = self.move_until(
            arrived, target_mm, speed_mm_s, what, axis=axis, started=started, slice_s=slice_s, look=look
        )
        self._check_arrival(axis, sample, target_mm, within_mm)
        return sample

    @contextmanager
    def moving_beside(
        self, axis: WatchedAxis, target_mm: float, speed_mm_s: float, started: Callable[[], None]
    ) -> Iterator[None]:
        """Start a move of another axis, mm, and wait for its arrival at the end of the block, in which this one moves. An error in
        the block stops both. Raises as `move`."""
        what, found = f"the move to {target_mm:.4f}", axis.drive.sample()
        travel_mm = abs(target_mm - found.position_load_mm)
        timeout_s = _time_limit_s(axis.drive.limits, travel_mm, speed_mm_s)
        order = partial(axis.drive.start_move, target_mm, speed_mm_s)
        with self._ordered(axis, Motion(what, target_mm, speed_mm_s), order, found):
            with self.stopping_on_error():
                started()
                yield
            sample = self.watch_until(lambda now: now.target_reached, timeout_s, what, axis=axis)
        self._check_arrival(axis, sample, target_mm, ARRIVED_WITHIN_MM)

    def _check_arrival(self, axis: WatchedAxis, sample: DriveSample, target_mm: float, within_mm: float) -> None:
        """Raises FollowingErrorError, with all axes stopped, for an arrival outside the tolerance."""
        if abs(sample.position_load_mm - target_mm) > within_mm:
            with self.stopping_on_error():
                limited = ", a limit of its own is active: of current, velocity or position" if sample.limited else ""
                raise FollowingErrorError(
                    f"drive {axis.drive.name} says it arrived, but is at {sample.position_load_mm:.4f} mm,"
                    f" expected {target_mm:.4f} mm{limited}"
                )

    def move_until(
        self,
        condition: Callable[[DriveSample], bool],
        target_mm: float,
        speed_mm_s: float,
        what: str,
        *,
        axis: WatchedAxis | None = None,
        started: Callable[[], None] = lambda: None,
        timeout_s: float | None = None,
        slice_s: float = SLICE_S,
        look: Look | None = None,
    ) -> DriveSample:
        """Start a move to a target, mm, and watch until the condition holds.

        timeout_s: None, computed from travel, speed and ramps (`LONGER`, `LONGER_S`). Raises as `move`, without an arrival check.
        """
        axis = axis or self.axes[0]
        drive = axis.drive
        found = drive.sample()
        if timeout_s is None:
            timeout_s = _time_limit_s(drive.limits, abs(target_mm - found.position_load_mm), speed_mm_s)
        motion = Motion(what, target_mm, speed_mm_s)
        with self._ordered(axis, motion, partial(drive.start_move, target_mm, speed_mm_s), found):
            with self.stopping_on_error():
                started()
            return self.watch_until(condition, timeout_s, what, axis=axis, slice_s=slice_s, look=look)

    @contextmanager
    def _ordered(
        self, axis: WatchedAxis, motion: Motion, order: Callable[[], None], found: DriveSample | None = None
    ) -> Iterator[None]:
        """Command a motion; the block waits for its end. After any error but a refusal the motion may be under way and is stopped.

        found: a sample from just before.
        """
        with axis.moving(motion, found):
            try:
                order()
            except (LimitError, LocalError):
                raise  # refused: nothing moved
            except BaseException as error:
                self.stop_for(error)
                raise
            yield


def _stop(axis: WatchedAxis) -> None:
    axis.on_stop()
    finish_despite_interrupt(axis.drive.quick_stop)
