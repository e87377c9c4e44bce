"""Profile motion in the drive's own units: set-point handshake, moves by set-points, halt.

Holds the mode-specific bits of controlword and statusword, and their objects. Limits and millimetres are in `drive`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from drivers.canopen.kept_settings import KeptSettings
from drivers.canopen.modes import POLL_S, OperationModes
from drivers.canopen.own_limits import OwnLimits
from drivers.canopen.power import PowerStage
from drivers.canopen.sampling import Sampler
from drivers.canopen.sdo import SdoClient
from drivers.canopen.streamed_move import FEED_S, StreamedMove
from drivers.cia402 import objects, words
from drivers.cia402.error_codes import error_text
from drivers.cia402.modes import Mode
from drivers.cia402.state_machine import Command, Control, Status, decode_state
from drivers.clock import NS_PER_S, Clock
from drivers.drive import FAULTS, DriveState
from drivers.errors import AbortError, DriveFaultError, FollowingErrorError, LimitError, ProtocolError
from drivers.scaling import LARGEST_POSITION, MotionScaling
from drivers.standstill import Standstill, arrived_within_counts

RUN = Command.ENABLE_OPERATION.word
FREE_S = 0.05
"""Time in which a drive takes bit 12 back once bit 4 has fallen, s: five slow control cycles. The next set-point waits longer."""
BEGUN_S = 0.05
"""Time in which a drive takes back the arrival of the move before, s: five slow control cycles."""


@dataclass(frozen=True)
class _Way:
    """Positions that an axis may be seen at while a set-point is handed over, counts."""

    low: int
    high: int
    target: int


@dataclass
class _GivenMove:
    """A set-point that the drive has taken, counts. shown: bit 10 fell at its begin, so that the drive shows its end. judged: bit 11
    was compared with it."""

    target: int
    shown: bool = True
    judged: bool = False


@dataclass(frozen=True)
class MotionParts:
    """What the motions of one open drive are ordered by. units: of its velocities and accelerations; notes: where what is used instead
    of what it lacks is told, one sentence each."""

    sdo: SdoClient
    power: PowerStage
    sampler: Sampler
    kept: KeptSettings
    modes: OperationModes
    limits: OwnLimits
    units: MotionScaling
    notes: list[str]


class ProfileMotion:
    """Motion orders to one open drive. handshake_s: longest time for the acknowledgement, s. strays: how far outside its path an axis
    may be meanwhile, counts.

    A move is given to a drive with profile position and fed to one without it; `_move` is the one in progress.
    """

    def __init__(self, parts: MotionParts, clock: Clock, *, handshake_s: float, strays: int) -> None:
        self._sdo, self._power, self._sampler = parts.sdo, parts.power, parts.sampler
        self._kept, self._modes, self._limits = parts.kept, parts.modes, parts.limits
        self._units = parts.units
        self._notes = parts.notes
        self._clock = clock
        self._handshake_s = handshake_s
        self._strays = strays
        window_counts = words.window(self._sdo.read_if_shown(objects.POSITION_WINDOW, 0)) or 0
        self._near_counts = arrived_within_counts(self._units.scaling.counts_per_load_mm, window_counts)
        self._move: _GivenMove | StreamedMove | None = None

    # -- modes -----------------------------------------------------------------------------------------------------------
    def set_mode(self, mode: Mode, *, until_enabled: bool = False) -> None:
        """Change the mode of operation; the controlword is not written, so the axis stays held. until_enabled: see
        `OperationModes.change`.

        Set-points of the new mode are first made to mean "stay". Raises CapabilityError for a mode that the drive does not have,
        ProtocolError when it does not follow.
        """
        self._modes.require(mode)
        if self._modes.mode is mode:
            return
        if mode not in (Mode.PROFILE_POSITION, Mode.HOMING):
            self.stay()
        self._move = None
        self._modes.change(mode, until_enabled=until_enabled)

    def stay(self) -> None:
        """Write set-points that move nothing: target position := actual position, target velocity and torque := 0."""
        self._move = None
        has, write = self._modes.has, self._kept.set
        here = self._sdo.read(objects.POSITION_ACTUAL)
        if has(Mode.PROFILE_POSITION) or has(Mode.CYCLIC_POSITION):
            write(objects.TARGET_POSITION, here, always=True)
        if has(Mode.INTERPOLATED_POSITION):
            with suppress(AbortError):  # some take it in that mode only
                write(objects.INTERPOLATION_TARGET, here, always=True)
        if has(Mode.PROFILE_VELOCITY) or has(Mode.CYCLIC_VELOCITY):
            write(objects.TARGET_VELOCITY, 0, always=True)
        if has(Mode.CYCLIC_TORQUE):
            write(objects.TARGET_TORQUE, 0, always=True)

    # -- moves -----------------------------------------------------------------------------------------------------------
    def move(self, target: int, velocity: int, acceleration: int) -> None:
        """Give an absolute set-point, counts and the drive's units of velocity and acceleration; returns once it is acknowledged.

        It replaces the move in progress. Raises LimitError when the drive limits the target, ProtocolError for a handshake that is not
        acknowledged, FollowingErrorError for an axis that moves elsewhere meanwhile, DriveFaultError.
        """
        if self._modes.resting is Mode.PROFILE_POSITION:
            self._give(target, velocity, acceleration)
        else:
            self._begin_feeding(target, velocity, acceleration)

    def arrived(self) -> bool | None:
        """Of a move that is fed, or one whose begin did not clear bit 10: whether the axis is at its target; None where the drive
        itself says it (bit 10)."""
        move = self._move
        if move is None or (isinstance(move, _GivenMove) and move.shown):
            return None
        speed = self._units.mm_s(self._sampler.values.get(objects.VELOCITY_ACTUAL, 0))
        at_rest = (isinstance(move, _GivenMove) or move.fed) and Standstill.is_slow(speed)
        return at_rest and abs(self._sampler.position_counts - move.target) <= self._near_counts

    def look(self, status: int) -> None:
        """Evaluate a sample: bit 11 on the way to a target, see `_judge_limit`. The next set-point of a move that is fed goes out
        here; a stop or a halt ends it."""
        enabled = decode_state(status) is DriveState.ENABLED
        if isinstance(self._move, StreamedMove):
            if self._power.stopped or not enabled or self._power.controlword & Control.HALT:
                self._move = None
            else:
                self._feed(self._move)
        elif enabled and self._modes.mode is Mode.PROFILE_POSITION:
            self._judge_limit(status)

    # -- given to the drive: profile position ------------------------------------------------------------------------------
    def _give(self, target: int, velocity: int, acceleration: int) -> None:
        way = self._way(target, velocity, acceleration)
        self.set_mode(Mode.PROFILE_POSITION)
        self._kept.set(objects.PROFILE_VELOCITY, velocity)
        self._limits.set_ramps(acceleration)
        self._kept.set(objects.TARGET_POSITION, target, always=True)
        distance = abs(target - self._sampler.position_counts)
        self._hand_over(way)
        move = self._move = _GivenMove(target)
        self._judge_limit(self._sampler.statusword)
        if distance > self._near_counts:
            # a drive may show the arrival of the move before for a cycle or two; one that shows it all the time is not believed
            move.shown = self._await_bit(Status.TARGET_REACHED, 0, BEGUN_S, way)

    def _way(self, target: int, velocity: int, acceleration: int) -> _Way | None:
        """From where the axis is to the target, by way of the one that it moves to, and what it needs to brake; None for an axis in
        another mode, whose motion until the set-point is taken has no end that is known."""
        if self._modes.mode is not Mode.PROFILE_POSITION:
            return None
        here = self._sampler.position_counts
        places = (here, target, *(() if self._move is None else (round(self._move.target),)))
        fastest = max(velocity, self._kept.written.get(objects.PROFILE_VELOCITY, 0))
        speed = abs(self._sampler.values.get(objects.VELOCITY_ACTUAL, fastest))
        speed_counts, ramp_counts = speed * self._units.velocity.counts, acceleration * self._units.acceleration.counts
        beyond = self._strays + round(speed_counts * speed_counts / (2 * ramp_counts))
        return _Way(min(places) - beyond, max(places) + beyond, target)

    def _judge_limit(self, status: int) -> None:
        """Bit 11 has many causes, such as current or velocity: it means 607Dh where the target lies outside. Then the axis is halted
        instead of arriving elsewhere, and LimitError is raised once; else it is noted."""
        move = self._move
        if not isinstance(move, _GivenMove) or move.judged or not status & Status.INTERNAL_LIMIT:
            return
        move.judged, read = True, self._sdo.read_if_shown
        most = LARGEST_POSITION
        low, high = read(objects.SOFTWARE_LIMIT_MIN, -most - 1), read(objects.SOFTWARE_LIMIT_MAX, most)
        if words.software_limits(low, high) is not None:
            home = read(objects.HOME_OFFSET, 0)  # the standard shifts the limits by it, not every drive does
            if not max(low, low - home) <= move.target <= min(high, high - home):
                self.halt()
                raise LimitError(
                    f"{self._sdo.name}: the drive limits the target {move.target} to its own software limits (607Dh) {low} to {high}"
                )
        said = (
            f"{self._sdo.name} shows an internal limit (bit 11 of the statusword) on the way to a target that 607Dh allows:"
            " its current or velocity may be limited; the move goes on"
        )
        if said not in self._notes:
            self._notes.append(said)

    def _hand_over(self, way: _Way | None) -> None:
        """The set-point handshake: bit 4 up, acknowledged by bit 12, bit 4 down, bit 12 down when a further one can be taken.

        Raises ProtocolError where a step is not acknowledged in time."""
        name, timeout_s = self._sdo.name, self._handshake_s
        if self._power.controlword != RUN:
            self._power.write(RUN)
        if not self._await_bit(Status.SETPOINT_ACKNOWLEDGE, 0, timeout_s, way):
            raise ProtocolError(f"{name}: set-point acknowledge (bit 12) stays set, no set-point can be given")
        self._power.write_edge(RUN | Control.NEW_SETPOINT | Control.CHANGE_IMMEDIATELY)
        taken = self._await_bit(Status.SETPOINT_ACKNOWLEDGE, 1, timeout_s, way)
        self._power.write(RUN)
        if not taken:
            raise ProtocolError(f"{name}: the set-point was not acknowledged within {timeout_s:g} s")
        # some hold bit 12 until the arrival: the axis is not left unwatched for that
        self._await_bit(Status.SETPOINT_ACKNOWLEDGE, 0, min(FREE_S, timeout_s), way)

    def _await_bit(self, bit: Status, value: int, timeout_s: float, way: _Way | None) -> bool:
        """Sample statusword and position; False when the bit has not this value in time. Raises DriveFaultError when a fault comes,
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
            if bool(status & bit) == bool(value):
                return True
            if deadline.expired:
                return False
            self._clock.sleep_until_ns(min(deadline.end_ns, self._clock.now_ns() + round(POLL_S * NS_PER_S)))

    # -- fed with set-points: a drive without profile position -------------------------------------------------------------
    def _begin_feeding(self, target: int, velocity: int, acceleration: int) -> None:
        mode = self._modes.resting
        changed = self._modes.mode is not mode
        self.set_mode(mode)
        if not isinstance(self._move, StreamedMove):
            with suppress(AbortError):  # 60C2h is optional, and fixed in some drives
                self._kept.set(objects.INTERPOLATION_PERIOD, round(1000 * FEED_S))
                self._kept.set(objects.INTERPOLATION_EXPONENT, -3)
            self._move = StreamedMove(self._sampler.position_counts, self._clock.now_ns(), self._interpolated_s())
        speed, ramp = self._units.velocity.counts, self._units.acceleration.counts
        self._move.go(target, velocity * float(speed), acceleration * float(ramp))
        if changed or self._power.controlword != self._run_word:
            self._power.write(RUN)  # in homing mode bit 4 had another meaning
            self._power.write(self._run_word)

    def _interpolated_s(self) -> float:
        """60C2h, s, at most `FEED_S`."""
        value = self._sdo.read_if_shown(objects.INTERPOLATION_PERIOD, 0)
        exponent = self._sdo.read_if_shown(objects.INTERPOLATION_EXPONENT, -3)
        return min(FEED_S, value * 10.0**exponent) if value > 0 and exponent < 0 else FEED_S

    @property
    def _run_word(self) -> int:
        return RUN | Control.INTERPOLATE if self._modes.mode is Mode.INTERPOLATED_POSITION else RUN

    def _feed(self, move: StreamedMove) -> None:
        place = move.step(self._clock.now_ns())
        if place is not None:
            interpolated = self._modes.mode is Mode.INTERPOLATED_POSITION
            entry = objects.INTERPOLATION_TARGET if interpolated else objects.TARGET_POSITION
            self._kept.set(entry, place, always=True)

    # -- halt ------------------------------------------------------------------------------------------------------------
    def halt(self) -> None:
        """Set the halt bit: stop with the ramp of 605Dh and stay enabled."""
        self._power.write(RUN | Control.HALT)
