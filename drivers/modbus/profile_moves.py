"""Profile moves of a Modbus drive by the hand-shake of its register map; each step is confirmed.

Covers one move from its settings to the moment in which the axis starts. `drive` decides whether it may begin, and stops one that
was not confirmed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from drivers.errors import MotionTimeoutError
from drivers.limits import DriveLimits
from drivers.modbus.codec import Raw
from drivers.modbus.commands import hold
from drivers.modbus.drive_map import Handshake
from drivers.modbus.drive_values import Unit
from drivers.standstill import Standstill, arrived_within_counts


@dataclass(frozen=True)
class ProfileMove:
    """One move in motor counts, with the values to write; velocity of the load, mm/s."""

    start_counts: float
    target_counts: float
    velocity_mm_s: float
    written: dict[str, Raw]


class ProfileMoves:
    """The moves of one drive. under_way: the last move begun, None after another order has moved the axis. unshown: "in position" did
    not go at its begin, so that it does not tell its end."""

    def __init__(self, unit: Unit, limits: DriveLimits) -> None:
        self.under_way: ProfileMove | None = None
        self.unshown = False
        self._unit = unit
        self._limits = limits

    @contextmanager
    def target_kept(self) -> Iterator[None]:
        """Around writing the target: the one found is put back without power, not where that would start a move, nor after a
        refusal."""
        move = self._unit.map.move
        once = self._unit.commands.kept(move.target) or move.handshake is Handshake.ON_WRITE
        readable = self._unit.map.registers[move.target].readable
        found = self._unit.access.read([move.target]) if readable and not once else {}
        yield
        self._unit.commands.keep(found)

    def planned(self, position_load_mm: float, velocity_mm_s: float, raw: dict[str, Raw]) -> ProfileMove:
        """A move (mm, mm/s) from the position of a sample. Raises InputError for values outside its registers; writes nothing."""
        start_counts = self._unit.values.position_counts(raw)
        target_counts = float(self._unit.scaling.motor_counts(position_load_mm))
        written_counts = target_counts - start_counts if self._unit.map.move.relative else target_counts
        return ProfileMove(start_counts, target_counts, velocity_mm_s, self._profile(written_counts, velocity_mm_s))

    def _profile(self, target_counts: float, velocity_mm_s: float) -> dict[str, Raw]:
        """All settings of a move, speeds before the target, as some drives start on the target; neighbours are joined when written."""
        move = self._unit.map.move
        speed = {move.velocity: velocity_mm_s * self._unit.scaling.counts_per_load_mm}
        written = self._settings(speed | self._ramps(move.acceleration, move.deceleration))
        written[move.target] = self._unit.values.raw(target_counts, move.target)
        if not move.start:
            return written
        return dict(sorted(written.items(), key=lambda item: self._unit.map.registers[item[0]].span))

    def _ramps(self, *names: str | None) -> dict[str, float]:
        counts_s2 = self._limits.max_acceleration_mm_s2 * self._unit.scaling.counts_per_load_mm
        return {name: counts_s2 for name in names if name is not None}

    def _settings(self, wanted: dict[str, float]) -> dict[str, Raw]:
        """Speeds and ramps in counts -> raw, after keeping the earlier values."""
        self._unit.commands.remember(tuple(wanted))
        return {name: self._unit.values.raw_speed(counts, name) for name, counts in wanted.items()}

    def set_mode(self, raw: dict[str, Raw] | None = None) -> None:
        """Set the mode of operation for moves; raw: values read just now. Raises MotionTimeoutError."""
        move = self._unit.map.move
        self._unit.commands.set_mode(move.mode, move.mode_shown, move.timeout_s, raw)

    def make_ready(self, raw: dict[str, Raw]) -> None:
        """Set mode and hand-shake as a new target needs them. Raises MotionTimeoutError."""
        move = self._unit.map.move
        self.set_mode(raw)
        if not self._unit.commands.hold_now(move.idle, raw):
            self._unit.commands.give(move.release)
            self._unit.commands.wait_for(move.idle, "set-point hand-shake to be idle", move.timeout_s)

    def begin(self, planned: ProfileMove) -> None:
        """Start the move; returns when the axis has started. After an error it may be moving. Raises MotionTimeoutError,
        NoAnswerError."""
        move, commands = self._unit.map.move, self._unit.commands
        with self.target_kept():
            commands.write(planned.written)
        self.under_way, self.unshown = planned, False
        commands.start(move.start, "move", move.timeout_s, lambda: not self._reached_now())
        commands.wait_for(move.accepted, "new target to be accepted", move.timeout_s)
        commands.give(move.release)
        commands.wait_for(move.released, "set-point hand-shake to end", move.timeout_s)
        self._await_departure(planned)

    def reached(self, raw: dict[str, Raw]) -> bool:
        """Whether the drive shows "in position", and its position is the target of the move in progress."""
        move, values = self._unit.map.move, self._unit.values
        if not hold(move.reached, raw):
            return False
        if self.under_way is None or (move.window is None and not self.unshown):
            return True
        off_counts = abs(values.position_counts(raw) - self.under_way.target_counts)
        if not self.unshown:
            return off_counts <= values.window_counts()
        return off_counts <= self._near_counts() and Standstill.is_slow(
            values.load_mm(raw, self._unit.map.velocity) or 0.0
        )

    def _near_counts(self) -> float:
        """Largest distance of an arrival that the drive does not show, counts: one step of its position at least."""
        values, position = self._unit.values, self._unit.map.position
        step = abs(values.counts(1, position) - values.counts(0, position))
        return max(step, arrived_within_counts(self._unit.scaling.counts_per_load_mm, values.window_counts()))

    def _reached_now(self) -> bool:
        return self.reached(self._unit.access.read(self._unit.map.sampled()))

    def _await_departure(self, move: ProfileMove) -> None:
        """Wait until "in position" of the last move goes, so that it is not taken for the end of this one, unless it is `unshown`.

        Raises MotionTimeoutError when the drive accepted the target but does not move and shows "in position".
        """
        way_counts = abs(move.target_counts - move.start_counts)
        way_mm = abs(self._unit.scaling.load_mm(way_counts))
        ramps_s = 2.0 * move.velocity_mm_s / self._limits.max_acceleration_mm_s2
        longest_s = way_mm / move.velocity_mm_s + ramps_s + 0.05
        if way_counts <= self._unit.values.window_counts() or self._unit.commands.becomes(
            lambda: not self._reached_now(), min(longest_s, self._unit.map.move.timeout_s)
        ):
            return
        here = self._unit.values.position_counts(self._unit.access.read([self._unit.map.position]))
        self.unshown = True
        near = self._near_counts()
        if abs(here - move.target_counts) > max(near, 0.5 * way_counts) and abs(here - move.start_counts) <= near:
            raise MotionTimeoutError(
                f"drive {self._unit.name}: accepted a target {way_mm:.6f} mm away, says it is in position, and does not move"
            )
