"""Reversal effects: clearance and wind-up, lost motion that builds up over distance, and the torque that shows both.

Rate-independent operators of the play and stop kind. Each step is exact as long as the motor moves one way within it, however
far, so the result does not depend on the length of the steps. The lost motion is a stack of stop elements (Iwan's
parallel-series model, 1966), which is piecewise linear: neither a tanh nor an exponential, unlike the models fitted to it.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from sim_backends.plant.shapes import Points, between


@dataclass(frozen=True)
class Backlash:
    """Clearance plus wind-up against friction.

    amount_um: distance between the two sides at the middle of the travel; slope/curve: relative change of it at the end of the
    travel against the middle, linear and quadratic; gap_fraction: share of it that is clearance without force (the rest is a spring);
    stribeck: additional wind-up before the table breaks away, relative to that when sliding; it is lost over
    breakaway_mm of travel (where one half of it is gone). along_um: a measured distance, added to it.
    """

    amount_um: float = 0.0
    slope: float = 0.0
    curve: float = 0.0
    middle_mm: float = 250.0
    half_travel_mm: float = 250.0
    gap_fraction: float = 0.0
    stribeck: float = 0.0
    breakaway_mm: float = 0.02
    along_um: Points = ()

    @property
    def is_constant(self) -> bool:
        """Whether the distance is the same along the axis."""
        return self.slope == 0.0 and self.curve == 0.0 and not self.along_um

    def half_width_mm(self, x_mm: float) -> float:
        """Half of the distance between the two sides at x, mm."""
        if self.is_constant:
            return self.amount_um * 0.0005
        s = (x_mm - self.middle_mm) / self.half_travel_mm
        own_um = self.amount_um * (1.0 + self.slope * s + self.curve * s * s)
        return max(0.0, 0.0005 * (own_um + between(self.along_um, x_mm)))


@dataclass(frozen=True)
class LostMotion:
    """Elements (travel after a reversal until this one has yielded, mm; its share of the lost motion, µm)."""

    elements: tuple[tuple[float, float], ...] = ()

    @classmethod
    def spread(cls, seed: int, amount_um: float, distance_mm: float) -> LostMotion:
        """`amount_um` (µm) in all, half of it built up within about `distance_mm`, the rest over up to some six times that."""
        if amount_um == 0.0:
            return cls()
        rng = random.Random(seed)
        travels = [distance_mm * (0.3 + 6.0 * ((i + rng.random()) / 6) ** 1.5) for i in range(6)]
        shares = [rng.uniform(0.7, 1.3) for _ in travels]
        scale = amount_um / sum(shares)
        return cls(tuple((t, s * scale) for t, s in zip(travels, shares, strict=True)))

    @property
    def amount_um(self) -> float:
        """Sum of the elements, µm."""
        return sum(share for _, share in self.elements)


@dataclass(slots=True)
class ReversalState:
    """Positions of the elements. `nut_mm` is the nut by play alone; `stops_mm` the deflection of each stop element."""

    motor_mm: float = 0.0
    nut_mm: float = 0.0
    stops_mm: list[float] = field(default_factory=list)
    slid_mm: float = 0.0  # travel since the table last broke away


class Reversal:
    """Both operators with their state."""

    def __init__(self, backlash: Backlash, lost_motion: LostMotion, motor_mm: float = 0.0) -> None:
        self.state = ReversalState(motor_mm, motor_mm, [0.0] * len(lost_motion.elements))
        self.configure(backlash, lost_motion)

    def configure(self, backlash: Backlash, lost_motion: LostMotion) -> None:
        """Change the parameters; the nut stays until it is pushed, new stop elements start relaxed."""
        self.backlash = backlash
        self.lost_motion = lost_motion
        if len(self.state.stops_mm) != len(lost_motion.elements):
            self.state.stops_mm = [0.0] * len(lost_motion.elements)
        # (half of the travel to yield, loss in µm per mm of deflection)
        self._stops = tuple((t / 2.0, s / t) for t, s in lost_motion.elements)
        self._constant_half_mm = backlash.half_width_mm(0.0) if backlash.is_constant else None

    def step(self, motor_mm: float) -> None:
        """Move the motor to a position, mm, without a reversal in between."""
        state = self.state
        moved = motor_mm - state.motor_mm
        if moved == 0.0:
            return
        state.motor_mm = motor_mm
        half = self._constant_half_mm
        if half is None:
            half = self.backlash.half_width_mm(motor_mm)
        before = state.nut_mm
        was_ahead = motor_mm - moved - before
        if moved > 0.0:
            if before < motor_mm - half:
                state.nut_mm = motor_mm - half
        elif before > motor_mm + half:
            state.nut_mm = motor_mm + half
        slid = abs(state.nut_mm - before)
        if was_ahead * (motor_mm - before) <= 0.0:
            state.slid_mm = 0.0  # the old wind-up is released: the table has to break away again
        state.slid_mm += slid
        stops = state.stops_mm
        for i, (limit, _) in enumerate(self._stops):
            s = stops[i] + moved
            stops[i] = limit if s > limit else -limit if s < -limit else s

    @property
    def loss_um(self) -> float:
        """Lag of the table behind the nut by the built-up lost motion, µm, positive after a + motion."""
        return sum(k * s for (_, k), s in zip(self._stops, self.state.stops_mm, strict=True))

    @property
    def overshoot_um(self) -> float:
        """Additional lag of the table before and after it breaks away, compared with sliding, µm (Stribeck)."""
        backlash = self.backlash
        if backlash.stribeck == 0.0:
            return 0.0
        ratio = self.wind_up_ratio
        half_um = 1000.0 * backlash.half_width_mm(self.state.motor_mm)
        return backlash.stribeck * half_um * ratio**3 * abs(ratio) * self.breakaway(backlash.breakaway_mm)

    @property
    def wind_up_ratio(self) -> float:
        """Force of the wound-up drive train relative to the table's friction: ±1 when the table slides, between when it sticks."""
        state = self.state
        ahead = state.motor_mm - state.nut_mm
        half = self.backlash.half_width_mm(state.motor_mm)
        ratio = ahead / half if half > 1e-12 else 0.0
        gap = self.backlash.gap_fraction
        size = abs(ratio)
        size = 0.0 if size <= gap else (size - gap) / (1.0 - gap)
        weight = 2000.0 * half
        total = weight * (size if ratio > 0 else -size)
        for (limit, k), s in zip(self._stops, state.stops_mm, strict=True):
            total += k * s
            weight += k * limit
        return total / weight if weight > 1e-12 else 0.0

    def breakaway(self, over_mm: float) -> float:
        """1 just before the table breaks away, decreasing with the travel since; `over_mm`: travel at which it is one half."""
        r = self.state.slid_mm / over_mm
        return 1.0 / (1.0 + r * r)
