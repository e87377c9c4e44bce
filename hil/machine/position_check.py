"""Position check: the motor must stay within its travel, and where it is while no motion is commanded. Does no I/O."""

from __future__ import annotations

from drivers.limits import DriveLimits

OUTSIDE_MM = 1.0
"""Allowed distance beyond the travel, mm: more than a move to the end of the travel overshoots."""
AT_REST_MM = 1.0
"""Allowed change of position without a commanded motion, mm: more than a load sags when a brake opens."""


class PositionCheck:
    """Position check of one axis under power. An axis found beyond its travel (at a homing switch) may come back but not go further
    out."""

    def __init__(self, limits: DriveLimits) -> None:
        self._limits = limits
        self._rest_mm: float | None = None
        self._beyond_mm: float | None = None

    def forget(self) -> None:
        """Accept the next position as it is: call when the drive's zero changes and while the axis is without power."""
        self._rest_mm = self._beyond_mm = None

    def look(self, position_mm: float, *, moving: bool) -> str | None:
        """Take a motor position, mm. moving: a motion is commanded. Returns what is wrong as a sentence, None when nothing is."""
        limits = self._limits
        beyond_mm = max(0.0, limits.travel_min_mm - position_mm, position_mm - limits.travel_max_mm)
        if self._beyond_mm is None:
            self._beyond_mm = beyond_mm
        if beyond_mm > self._beyond_mm + OUTSIDE_MM:
            return (
                f"is at {position_mm:.3f} mm, outside its travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm:"
                " it does not follow its drive's commands, or another master moves it"
            )
        self._beyond_mm = min(self._beyond_mm, beyond_mm)
        if moving:
            self._rest_mm = None
            return None
        if self._rest_mm is None:
            self._rest_mm = position_mm
        if abs(position_mm - self._rest_mm) > AT_REST_MM:
            return (
                f"moved from {self._rest_mm:.3f} to {position_mm:.3f} mm without a command: another master moves it,"
                " or its drive does not hold it"
            )
        return None
