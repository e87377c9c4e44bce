"""GivenMove: a set-point in profile position, handed to the drive by its handshake; the drive makes the ramp and shows the end."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.cia402 import objects, words
from drivers.cia402.modes import Mode
from drivers.cia402.motion_parts import MotionParts, MoveOrder
from drivers.cia402.operation_modes import POLL_S
from drivers.cia402.power import RUN
from drivers.cia402.state_machine import Control, Status, decode_state
from drivers.clock import NS_PER_S
from drivers.drive import FAULTS, DriveState
from drivers.errors import FollowingErrorError, LimitError, ProtocolError
from drivers.scaling import LARGEST_POSITION
from drivers.standstill import Standstill

FREE_S = 0.05
"""Time in which a drive takes bit 12 back once bit 4 has fallen, s: five slow control cycles. The next set-point waits longer."""
BEGUN_S = 0.05
"""Time in which a drive takes back the arrival of the move before, s: five slow control cycles."""


@dataclass(frozen=True)
class Path:
    """Positions that an axis may be seen at while a set-point is handed over, counts."""

    low: int
    high: int


class GivenMove:
    """near_counts: largest distance of an arrival that the drive does not show."""

    def __init__(self, parts: MotionParts, order: MoveOrder, near_counts: float) -> None:
        self._parts = parts
        self._order = order
        self._near_counts = near_counts
        self._is_near = abs(order.counts - parts.image.position_counts) <= near_counts
        self._shown = True  # bit 10 fell at its begin, so that the drive shows its end
        self._judged = False  # bit 11 was compared with it

    @property
    def target_counts(self) -> int:
        return self._order.counts

    def path(self, replaced_counts: float | None) -> Path | None:
        """From where the axis is to the target, by way of the one that it moves to (replaced_counts), and what it needs to brake; None
        for an axis in another mode, whose motion until the set-point is taken has no end that is known."""
        parts, order = self._parts, self._order
        if parts.modes.mode is not Mode.PROFILE_POSITION:
            return None
        here = parts.image.position_counts
        places = (here, order.counts, *(() if replaced_counts is None else (round(replaced_counts),)))
        fastest = max(order.velocity, parts.kept.written.get(objects.PROFILE_VELOCITY, 0))
        speed = abs(parts.image.values.get(objects.VELOCITY_ACTUAL, fastest))
        speed_counts, ramp_counts = (
            speed * parts.units.velocity.counts,
            order.acceleration * parts.units.acceleration.counts,
        )
        beyond = parts.strays_counts + round(speed_counts * speed_counts / (2 * ramp_counts))
        return Path(min(places) - beyond, max(places) + beyond)

    def hand_over(self, path: Path | None) -> None:
        """Write the settings and the target, then the handshake: bit 4 up, acknowledged by bit 12, bit 4 down, bit 12 down when a
        further one can be taken.

        Raises ProtocolError where a step is not acknowledged in time, and as `_await_bit`."""
        parts, order = self._parts, self._order
        parts.kept.set(objects.PROFILE_VELOCITY, order.velocity)
        parts.limits.set_ramps(order.acceleration)
        parts.kept.set(objects.TARGET_POSITION, order.counts, always=True)
        name, timeout_s = parts.access.name, parts.handshake_s
        if parts.power.controlword != RUN:
            parts.power.write(RUN)
        if not self._await_bit(Status.SETPOINT_ACKNOWLEDGE, 0, timeout_s, path):
            raise ProtocolError(f"{name}: set-point acknowledge (bit 12) stays set, no set-point can be given")
        parts.power.write_edge(RUN | Control.NEW_SETPOINT | Control.CHANGE_IMMEDIATELY)
        taken = self._await_bit(Status.SETPOINT_ACKNOWLEDGE, 1, timeout_s, path)
        parts.power.write(RUN)
        if not taken:
            raise ProtocolError(f"{name}: the set-point was not acknowledged within {timeout_s:g} s")
        # some hold bit 12 until the arrival: the axis is not left unwatched for that
        self._await_bit(Status.SETPOINT_ACKNOWLEDGE, 0, min(FREE_S, timeout_s), path)

    def taken(self, path: Path | None) -> None:
        """To be called once it is the move in progress: see whether the drive limits it, and whether it shows its begin."""
        self._judge_limit(self._parts.image.statusword)
        if not self._is_near:
            # a drive may show the arrival of the move before for a cycle or two; one that shows it all the time is not believed
            self._shown = self._await_bit(Status.TARGET_REACHED, 0, BEGUN_S, path)

    def arrived(self) -> bool | None:
        """Whether the axis is at the target, of a move whose begin did not clear bit 10; None where bit 10 shows it."""
        if self._shown:
            return None
        image = self._parts.image
        speed = self._parts.units.mm_s(image.values.get(objects.VELOCITY_ACTUAL, 0))
        return Standstill.is_slow(speed) and abs(image.position_counts - self._order.counts) <= self._near_counts

    def look(self, status: int) -> bool:
        """Evaluate a sample; the move stays the one in progress. Raises LimitError, see `_judge_limit`."""
        if decode_state(status) is DriveState.ENABLED:
            self._judge_limit(status)
        return True

    def _judge_limit(self, status: int) -> None:
        """Bit 11 has many causes, such as current or velocity: it means 607Dh where the target lies outside. Then the axis is halted
        instead of arriving elsewhere, and LimitError is raised once; else it is noted."""
        if self._judged or not status & Status.INTERNAL_LIMIT:
            return
        parts, target = self._parts, self._order.counts
        self._judged, read = True, parts.access.read_if_shown
        most = LARGEST_POSITION
        low, high = read(objects.SOFTWARE_LIMIT_MIN, -most - 1), read(objects.SOFTWARE_LIMIT_MAX, most)
        if words.software_limits(low, high) is not None:
            home = read(objects.HOME_OFFSET, 0)  # the standard shifts the limits by it, not every drive does
            if not max(low, low - home) <= target <= min(high, high - home):
                parts.power.write(RUN | Control.HALT)
                raise LimitError(
                    f"{parts.access.name}: the drive limits the target {target} to its own software limits (607Dh) {low} to {high}"
                )
        said = (
            f"{parts.access.name} shows an internal limit (bit 11 of the statusword) on the way to a target that 607Dh allows:"
            " its current or velocity may be limited; the move goes on"
        )
        if said not in parts.notes:
            parts.notes.append(said)

    def _await_bit(self, bit: Status, value: int, timeout_s: float, path: Path | None) -> bool:
        """Sample statusword and position; False when the bit has not this value in time. Raises DriveFaultError when a fault comes,
        FollowingErrorError when the axis leaves its path."""
        parts, image = self._parts, self._parts.image
        deadline = parts.clock.deadline(timeout_s)
        while True:
            image.refresh()
            status = image.statusword
            state = decode_state(status)
            if state in FAULTS:
                raise parts.power.fault(f" went into {state.value}")
            if path is not None and not path.low <= image.position_counts <= path.high:
                raise FollowingErrorError(
                    f"{parts.access.name}: it was given the target {self._order.counts} and moves elsewhere, to"
                    f" {image.position_counts}: another master moves it, or it does not obey"
                )
            if bool(status & bit) == bool(value):
                return True
            if deadline.expired:
                return False
            parts.clock.sleep_until_ns(min(deadline.end_ns, parts.clock.now_ns() + round(POLL_S * NS_PER_S)))
