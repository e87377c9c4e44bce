"""A motor on its own, for what is about the drive and its bus and not about a machine."""

from __future__ import annotations

import math

from sim_backends.servo import ServoParameters


class BareShaft:
    """A motor whose only load is friction."""

    def __init__(self, friction_permille: float = 40.0) -> None:
        self._at_rev = 0.0
        self._friction = friction_permille
        self.friction_permille = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None:
        """The shaft has turned to `motor_rev` revolutions."""
        del dt_s
        if motor_rev != self._at_rev:
            self.friction_permille = math.copysign(self._friction, motor_rev - self._at_rev)
        self._at_rev = motor_rev


SMALL_SERVO = ServoParameters(
    counts_per_rev=100_000,
    negative_limit_counts=-3_200_000.0,
    positive_limit_counts=3_200_000.0,
    negative_stop_counts=-3_300_000.0,
    positive_stop_counts=3_300_000.0,
)
"""100 000 counts per revolution, ±32 revolutions between the limit switches."""
