"""Place: whether the motor is where it may be, also while nobody told it to move. Pure: positions go in, what is wrong comes out."""

from __future__ import annotations

from drivers.drive import DriveLimits

OUTSIDE_MM = 1.0
"""How far beyond the travel an axis may be found that was inside: more than moves to the end of a travel overshoot."""
AT_REST_MM = 1.0
"""How far an axis may wander that was not told to move: a load sags by less when a brake opens, a loop holds it closer."""


class Place:
    """Of one axis under power. One that was beyond its travel (at a homing switch) may come back, and not get further out again."""

    def __init__(self, limits: DriveLimits) -> None:
        self._limits = limits
        self._rest_mm: float | None = None
        self._beyond_mm: float | None = None

    def forget(self) -> None:
        """The drive's zero is a new one, or the axis was without power: where it is now is where it may be."""
        self._rest_mm = self._beyond_mm = None

    def look(self, position_mm: float, *, moving: bool) -> str | None:
        """What is wrong with where the motor is. moving: it was told to."""
        limits = self._limits
        beyond_mm = max(0.0, limits.travel_min_mm - position_mm, position_mm - limits.travel_max_mm)
        if self._beyond_mm is None:
            self._beyond_mm = beyond_mm
        if beyond_mm > self._beyond_mm + OUTSIDE_MM:
            return (
                f"is at {position_mm:.3f} mm, outside its travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm:"
                " it does not obey its drive's orders, or another master moves it"
            )
        self._beyond_mm = min(self._beyond_mm, beyond_mm)
        if moving:
            self._rest_mm = None
            return None
        if self._rest_mm is None:
            self._rest_mm = position_mm
        if abs(position_mm - self._rest_mm) > AT_REST_MM:
            return (
                f"moved from {self._rest_mm:.3f} to {position_mm:.3f} mm without being told to: another master moves it,"
                " or its drive does not hold it"
            )
        return None
