"""StoppableDrive: how an axis is stopped, brought to rest, disabled and left, whatever wire its drive is on.

The wire says how a stop leaves (`send_stop`, `_repeat_stop`), what the axis shows (`_glance`, `_look`) and how the power goes. One
ladder uses it: halt, rest, else quick stop, rest, power off, report. A stop leaves before anything is read, on any exception but a
refusal; every step is within the time of one `WayOut`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from enum import Enum
from functools import partial
from typing import Protocol

from drivers.clock import NS_PER_S, Clock
from drivers.drive import WITHOUT_POWER, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    BridgeError,
    CapabilityError,
    HeldUnderPowerError,
    InputError,
    LimitError,
    LinkLostError,
    MotionTimeoutError,
    RemoteError,
    StateError,
    TransportError,
    UndoError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.standstill import STILL_S, Standstill
from drivers.undo import undo_all
from drivers.way_out import POWER_OFF_S, WayOut, join

WITHOUT_TORQUE = (*WITHOUT_POWER, DriveState.SWITCHED_ON)
"""States in which a drive does not move its axis."""
HALT_TAKEN_S = 1.0
"""Time from a halt to the beginning of its ramp, and of the vibration of the load after it, s."""
OBEYED_S = 0.5
"""Longest time for a drive to show that it obeys a quick stop, s: many times the scan of a slow drive's interface."""
LOOK_S = 0.01
"""Interval of samples of an axis that is coming to rest, s."""
BRAKING_DELAY_S = 0.1
"""Delays of drive and bus before a ramp begins, generously, s."""


class Left(Enum):
    """How `disable` left the power of an axis."""

    UNKNOWN = "perhaps on"
    HELD = "on, as the axis would fall"
    OFF = "off"


class HomingUnderWay(Protocol):
    under_way: bool


