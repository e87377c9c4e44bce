"""The simulated drive's own backlash compensation: after a reversal the motor turns further than the drive shows.

Stage between the servo and the mechanics. The amount is a parameter of the drive and may change at any time; it comes into force with
the next motion, as on a real drive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

SLOW_S, QUICK_S = 0.2, 0.01
"""Time over which the amount is added after a reversal, s: without and with the acceleration parameter."""
_REVERSAL_COUNTS = 1.0  # motion of a motor at rest is smaller


class Mechanics(Protocol):
    """The load of the motor: a plant, or a load without errors."""

    def step(self, motor_rev: float, dt_s: float) -> None:
        """Turn the shaft to `motor_rev` revolutions within dt_s seconds."""

    @property
    def friction_permille(self) -> float:
        """Torque it puts on the motor, 0.1 % of rated, with the sign of the motion it opposes."""


class BacklashCompensation:
    """`follow` sets the sources of amount (motor counts, >= 0) and acceleration switch; without it nothing is added."""

    def __init__(self, mechanics: Mechanics, counts_per_rev: int) -> None:
        self._mechanics = mechanics
        self._counts_per_rev = counts_per_rev
        self._amount: Callable[[], float] = lambda: 0.0
        self._accelerated: Callable[[], bool] = lambda: False
        self._direction = 0
        self._turn_counts: float | None = None  # the furthest position in the present direction
        self._largest_counts = 0.0  # largest amount so far: an amount set to 0 is taken away at the same rate
        self.added_counts = 0.0

    def follow(self, amount: Callable[[], float], accelerated: Callable[[], bool]) -> None:
        """Read both from the drive's parameters from now on."""
        self._amount, self._accelerated = amount, accelerated

    def step(self, shown_counts: float, dt_s: float) -> None:
        """Turn the shaft to `shown_counts`, and by the amount added, within dt_s seconds."""
        moving = self._watch(shown_counts)
        amount = self._amount()
        if moving and (amount or self.added_counts):
            wanted = amount if self._direction > 0 else 0.0
            self._largest_counts = max(self._largest_counts, amount)
            most = self._largest_counts * dt_s / (QUICK_S if self._accelerated() else SLOW_S)
            self.added_counts += max(-most, min(most, wanted - self.added_counts))
        self._mechanics.step((shown_counts + self.added_counts) / self._counts_per_rev, dt_s)

    def _watch(self, shown_counts: float) -> bool:
        """Whether the motor moves; keeps the direction of the last motion."""
        if self._turn_counts is None:
            self._turn_counts = shown_counts
        moved = shown_counts - self._turn_counts
        if moved * self._direction > 0.0:
            self._turn_counts = shown_counts
            return True
        if abs(moved) >= _REVERSAL_COUNTS:
            self._direction = 1 if moved > 0.0 else -1
            self._turn_counts = shown_counts
            return True
        return False
