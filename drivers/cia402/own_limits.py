"""OwnLimits: a drive's own limits of velocity and acceleration, which are lower than the axis file's or not stated at all."""

from __future__ import annotations

from collections.abc import Callable

from drivers.cia402 import objects, words
from drivers.cia402.kept_settings import KeptSettings
from drivers.cia402.objects import Entry
from drivers.cia402.wire import LEFT_OUT, OUT_OF_RANGE, ObjectAccess
from drivers.errors import AbortError, LimitError
from drivers.scaling import MotionScaling

SAME_SHARE = 1e-3
"""Share by which a drive's own limit may lie below the axis file's without a note: rounding to its units."""
RAMPS = {
    objects.PROFILE_ACCELERATION: objects.MAX_ACCELERATION,
    objects.PROFILE_DECELERATION: objects.MAX_DECELERATION,
}
"""Each ramp, and the object that limits it."""


class OwnLimits:
    """units: of its velocities and accelerations. highest: largest value that the maker's file allows for an object, None without
    one. notes: where what is used instead is told, one sentence each."""

    def __init__(
        self,
        access: ObjectAccess,
        kept: KeptSettings,
        units: MotionScaling,
        highest: Callable[[Entry], float | None],
        notes: list[str],
    ) -> None:
        self._access = access
        self._kept = kept
        self._units = units
        self._highest = highest
        self._notes = notes
        self._left_out: set[Entry] = set()
        self._stated: dict[Entry, int] = {}
        self._taken: dict[Entry, int] = {}  # ramps that were lowered until the drive took them

    def _limit(self, entry: Entry) -> int:
        """A limit that the drive states, in its units; 0 where it states none."""
        if entry not in self._stated:
            self._stated[entry] = words.limit(self._access.read_if_shown(entry, 0)) or 0
        return self._stated[entry]

    def note(self, velocity_mm_s: float, acceleration_mm_s2: float) -> None:
        """Read the drive's limits and ramps, and note where they are below the axis file's (mm/s, mm/s²). Nothing is written."""
        largest = self._limit(objects.MAX_PROFILE_VELOCITY)
        if largest and self._units.mm_s(largest) < velocity_mm_s * (1 - SAME_SHARE):
            self._notes.append(
                f"{self._access.name} allows {self._units.mm_s(largest):.4g} mm/s (607Fh), the axis file {velocity_mm_s:g} mm/s:"
                " faster moves are refused"
            )
        for entry in RAMPS:
            try:
                self._access.read(entry)
            except AbortError as error:
                if error.code in LEFT_OUT:
                    self._leave_out(entry)
                    continue
            self._allowed(entry, self._units.acceleration_units(acceleration_mm_s2))

    def _leave_out(self, entry: Entry) -> None:
        self._left_out.add(entry)
        which = "6083h serves both ramps" if entry is objects.PROFILE_DECELERATION else "its own ramp holds"
        self._notes.append(f"{self._access.name} does not take {entry}: {which}")

    def _allowed(self, ramp: Entry, acceleration: int) -> int:
        """The ramp that the drive allows, in its units; noted once where that is less."""
        limits = (self._limit(RAMPS[ramp]), self._taken.get(ramp), self._highest(ramp), ramp.type.range[1])
        value = min([acceleration, *(int(limit) for limit in limits if limit)])
        if value < acceleration:
            said = (
                f"{self._access.name} allows {self._units.mm_s2(value):.4g} mm/s² ({ramp}) instead of the axis file's"
                f" {self._units.mm_s2(acceleration):.4g} mm/s²: moves use what it allows"
            )
            if said not in self._notes:
                self._notes.append(said)
        return value

    def check_velocity(self, velocity: int) -> None:
        """Raise LimitError for a velocity that the drive would limit in silence (607Fh) or refuse (its maker's file)."""
        written = objects.PROFILE_VELOCITY
        for limit, source in (
            (float(self._limit(objects.MAX_PROFILE_VELOCITY)), "607Fh"),
            (self._highest(written), "its maker's file"),
            (written.type.range[1], f"{written} holds no more"),
        ):
            if limit and velocity > limit:
                raise LimitError(
                    f"{self._access.name}: {self._units.mm_s(velocity):.4g} mm/s is more than its drive allows,"
                    f" {self._units.mm_s(limit):.4g} mm/s ({source})"
                )

    def set_ramps(self, acceleration: int) -> None:
        """6083h and 6084h as far as the drive has them and takes them: one that it calls out of range is halved until it is taken."""
        for ramp in RAMPS:
            if ramp in self._left_out:
                continue
            value = wanted = min(self._taken.get(ramp) or self._allowed(ramp, acceleration), acceleration)
            while True:
                try:
                    self._kept.set(ramp, value)
                    break
                except AbortError as error:
                    if error.code in LEFT_OUT:
                        self._leave_out(ramp)
                        break
                    if error.code not in OUT_OF_RANGE or value <= 1:
                        raise
                    value = max(1, value // 2)
            if value < wanted and ramp not in self._left_out:
                self._taken[ramp] = value
                self._allowed(ramp, acceleration)