class StoppableDrive(ServoDrive):
    """way_out: its time limit. stopped: a stop was sent since the axis was enabled last; no order is given until it is enabled again.

    stop_lets_go: after a quick stop the drive switches its power off by itself. shows_stop: it has a state for a quick stop; one that
    has none obeys by standing.
    """

    homing: HomingUnderWay
    way_out: WayOut
    stop_lets_go = False
    shows_stop = True

    def __init__(self, name: str, scaling: AxisScaling, limits: DriveLimits, clock: Clock) -> None:
        super().__init__(name, scaling, limits, clock)
        self.way_out = WayOut(clock, limits.max_velocity_mm_s / limits.max_acceleration_mm_s2)
        self._open = False
        self._left = Left.UNKNOWN
        self._shown = DriveState.UNKNOWN  # by the last look of an axis that was coming to rest
        self._halt_holds = False  # it was halted, and a stop would let it fall
        self._stop_sent_ns: int | None = None  # to an axis that was not seen since

    def _require_open(self) -> None:
        if not self._open:
            raise StateError(f"drive {self.name} is not open")

    # -- what the wire gives ---------------------------------------------------------------------------------------------
    @property
    @abstractmethod
    def stopped(self) -> bool: ...

    @abstractmethod
    def _glance(self) -> DriveSample | None:
        """What the axis shows by the fastest way, asked once; None without an answer. Raises what the wire raises."""

    @abstractmethod
    def _look(self) -> DriveSample:
        """What the axis shows, by any way, not judged. Raises what the wire raises."""

    @abstractmethod
    def _halt(self) -> None:
        """Give the order to halt. Raises what the wire raises."""

    @abstractmethod
    def _repeat_stop(self) -> None:
        """The quick stop again, until it is acknowledged. Raises what the wire raises."""

    @abstractmethod
    def _power_off(self) -> None:
        """Take the power off, every step confirmed. Raises MotionTimeoutError, and what the wire raises."""

    @abstractmethod
    def _send_power_off(self, shown: DriveState) -> None:
        """Send it by every way, without waiting. shown: the last state that was seen."""

    @abstractmethod
    def _put_back(self, left: Left) -> None:
        """Restore the settings as they were found. Raises as `undo_all`."""

    @abstractmethod
    def _release(self) -> None:
        """Let go of the wire."""

    def _stop_arrives(self, error: BridgeError) -> bool:
        """Whether a stop may have reached a drive that is lost by this error."""
        return not isinstance(error, LinkLostError)

    def _why_enabled(self) -> str:
        """Reasons for it to stay enabled after a quick stop; "" where none is known."""
        return ""

    # -- stopping --------------------------------------------------------------------------------------------------------
    def quick_stop(self) -> None:
        """Sent at once, in any state and however long the drive has been silent; then the drive must show that it obeys.

        Where it does not show it, the stop is sent again until it is acknowledged. Raises what the wire raises for one that is not,
        and MotionTimeoutError for a drive that moves on.
        """
        self._require_open()
        self._stop()
        self.homing.under_way = False
        with self.way_out.step(last=False):
            seen = self._seen()
            if seen is not None and seen.state is not DriveState.ENABLED:
                return
            self._repeat_stop()
            if not self._comes(self._obeys(), self.way_out.within_s(OBEYED_S)):
                raise MotionTimeoutError(
                    f"drive {self.name}: the quick stop was sent, but it stays enabled{self._why_enabled()}"
                )

    def _stop(self) -> None:
        self.send_stop()
        if self._stop_sent_ns is None:
            self._stop_sent_ns = self.clock.now_ns()

    def _seen(self) -> DriveSample | None:
        try:
            return self._glance()
        except BridgeError:
            return None

    def _obeys(self) -> Callable[[], bool]:
        """Whether a look shows the stop."""
        standstill = Standstill(self.scaling.resolution_load_mm)

        def obeys() -> bool:
            sample = self._glance() or self._look()
            stands = not self.shows_stop and standstill.look(sample.time_ns, sample.position_load_mm)
            return stands or sample.state is not DriveState.ENABLED

        return obeys

    def _comes(self, test: Callable[[], bool], within_s: float) -> bool:
        """Look until it is true; False when it is not in time (s). At least once, also where no time is left."""
        deadline = self.clock.deadline(within_s)
        while True:
            last = deadline.expired
            if test():
                return True
            if last:
                return False
            self.clock.sleep_s(LOOK_S)

    # -- coming to rest and taking the power off ---------------------------------------------------------------------------
    def disable(self) -> None:
        """Halt, and take the power off once the axis is at rest. Where the halt is not confirmed or no standstill is shown in its
        time: quick stop first, and the power is taken off all the same, unless the axis falls without it.

        Raises HeldUnderPowerError for an axis that falls and is held, MotionTimeoutError when it was disabled without having been
        seen at rest, or is not seen disabled, and what the wire raises. On any exception a stop was sent.
        """
        self._require_open()
        self.homing.under_way = self._halt_holds = False
        self._left = Left.UNKNOWN
        try:
            with self.way_out.step(last=True):
                self._disable()
        except BaseException:
            if not self._halt_holds:
                self.send_stop()
            raise

    def _disable(self) -> None:
        rests = self._rests()
        at_rest = self._halted(rests) or self._stands_after_stop(rests)
        if not at_rest and self.falls_without_power:
            self._left = Left.HELD
            raise HeldUnderPowerError(
                f"drive {self.name} was stopped but not seen at rest, and gravity can move its axis: it is left under power"
            )
        try:
            self._power_off()
        except BridgeError:
            self._send_power_off(self._shown)
            seen = self._seen()
            if seen is None or seen.state not in WITHOUT_TORQUE:
                raise
        self._left = Left.OFF
        if not at_rest:
            raise MotionTimeoutError(
                f"drive {self.name}: standstill was not shown in time; it was quick-stopped and disabled nevertheless"
            )

    def _rests(self) -> Callable[[], bool]:
        """Whether a look shows the axis at rest, or without torque."""
        standstill = Standstill(self.scaling.resolution_load_mm)

        def rests() -> bool:
            sample = self._look()
            self._shown, self._stop_sent_ns = sample.state, None
            with suppress(BridgeError):  # an error of an observer does not prevent the stop
                self.looked_at(sample)
            stands = standstill.look(sample.time_ns, sample.position_load_mm, sample.velocity_mm_s)
            return stands or sample.state in WITHOUT_TORQUE

        return rests

    def _halted(self, rests: Callable[[], bool]) -> bool:
        """Halt; False where no standstill was shown. A drive that does not answer is stopped before anything else is asked."""
        seen = self._seen()
        try:
            if seen is None:
                self._stop()
                if not self.way_out.left_s():
                    return False
                seen = self._look()
            if seen.state in WITHOUT_TORQUE:
                return True
            if seen.state is not DriveState.ENABLED or self.stopped:
                return False
            self._halt()
            self._halt_holds = self.falls_without_power and self.stop_lets_go
            return self._comes(rests, self._halting_s)
        except BridgeError:
            return False

    @property
    def _halting_s(self) -> float:
        """Longest time of a halt from the axis's highest velocity with a ramp three times flatter than the axis's, s, and half of the
        time of shutting down. An axis that moves for longer does not obey, as where another master moves it: it is quick-stopped."""
        limits = self.limits
        ramp_s = limits.max_velocity_mm_s / limits.max_acceleration_mm_s2
        return self.way_out.within_s(HALT_TAKEN_S + 3.0 * ramp_s, leave_s=0.5 * self.way_out.budget_s)

    def _stands_after_stop(self, rests: Callable[[], bool]) -> bool:
        """Quick stop, and False where no standstill was shown. The axis gets the time that braking needs, also without an answer."""
        if not self._halt_holds:
            self._stop()
        braking_s = self.way_out.braking_s + BRAKING_DELAY_S
        left_s = self.way_out.within_s(self.way_out.budget_s, leave_s=POWER_OFF_S)
        try:
            return self._comes(rests, max(left_s, braking_s + STILL_S))
        except BridgeError as error:
            if self._stop_arrives(error) and self._stop_sent_ns is not None:
                self.clock.sleep_until_ns(self._stop_sent_ns + round(braking_s * NS_PER_S))
            return False

    # -- errors while the axis moves ---------------------------------------------------------------------------------------
    @contextmanager
    def _no_motion_after_errors(self) -> Iterator[None]:
        """Around orders that start or change a motion: no error is raised while the axis moves.

        An order that is not confirmed: the axis is quick-stopped and its power taken off, see `disable`. A refusal before anything
        was ordered leaves the axis as it is. On an interrupt a stop is sent, and the caller handles the rest.
        """
        try:
            yield
        except (StateError, CapabilityError, InputError):
            raise
        except BridgeError as error:
            if not (isinstance(error, LimitError) and self._seen_at_rest()):  # refused by the drive, and halted
                self._bring_down(error)
            raise
        except BaseException:
            self.send_stop()
            raise

    def _seen_at_rest(self) -> bool:
        try:
            return self._comes(self._rests(), self.way_out.budget_s)
        except BridgeError:
            return False

    def _bring_down(self, error: BridgeError) -> None:
        """Quick stop, then `disable`. A quick stop that would let an axis fall is left to `disable`, which halts it first."""
        if not (self.falls_without_power and self.stop_lets_go):
            self.send_stop()
        try:
            self.disable()
        except HeldUnderPowerError as held:
            raise HeldUnderPowerError(f"{held}; {error}") from error
        except BridgeError as worse:
            error.add_note(str(worse))

    # -- leaving -----------------------------------------------------------------------------------------------------------
    def close(self) -> None:
        """Bring the axis to rest and take its power off, by any way that still works; then restore what was found, and let go.

        Every step is tried, see `undo_all`. Raises nothing when all of it failed without an answer: without a drive nothing can be
        done.
        """
        if not self._open:
            return
        self._left = Left.UNKNOWN
        try:
            with self.way_out.step(last=True):
                undo_all([("", self._disable_at_last), ("", lambda: self._put_back(self._left))])
        except BridgeError as error:
            if not _is_silence(error) or self._answers():
                raise
        finally:
            self._release()

    def _disable_at_last(self) -> None:
        """Disable once more a drive that answers after all, such as one that answers late or was silent for a while."""
        try:
            self.disable()
        except (TransportError, RemoteError):
            if not self._answers():
                raise
            self.disable()

    def _answers(self) -> bool:
        """Whether it gives any answer to one request, a refusal included."""
        try:
            self._ask()
        except TransportError:
            return False
        except BridgeError:
            return True
        return True

    @abstractmethod
    def _ask(self) -> None:
        """Make one request. Raises what the wire raises."""


def stop_together(drives: Sequence[ServoDrive], error: BaseException) -> None:
    """Stop the axes of a stream: all stops are sent before any is waited for; an axis that does not confirm it is disabled. Failures
    become notes of the error."""
    for drive in drives:
        drive.send_stop()
    share_time(drives)
    undo_all([("", partial(_stop, drive)) for drive in drives], during=error)


def _stop(drive: ServoDrive) -> None:
    try:
        drive.quick_stop()
    except BridgeError as error:
        undo_all([("", drive.disable)], during=error)
        raise


def share_time(drives: Sequence[ServoDrive]) -> None:
    """Give axes that shut down together one time limit, so that the time-outs of several dead drives do not add up."""
    join([drive.way_out for drive in drives if drive.way_out is not None])


def _is_silence(error: BridgeError) -> bool:
    """Whether the error consists of unanswered requests only."""
    if isinstance(error, UndoError):
        return all(_is_silence(each) for each in error.errors)
    return isinstance(error, TransportError)
