"""Profile motion in the drive's own units: set-point handshake, halt, mode changes that keep the axis held.

Holds the mode-specific bits of controlword and statusword, and their objects. Limits and millimetres are in `drive`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from drivers import cia402_words
from drivers.canopen import objects
from drivers.canopen.cia402 import Command, Control, Mode, Status, decode_state
from drivers.canopen.node import error_text
from drivers.canopen.objects import Entry
from drivers.canopen.power import PowerStage
from drivers.canopen.sampling import Sampler
from drivers.canopen.sdo import SdoClient
from drivers.canopen.sdo_transfer import OBJECT_MISSING
from drivers.canopen.streamed_move import FEED_S, StreamedMove
from drivers.clock import NS_PER_S, Clock
from drivers.drive import FAULTS, WITHOUT_POWER, DriveState
from drivers.errors import (
    AbortError,
    CapabilityError,
    DriveFaultError,
    FollowingErrorError,
    LimitError,
    ProtocolError,
)
from drivers.scaling import MotionScaling
from drivers.standstill import Standstill, arrived_within_counts
from drivers.undo import undo_all

POLL_S = 0.001
RUN = Command.ENABLE_OPERATION.word


def mode_of(shown: int) -> Mode:
    """The mode of 6061h; manufacturer modes and unknown ones are NONE."""
    try:
        return Mode(shown)
    except ValueError:
        return Mode.NONE


TARGETS = (
    objects.TARGET_POSITION,
    objects.TARGET_VELOCITY,
    objects.TARGET_TORQUE,
    objects.INTERPOLATION_TARGET,
)
"""Set-points; they are never put back."""


SAME_SHARE = 1e-3
"""Share by which a drive's own limit may lie below the axis file's without a note: rounding to its units."""
TRY_S = 0.05
"""Time in which a drive at rest shows a mode that it takes, s: five slow control cycles."""
FREE_S = 0.05
"""Time in which a drive takes bit 12 back once bit 4 has fallen, s: five slow control cycles. The next set-point waits longer."""


HOLDING = (0, Mode.PROFILE_POSITION, Mode.CYCLIC_POSITION, Mode.INTERPOLATED_POSITION)
"""Modes of 6061h in which an axis whose target is its position is enabled safely."""
OUT_OF_RANGE = (0x06090030, 0x06090031)
LEFT_OUT = (0x06010002, *OBJECT_MISSING)
"""Read-only, no such object, no such subindex."""
TRIED_MODES = (
    Mode.PROFILE_POSITION,
    Mode.PROFILE_VELOCITY,
    Mode.HOMING,
    Mode.INTERPOLATED_POSITION,
    Mode.CYCLIC_POSITION,
)


@dataclass(frozen=True)
class _Way:
    """Positions that an axis may be seen at while a set-point is handed over, counts."""

    low: int
    high: int
    target: int


class ProfileMotion:
    """Motion orders to one open drive. handshake_s and mode_s: longest time for the acknowledgement, s. strays: how far outside its
    path an axis may be meanwhile, counts. units: of its velocities and accelerations. modes: of 6060h, where the axis file names
    them. highest: largest value that the maker's file allows for an object, None without one.

    notes: what is used instead of what the drive lacks, one sentence each.
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
        units: MotionScaling,
        modes: Sequence[int] = (),
        highest: Callable[[Entry], float | None] = lambda _entry: None,
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
        self._units = units
        self._highest = highest
        self._left_out: set[Entry] = set()
        self._noted: set[tuple[Entry, int]] = set()
        self._limits: dict[Entry, int] = {}  # of the drive's own, as far as it states them
        self.notes: list[str] = []
        self.mode = mode_of(sdo.read(objects.MODE_DISPLAY))
        self._window = cia402_words.window(sdo.read_if_shown(objects.POSITION_WINDOW, 0)) or 0  # counts
        self.supported_modes = self._modes(modes)
        self.halted = False
        self.mode_unseen = False  # 6061h did not follow 6060h yet
        self._unshown: int | None = None  # target of a move whose begin did not clear bit 10
        self._streamed: StreamedMove | None = None  # of a drive without profile position
        self._going: tuple[int, ...] = ()  # target of the move in progress
        self._judged = False  # bit 11 was compared with it

    def supports(self, mode: Mode) -> bool:
        """Whether 6502h lists the mode."""
        return bool(self.supported_modes & mode.supported_bit)

    # -- modes -----------------------------------------------------------------------------------------------------------
    def _modes(self, named: Sequence[int]) -> int:
        """6502h, else the modes that the axis file names, else those that the drive takes at standstill; as bits of 6502h."""
        told = self._sdo.read_if_shown(objects.SUPPORTED_MODES, 0)
        if told:
            return told
        if named:
            return sum(1 << (mode - 1) for mode in set(named) if mode > 0)
        found = self._tried_modes()
        names = ", ".join(mode.name.lower().replace("_", " ") for mode in found) or "none"
        how = "by trial at standstill" if found else "and it took none at standstill"
        self.notes.append(f"{self._sdo.name} does not say its modes (6502h); {how}: {names}")
        return sum(mode.supported_bit for mode in found)

    def _tried_modes(self) -> list[Mode]:
        """Modes that 6061h shows once they are written to 6060h. An axis under power is not tried with: it has the present mode."""
        if not 0 <= self._sdo.read_if_shown(objects.MODE, self.mode) <= max(Mode):
            return []  # a maker's own mode could perhaps not be put back
        if not self._is_off():
            return [self.mode] if self.mode is not Mode.NONE else []
        found: list[Mode] = []
        try:
            for mode in TRIED_MODES:
                try:
                    self._remember(objects.MODE)
                    self._sdo.write(objects.MODE, mode)
                except AbortError:
                    continue
                if self._shown_mode(mode, TRY_S) == mode:
                    found.append(mode)
        finally:
            undo_all([("", self.put_back)])
        return found

    def _shown_mode(self, mode: Mode, within_s: float) -> int:
        deadline = self._clock.deadline(within_s)
        while (shown := self._sdo.read(objects.MODE_DISPLAY)) != mode and not deadline.expired:
            self._clock.sleep_s(POLL_S)
        return shown

    def set_mode(self, mode: Mode, *, until_enabled: bool = False) -> None:
        """Change the mode of operation and see it confirmed (6061h); the controlword is not written, so the axis stays held.
        until_enabled: a drive without power may show it later, see `see_mode`.

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
        self._going, self._streamed, self._unshown = (), None, None
        self._sdo.write(objects.MODE, mode)
        shown = self._shown_mode(mode, self._mode_s)
        self.mode_unseen = shown != mode
        if self.mode_unseen and not (until_enabled and shown in HOLDING and self._is_off()):
            self.mode_unseen = False
            raise self._not_followed(mode, shown)
        self.mode = mode

    def see_mode(self) -> None:
        """Make sure of a mode that was not shown while the drive was off: some show it once they are enabled.

        Raises ProtocolError."""
        if self.mode_unseen:
            shown = self._shown_mode(self.mode, self._mode_s)
            if shown != self.mode:
                raise self._not_followed(self.mode, shown)
            self.mode_unseen = False

    def _is_off(self) -> bool:
        """Whether the drive is without power for another reason than a fault."""
        state = decode_state(self._sdo.read(objects.STATUSWORD))
        return state in WITHOUT_POWER and state not in FAULTS

    def _not_followed(self, mode: Mode, shown: int) -> ProtocolError:
        return ProtocolError(f"{self._sdo.name}: mode {mode} was written, {objects.MODE_DISPLAY} stays {shown}")

    @property
    def streaming_mode(self) -> Mode | None:
        """The mode of set-point streams: cyclic synchronous position, else interpolated position; None without either."""
        for mode in (Mode.CYCLIC_POSITION, Mode.INTERPOLATED_POSITION):
            if self.supports(mode):
                return mode
        return None

    @property
    def resting_mode(self) -> Mode:
        """The mode in which an axis is enabled and held: profile position, else one by set-points.

        Raises CapabilityError for a drive without any of them."""
        for mode in (Mode.PROFILE_POSITION, Mode.CYCLIC_POSITION, Mode.INTERPOLATED_POSITION):
            if self.supports(mode):
                return mode
        raise CapabilityError(
            f"{self._sdo.name} has no mode that moves an axis here (6502h is {self.supported_modes:X}h)"
        )

    def stay(self) -> None:
        """Write set-points that move nothing: target position := actual position, target velocity and torque := 0."""
        self._going = ()
        self._streamed = self._unshown = None
        here = self._sdo.read(objects.POSITION_ACTUAL)
        if self.supports(Mode.PROFILE_POSITION) or self.supports(Mode.CYCLIC_POSITION):
            self.set(objects.TARGET_POSITION, here, always=True)
        if self.supports(Mode.INTERPOLATED_POSITION):
            with suppress(AbortError):  # some take it in that mode only
                self.set(objects.INTERPOLATION_TARGET, here, always=True)
        if self.supports(Mode.PROFILE_VELOCITY) or self.supports(Mode.CYCLIC_VELOCITY):
            self.set(objects.TARGET_VELOCITY, 0, always=True)
        if self.supports(Mode.CYCLIC_TORQUE):
            self.set(objects.TARGET_TORQUE, 0, always=True)

    def set(self, entry: Entry, value: int, *, always: bool = False) -> None:
        """Write an object unless it is known to hold the value already. Raises as `SdoClient.write`."""
        if always or self._written.get(entry) != value:
            self._written.pop(entry, None)
            known = entry in self._found
            self._remember(entry)
            try:
                self._sdo.write(entry, value)
            except AbortError:
                if not known:  # refused, so there is nothing to put back
                    self._found.pop(entry, None)
                raise
            self._written[entry] = value

    def _remember(self, entry: Entry) -> None:
        if entry in self._found or entry in TARGETS:
            return
        try:
            self._found[entry] = self._sdo.read(entry)
        except AbortError:
            if entry is not objects.MODE:
                raise
            self._found[entry] = self._sdo.read(objects.MODE_DISPLAY)  # 6060h may be write-only

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
    def move(self, target: int, velocity: int, acceleration: int) -> None:
        """Give an absolute set-point, counts and the drive's units of velocity and acceleration; returns once it is acknowledged.

        It replaces the move in progress. Raises LimitError when the drive limits the target, ProtocolError for a handshake that is not
        acknowledged, FollowingErrorError for an axis that moves elsewhere meanwhile, DriveFaultError.
        """
        if not self.supports(Mode.PROFILE_POSITION) and self.streaming_mode is not None:
            self._move_by_set_points(target, velocity, acceleration)
            return
        way = self._way(target, velocity, acceleration)
        self.set_mode(Mode.PROFILE_POSITION)
        self.set(objects.PROFILE_VELOCITY, velocity)
        self._set_ramps(acceleration)
        self.set(objects.TARGET_POSITION, target, always=True)
        distance, self._unshown, self._judged = abs(target - self._sampler.position_counts), None, False
        self._hand_over(way)
        self._going = (target,)
        self._judge_limit(self._sampler.statusword)
        if distance > self._near_counts():
            # a drive may show the arrival of the move before for a cycle or two; one that shows it all the time is not believed
            fell = self._await_status(lambda status: not status & Status.TARGET_REACHED, 0.05, way)
            self._unshown = None if fell else target

    # -- limits of the drive -----------------------------------------------------------------------------------------------
    def _limit(self, entry: Entry) -> int:
        """A limit that the drive states, in its units; 0 where it states none."""
        if entry not in self._limits:
            self._limits[entry] = cia402_words.limit(self._sdo.read_if_shown(entry, 0)) or 0
        return self._limits[entry]

    def note_limits(self, velocity_mm_s: float, acceleration_mm_s2: float) -> None:
        """Read the drive's own limits and ramps, and note where they are below the axis file's (mm/s, mm/s²). Nothing is written."""
        largest = self._limit(objects.MAX_PROFILE_VELOCITY)
        if largest and self._units.mm_s(largest) < velocity_mm_s * (1 - SAME_SHARE):
            self.notes.append(
                f"{self._sdo.name} allows {self._units.mm_s(largest):.4g} mm/s (607Fh), the axis file {velocity_mm_s:g} mm/s:"
                " faster moves are refused"
            )
        for entry, limit in (
            (objects.PROFILE_ACCELERATION, objects.MAX_ACCELERATION),
            (objects.PROFILE_DECELERATION, objects.MAX_DECELERATION),
        ):
            try:
                self._sdo.read(entry)
            except AbortError as error:
                if error.code in LEFT_OUT:
                    self._leave_out(entry)
                    continue
            self._allowed_ramp(entry, limit, self._units.acceleration_units(acceleration_mm_s2))

    def _leave_out(self, entry: Entry) -> None:
        self._left_out.add(entry)
        which = "6083h serves both ramps" if entry is objects.PROFILE_DECELERATION else "its own ramp holds"
        self.notes.append(f"{self._sdo.name} does not take {entry}: {which}")

    def _allowed_ramp(self, entry: Entry, largest: Entry, acceleration: int) -> int:
        """The ramp that the drive allows, in its units; noted once where that is less."""
        value = acceleration
        for limit in (self._limit(largest), self._limits.get(entry, 0), self._highest(entry), entry.type.range[1]):
            if limit:
                value = min(value, int(limit))
        if value < acceleration and (entry, value) not in self._noted:
            self._noted.add((entry, value))
            self.notes.append(
                f"{self._sdo.name} allows {self._units.mm_s2(value):.4g} mm/s² ({entry}) instead of the axis file's"
                f" {self._units.mm_s2(acceleration):.4g} mm/s²: moves use what it allows"
            )
        return value

    def check_velocity(self, velocity: int) -> None:
        """Raise LimitError for a velocity that the drive would limit in silence (607Fh) or refuse (its maker's file)."""
        written = objects.PROFILE_VELOCITY if self.mode is not Mode.PROFILE_VELOCITY else objects.TARGET_VELOCITY
        limits = [
            (float(self._limit(objects.MAX_PROFILE_VELOCITY)), "607Fh"),
            (self._highest(written), "its maker's file"),
            (written.type.range[1], f"{written} holds no more"),
        ]
        for limit, source in limits:
            if limit and velocity > limit:
                raise LimitError(
                    f"{self._sdo.name}: {self._units.mm_s(velocity):.4g} mm/s is more than its drive allows,"
                    f" {self._units.mm_s(limit):.4g} mm/s ({source})"
                )

    def _set_ramps(self, acceleration: int) -> None:
        """6083h and 6084h, as far as the drive has them and lets them: a lower limit of its own is respected, and noted."""
        self._set_ramp(objects.PROFILE_ACCELERATION, objects.MAX_ACCELERATION, acceleration)
        self._set_ramp(objects.PROFILE_DECELERATION, objects.MAX_DECELERATION, acceleration)

    def _set_ramp(self, entry: Entry, largest: Entry, acceleration: int) -> None:
        """A ramp as far as the drive takes it: one that it calls out of range is halved until it is taken."""
        if entry in self._left_out:
            return
        lowered = False
        value = self._limits.get(entry) or self._allowed_ramp(entry, largest, acceleration)
        value = min(value, acceleration)
        while True:
            try:
                self.set(entry, value)
                break
            except AbortError as error:
                if error.code in LEFT_OUT:
                    self._leave_out(entry)
                    return
                if error.code not in OUT_OF_RANGE or value <= 1:
                    raise
                value, lowered = max(1, value // 2), True
        if lowered:
            self._limits[entry] = value
            self._allowed_ramp(entry, largest, acceleration)

    # -- moves by set-points, without profile position -----------------------------------------------------------------------
    def _move_by_set_points(self, target: int, velocity: int, acceleration: int) -> None:
        changed = self.mode is not self.resting_mode
        self.set_mode(self.resting_mode)
        now_ns = self._clock.now_ns()
        if self._streamed is None:
            with suppress(AbortError):  # 60C2h is optional, and fixed in some drives
                self.set(objects.INTERPOLATION_PERIOD, round(1000 * FEED_S))
                self.set(objects.INTERPOLATION_EXPONENT, -3)
            self._streamed = StreamedMove(self._sampler.position_counts, now_ns, self._interpolated_s())
        counts = self._units
        self._streamed.go(
            target, velocity * float(counts.velocity.counts), acceleration * float(counts.acceleration.counts)
        )
        if changed or self._power.controlword != self._run_word:
            self._power.write(RUN)  # in homing mode bit 4 had another meaning
            self._power.write(self._run_word)
            self.halted = False

    def _interpolated_s(self) -> float:
        """60C2h, s, at most `FEED_S`."""
        value = self._sdo.read_if_shown(objects.INTERPOLATION_PERIOD, 0)
        exponent = self._sdo.read_if_shown(objects.INTERPOLATION_EXPONENT, -3)
        return min(FEED_S, value * 10.0**exponent) if value > 0 and exponent < 0 else FEED_S

    @property
    def _run_word(self) -> int:
        return RUN | Control.INTERPOLATE if self.mode is Mode.INTERPOLATED_POSITION else RUN

    def arrived(self) -> bool | None:
        """Of a move by set-points, or one whose begin did not clear bit 10: whether the axis is at its target; None where the drive
        itself says it (bit 10)."""
        streamed = self._streamed
        target = self._unshown if streamed is None else streamed.target
        if target is None:
            return None
        speed = self._units.mm_s(self._sampler.values.get(objects.VELOCITY_ACTUAL, 0))
        at_rest = (streamed is None or streamed.fed) and Standstill.is_slow(speed)
        return at_rest and abs(self._sampler.position_counts - target) <= self._near_counts()

    def _near_counts(self) -> float:
        return arrived_within_counts(self._units.scaling.counts_per_load_mm, self._window)

    def _feed(self, status: int) -> None:
        """The next set-point of a move without profile position. A stop or a halt ends it."""
        streamed = self._streamed
        if streamed is None:
            return
        if self._power.stopped or decode_state(status) is not DriveState.ENABLED:
            self._streamed = None
            return
        if self.halted:
            streamed.rest(self._clock.now_ns())
            return
        place = streamed.step(self._clock.now_ns())
        if place is not None:
            entry = objects.INTERPOLATION_TARGET if self.mode is Mode.INTERPOLATED_POSITION else objects.TARGET_POSITION
            self.set(entry, place, always=True)

    def _way(self, target: int, velocity: int, acceleration: int) -> _Way | None:
        """From where the axis is to the target, by way of the one that it moves to, and what it needs to brake; None for an axis in
        another mode, whose motion until the set-point is taken has no end that is known."""
        if self.mode is not Mode.PROFILE_POSITION:
            return None
        here = self._sampler.position_counts
        places = (here, target, *self._going)
        fastest = max(velocity, self._written.get(objects.PROFILE_VELOCITY, 0))
        speed = abs(self._sampler.values.get(objects.VELOCITY_ACTUAL, fastest))
        speed_counts, ramp_counts = speed * self._units.velocity.counts, acceleration * self._units.acceleration.counts
        beyond = self._strays + round(speed_counts * speed_counts / (2 * ramp_counts))
        return _Way(min(places) - beyond, max(places) + beyond, target)

    def look(self, status: int) -> None:
        """Evaluate a sample: bit 11 on the way to a target, see `_judge_limit`. The next set-point of a move without profile position
        goes out here."""
        self._feed(status)
        if self.mode is Mode.PROFILE_POSITION and decode_state(status) is DriveState.ENABLED:
            self._judge_limit(status)

    def _judge_limit(self, status: int) -> None:
        """Bit 11 has many causes, such as current or velocity: it means 607Dh where the target lies outside. Then the axis is halted
        instead of arriving elsewhere, and LimitError is raised once; else it is noted."""
        if not (status & Status.INTERNAL_LIMIT and self._going) or self._judged:
            return
        self._judged, read = True, self._sdo.read_if_shown
        most = cia402_words.LARGEST_POSITION
        low, high = read(objects.SOFTWARE_LIMIT_MIN, -most - 1), read(objects.SOFTWARE_LIMIT_MAX, most)
        if cia402_words.software_limits(low, high) is not None:
            home = read(objects.HOME_OFFSET, 0)  # the standard shifts the limits by it, not every drive does
            for target in self._going:
                if not max(low, low - home) <= target <= min(high, high - home):
                    self.halt()
                    raise LimitError(
                        f"{self._sdo.name}: the drive limits the target {target} to its own software limits (607Dh) {low} to {high}"
                    )
        said = (
            f"{self._sdo.name} shows an internal limit (bit 11 of the statusword) on the way to a target that 607Dh allows:"
            " its current or velocity may be limited; the move goes on"
        )
        if said not in self.notes:
            self.notes.append(said)

    def _hand_over(self, way: _Way | None) -> None:
        """The set-point handshake: bit 4 up, acknowledged by bit 12, bit 4 down, bit 12 down when a further one can be taken.

        Raises ProtocolError where a step is not acknowledged in time."""
        name, timeout_s = self._sdo.name, self._handshake_s
        if self._power.controlword != RUN:
            self._power.write(RUN)
            self.halted = False
        if not self._await_status(_not_acknowledged, timeout_s, way):
            raise ProtocolError(f"{name}: set-point acknowledge (bit 12) stays set, no set-point can be given")
        self._power.write_edge(RUN | Control.NEW_SETPOINT | Control.CHANGE_IMMEDIATELY)
        taken = self._await_status(_acknowledged, timeout_s, way)
        self._power.write(RUN)
        if not taken:
            raise ProtocolError(f"{name}: the set-point was not acknowledged within {timeout_s:g} s")
        # some hold bit 12 until the arrival: the axis is not left unwatched for that
        self._await_status(_not_acknowledged, min(FREE_S, timeout_s), way)

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

    # -- halt --------------------------------------------------------------------------------------------
    def halt(self) -> None:
        """Set the halt bit: stop with the ramp of 605Dh and stay enabled; the order in progress is kept for `resume`."""
        self._power.write(RUN | Control.HALT)
        self.halted = True

    def resume(self) -> None:
        """Clear the halt bit: the drive continues the order in progress."""
        if self._streamed is not None:  # from where the halt brought it to rest
            self._streamed.place = self._sampler.position_counts
            self._power.write(self._run_word)
        else:
            self._power.write(RUN)
        self.halted = False


def _acknowledged(status: int) -> bool:
    return bool(status & Status.SETPOINT_ACKNOWLEDGE)


def _not_acknowledged(status: int) -> bool:
    return not status & Status.SETPOINT_ACKNOWLEDGE
