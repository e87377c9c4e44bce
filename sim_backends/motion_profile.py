"""Trapezoidal set-points as data: a list of pieces of constant acceleration, planned once and evaluated at any time.

Planning ahead keeps a step of the simulation cheap and makes the demand independent of the length of the steps. Pure functions on
numbers; positions in any unit u, velocities u/s, accelerations u/s².
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class Piece(NamedTuple):
    """From start_s to end_s (since the plan began): p0 + v0·τ + a·τ²/2 with τ = t − start_s."""

    start_s: float
    end_s: float
    p0: float
    v0: float
    a: float


@dataclass(frozen=True)
class Profile:
    """Successive pieces; after the last one the position is `end` with velocity `end_velocity`."""

    pieces: tuple[Piece, ...]
    duration_s: float  # inf for a profile that ends in a constant velocity other than 0
    end: float
    end_velocity: float = 0.0

    def at(self, t_s: float) -> tuple[float, float, float]:
        """(position, velocity, acceleration) at a time since the plan began, s."""
        if t_s >= self.duration_s:
            return self.end, self.end_velocity, 0.0
        for piece in self.pieces:
            if t_s < piece.end_s:
                tau = t_s - piece.start_s
                return piece.p0 + (piece.v0 + 0.5 * piece.a * tau) * tau, piece.v0 + piece.a * tau, piece.a
        return self.end, self.end_velocity, 0.0


class _Builder:
    """Appends pieces, each from the end of the last one."""

    def __init__(self, position: float, velocity: float) -> None:
        self.t = 0.0
        self.p = position
        self.v = velocity
        self.pieces: list[Piece] = []

    def accelerate_to(self, velocity: float, acceleration: float) -> None:
        duration = abs(velocity - self.v) / acceleration
        if duration > 0.0:
            self._add(duration, math.copysign(acceleration, velocity - self.v))
            self.v = velocity

    def cruise(self, distance: float) -> None:
        if distance != 0.0 and self.v != 0.0:
            self._add(distance / self.v, 0.0)

    def _add(self, duration: float, a: float) -> None:
        self.pieces.append(Piece(self.t, self.t + duration, self.p, self.v, a))
        self.t += duration
        self.p += (self.v + 0.5 * a * duration) * duration
        self.v += a * duration


def plan_move(
    position: float, velocity: float, target: float, *, max_velocity: float, acceleration: float, deceleration: float
) -> Profile:
    """The fastest way to rest at target within the limits (all > 0), from any velocity, also one above max_velocity.

    Units u, u/s, u/s²."""
    build = _Builder(position, velocity)
    stop = _stopping_distance(velocity, deceleration)
    gap = target - position
    if velocity != 0.0 and (gap * velocity < 0 or abs(stop) > abs(gap)):
        build.accelerate_to(0.0, deceleration)  # it cannot stop before the target, or moves away from it: stop first
    gap = target - build.p
    if gap != 0.0:
        sign = math.copysign(1.0, gap)
        speed, left = abs(build.v), abs(gap)
        if speed > max_velocity:
            build.accelerate_to(sign * max_velocity, deceleration)
        else:
            peak_squared = (2 * acceleration * deceleration * left + deceleration * speed * speed) / (
                acceleration + deceleration
            )
            build.accelerate_to(sign * min(max_velocity, math.sqrt(peak_squared)), acceleration)
        braking = _stopping_distance(build.v, deceleration)
        cruise = (target - build.p) - braking
        if cruise * sign > 0.0:
            build.cruise(cruise)
        build.accelerate_to(0.0, deceleration)
    return Profile(tuple(build.pieces), build.t, target)


def plan_velocity(position: float, velocity: float, target_velocity: float, acceleration: float) -> Profile:
    """Ramp to a velocity and keep it; units as above."""
    build = _Builder(position, velocity)
    build.accelerate_to(target_velocity, acceleration)
    if target_velocity == 0.0:
        return Profile(tuple(build.pieces), build.t, build.p)
    build.pieces.append(Piece(build.t, math.inf, build.p, target_velocity, 0.0))
    return Profile(tuple(build.pieces), math.inf, math.nan, target_velocity)


def plan_stop(position: float, velocity: float, deceleration: float) -> Profile:
    """Ramp to rest; units as above."""
    return plan_velocity(position, velocity, 0.0, deceleration)


def _stopping_distance(velocity: float, deceleration: float) -> float:
    return 0.5 * velocity * abs(velocity) / deceleration
