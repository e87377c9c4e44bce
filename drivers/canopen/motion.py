"""Profile motion in the drive's own units: set-point handshake, velocity, halt, mode changes that keep the axis held.

Holds the mode-specific bits of controlword and statusword, and their objects. Limits and millimetres are in `drive`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from drivers.canopen import objects
from drivers.canopen.cia402 import Command, Control, Mode, Status, decode_state
from drivers.canopen.node import error_text
from drivers.canopen.objects import Entry
from drivers.canopen.power import PowerStage
from drivers.canopen.sampling import Sampler
from drivers.canopen.sdo import SdoClient
from drivers.clock import NS_PER_S, Clock
from drivers.drive import DriveState
from drivers.errors import (
    CapabilityError,
    DriveFaultError,
    FollowingErrorError,
    LimitError,
    ProtocolError,
    StateError,
)
from drivers.undo import undo_all

POLL_S = 0.001
RUN = Command.ENABLE_OPERATION.word
FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)


def mode_of(shown: int) -> Mode:
    """The mode of 6061h; manufacturer modes and unknown ones are NONE."""
    try:
        return Mode(shown)
    except ValueError:
        return Mode.NONE


TARGETS = (objects.TARGET_POSITION, objects.TARGET_VELOCITY, objects.TARGET_TORQUE)
"""Set-points; they are never put back."""


LOOK_S = 0.01
"""Interval of samples of an axis that is coming to rest, s."""


@dataclass(frozen=True)
class _Way:
    """Positions that an axis may be seen at while a set-point is handed over, counts."""

    low: int
    high: int
    target: int


@dataclass(frozen=True)
class _Queued:
    """A following set-point that the drive holds. limited: whether bit 11 was set before it began, by the move before it."""

    target: int
    limited: bool


class ProfileMotion:
    """Motion orders to one open drive. handshake_s and mode_s: longest time for the acknowledgement, s. strays: how far outside its
    path an axis may be meanwhile, counts.
    """

    def __init__(
        self,
        sdo: SdoClient,
        power: PowerStage,
        sampler: Sampler,
        clock: Clock,
        *,
        handshake_s: float,
        mode_s: float,
        strays: int,
    ) -> None:
        self._sdo = sdo
        self._power = power
        self._sampler = sampler
        self._clock = clock
        self._handshake_s = handshake_s
        self._mode_s = mode_s
        self._strays = strays
        self._written: dict[Entry, int] = {}
        self._found: dict[Entry, int] = {}  # values of the drive before they were written
        self.supported_modes = sdo.read(objects.SUPPORTED_MODES)
        self.mode = mode_of(sdo.read(objects.MODE_DISPLAY))
        self.halted = False
        self._queued: _Queued | None = None
        self._going: tuple[int, ...] = ()  # targets of the move in progress and of the one that follows it

    def supports(self, mode: Mode) -> bool:
        """Whether 6502h lists the mode."""
        return bool(self.supported_modes & mode.supported_bit)

    # -- modes -----------------------------------------------------------------------------------------------------------
    def set_mode(self, mode: Mode) -> None:
        """Change the mode of operation and see it confirmed (6061h); the controlword is not written, so the axis stays held.

        Set-points of the new mode are first made to mean "stay". Raises CapabilityError for a mode that 6502h does not list,
        ProtocolError when the drive does not follow.
        """
        if not self.supports(mode):
            raise CapabilityError(
                f"{self._sdo.name} has no mode {mode.name.lower()} (6502h is {self.supported_modes:X}h)"
            )
        if self.mode is mode:
            return
        if mode not in (Mode.PROFILE_POSITION, Mode.HOMING):
            self.stay()
        self._remember(objects.MODE)
        self._going = ()
        self._sdo.write(objects.MODE, mode)
        deadline = self._clock.deadline(self._mode_s)
        while (shown := self._sdo.read(objects.MODE_DISPLAY)) != mode:
            if deadline.expired:
                raise ProtocolError(f"{self._sdo.name}: mode {mode} was written, {objects.MODE_DISPLAY} stays {shown}")
            self._clock.sleep_s(POLL_S)
        self.mode = mode

    def stay(self) -> None:
        """Write set-points that move nothing: target position := actual position, target velocity and torque := 0."""
        self._going = ()
        self.set(objects.TARGET_POSITION, self._sdo.read(objects.POSITION_ACTUAL), always=True)
        if self.supports(Mode.PROFILE_VELOCITY) or self.supports(Mode.CYCLIC_VELOCITY):
            self.set(objects.TARGET_VELOCITY, 0, always=True)
        if self.supports(Mode.CYCLIC_TORQUE):
            self.set(objects.TARGET_TORQUE, 0, always=True)

    def set(self, entry: Entry, value: int, *, always: bool = False) -> None:
        """Write an object unless it is known to hold the value already. Raises as `SdoClient.write`."""
        if always or self._written.get(entry) != value:
            self._written.pop(entry, None)
            self._remember(entry)
            self._sdo.write(entry, value)
            self._written[entry] = value

    def _remember(self, entry: Entry) -> None:
        if entry not in self._found and entry not in TARGETS:
            self._found[entry] = self._sdo.read(entry)

    def put_back(self) -> None:
        """Restore mode, speeds and ramps on a disabled axis. Targets are not restored: they would be motion orders."""
        found = reversed(list(self._found.items()))
        undo_all([(f"{entry} not put back", partial(self._put_back, entry, value)) for entry, value in found])

    def _put_back(self, entry: Entry, value: int) -> None:
        if self._written.pop(entry, None) != value:
            self._sdo.write(entry, value)
        del self._found[entry]
        if entry is objects.MODE:
            self.mode = mode_of(value)

    # -- profile position ------------------------------------------------------------------------------------------------
    def move(self, target: int, velocity: int, acceleration: int, *, after_the_present: bool = False) -> None:
        """Give an absolute set-point, counts and counts/s(²); returns once the drive has acknowledged it.

        It replaces the move in progress, or follows it where `after_the_present` (the drive holds one such set-point). Raises
        StateError when it holds one already, before anything is written, LimitError when the drive limits the target, ProtocolError
        for a handshake that is not acknowledged, FollowingErrorError for an axis that moves elsewhere meanwhile, DriveFaultError.
        """
        way = self._way(target, velocity, acceleration)
        if (
            after_the_present
            and self.mode is Mode.PROFILE_POSITION
            and not self._await_status(_not_acknowledged, POLL_S)
        ):
            raise StateError(f"{self._sdo.name}: it holds a following set-point already")
        self.set_mode(Mode.PROFILE_POSITION)
        self.set(objects.PROFILE_VELOCITY, velocity)
        self.set(objects.PROFILE_ACCELERATION, acceleration)
        self.set(objects.PROFILE_DECELERATION, acceleration)
        self.set(objects.TARGET_POSITION, target, always=True)
        distance = abs(target - self._sampler.position_counts)
        limited_before = self._sampler.statusword & Status.INTERNAL_LIMIT
        self._queued = None
        flags = Control(0) if after_the_present else Control.CHANGE_IMMEDIATELY
        self._hand_over(flags, way, wait_until_free=not after_the_present)
        self._going = (*self._going[-1:], target) if after_the_present else (target,)
        if self._sampler.statusword & Status.INTERNAL_LIMIT and not limited_before:
            self._refuse_limited(target)
        if after_the_present:
            self._queued = _Queued(target, bool(limited_before))
        elif distance > self._position_window():
            # a drive may show the arrival of the move before for a cycle or two
            self._await_status(lambda status: not status & Status.TARGET_REACHED, 0.05, way)

    def _way(self, target: int, velocity: int, acceleration: int) -> _Way | None:
        """From where the axis is to the target, by way of those that the drive holds, and what it needs to brake; None for an axis in
        another mode, whose motion until the set-point is taken has no end that is known."""
        if self.mode is not Mode.PROFILE_POSITION:
            return None
        here = self._sampler.position_counts
        places = (here, target, *self._going)
        fastest = max(velocity, self._written.get(objects.PROFILE_VELOCITY, 0))
        speed = abs(self._sampler.values.get(objects.VELOCITY_ACTUAL, fastest))
        beyond = self._strays + speed * speed // (2 * acceleration)
        return _Way(min(places) - beyond, max(places) + beyond, target)

    def look(self, status: int) -> None:
        """Evaluate a sample: a following set-point that the drive has begun. Raises LimitError once, with the axis halted, where the
        drive limits it."""
        queued = self._queued
        if queued is None:
            return
        if self.mode is not Mode.PROFILE_POSITION or decode_state(status) is not DriveState.ENABLED:
            self._queued = None
        elif _acknowledged(status):  # it waits
            self._queued = replace(queued, limited=bool(status & Status.INTERNAL_LIMIT))
        else:
            self._queued = None
            if status & Status.INTERNAL_LIMIT and not queued.limited:
                self._refuse_limited(queued.target)

    def _refuse_limited(self, target: int) -> None:
        """The drive limits this target to its own software limits: stop instead of arriving elsewhere. Raises LimitError."""
        self.halt()
        low, high = self._sdo.read_or(objects.SOFTWARE_LIMIT_MIN, 0), self._sdo.read_or(objects.SOFTWARE_LIMIT_MAX, 0)
        raise LimitError(
            f"{self._sdo.name}: the drive limits the target {target} to its own software limits (607Dh) {low} to {high}"
        )

    def _position_window(self) -> int:
        window = self._written.get(objects.POSITION_WINDOW)
        if window is None:
            window = self._written[objects.POSITION_WINDOW] = self._sdo.read_or(objects.POSITION_WINDOW, 0)
        return window

    def _hand_over(self, flags: Control, way: _Way | None, *, wait_until_free: bool) -> None:
        """The set-point handshake: bit 4 up, acknowledged by bit 12, bit 4 down, bit 12 down when a further one can be taken.

        Raises ProtocolError where a step is not acknowledged in time."""
        name, timeout_s = self._sdo.name, self._handshake_s
        if self._power.controlword != RUN:
            self._power.write(RUN)
            self.halted = False
        if wait_until_free and not self._await_status(_not_acknowledged, timeout_s, way):
            raise ProtocolError(f"{name}: set-point acknowledge (bit 12) stays set, no set-point can be given")
        self._power.write(RUN | Control.NEW_SETPOINT | flags)
        taken = self._await_status(_acknowledged, timeout_s, way)
        self._power.write(RUN)
        if not taken:
            raise ProtocolError(f"{name}: the set-point was not acknowledged within {timeout_s:g} s")
        if wait_until_free:
            self._await_status(_not_acknowledged, timeout_s, way)

    def _await_status(self, condition: Callable[[int], bool], timeout_s: float, way: _Way | None = None) -> bool:
        """Sample statusword and position; False when the condition did not hold in time. Raises DriveFaultError when a fault comes,
        FollowingErrorError when the axis leaves its path."""
        deadline = self._clock.deadline(timeout_s)
        while True:
            self._sampler.refresh()
            status = self._sampler.statusword
            state = decode_state(status)
            if state in FAULTS:
                code = self._power.error_code()
                text = error_text(code) if code else "no error code"
                raise DriveFaultError(f"{self._sdo.name} went into {state.value}: {text}", code)
            if way is not None and not way.low <= self._sampler.position_counts <= way.high:
                raise FollowingErrorError(
                    f"{self._sdo.name}: it was given the target {way.target} and moves elsewhere, to {self._sampler.position_counts}:"
                    " another master moves it, or it does not obey"
                )
            if condition(status):
                return True
            if deadline.expired:
                return False
            self._clock.sleep_until_ns(min(deadline.end_ns, self._clock.now_ns() + round(POLL_S * NS_PER_S)))

    # -- profile velocity, halt --------------------------------------------------------------------------------------------
    def run_at(self, velocity: int, acceleration: int) -> None:
        """Profile velocity, signed counts/s."""
        self.set(objects.PROFILE_ACCELERATION, acceleration)
        self.set(objects.PROFILE_DECELERATION, acceleration)
        self.set_mode(Mode.PROFILE_VELOCITY)
        if self._power.controlword != RUN:
            self._power.write(RUN)
            self.halted = False
        self.set(objects.TARGET_VELOCITY, velocity, always=True)

    def halt(self) -> None:
        """Set the halt bit: stop with the ramp of 605Dh and stay enabled; the order in progress is kept for `resume`."""
        self._power.write(RUN | Control.HALT)
        self.halted = True

    def resume(self) -> None:
        """Clear the halt bit: the drive continues the order in progress."""
        self._power.write(RUN)
        self.halted = False


def _acknowledged(status: int) -> bool:
    return bool(status & Status.SETPOINT_ACKNOWLEDGE)


def _not_acknowledged(status: int) -> bool:
    return not status & Status.SETPOINT_ACKNOWLEDGE
