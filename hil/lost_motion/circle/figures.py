"""The circle test's figures: the path over time, the radial deviation, and the bump after each quadrant.

Angles are in degrees, counter-clockwise from the first axis's + direction; at 0 and 180° the first axis reverses, at 90
and 270° the second.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from hil.figures.iso230_4 import Iso230Part4, iso230_4
from hil.records.rows import Floats

QUADRANTS_DEG = (0.0, 90.0, 180.0, 270.0)
BETWEEN_DEG = (45.0, 135.0, 225.0, 315.0)
"""Half-way between the quadrants, where no axis reverses: the bump figure there is the noise floor."""
BEFORE_DEG, AFTER_DEG = 12.0, 10.0
"""Range before a quadrant that is taken as undisturbed, and range after it in which the bump is searched."""
NEAR_DEG = 1.0
"""Margin at the quadrant, covering the alignment in time of set-points and samples and the noise of the angle."""
START_DEG, LEAD_DEG = -60.0, 30.0
"""Start of the full turn, and length of the arc before it, on which the feed is reached and both axes wind up; the same
arc follows.
"""


@dataclass(frozen=True)
class Circle:
    """centre_mm: of both axes; feed_mm_s along the path; sense: +1 counter-clockwise; ramp_mm_s2: tangential
    acceleration.

    Raises InputError for values that are not positive, or a feed that the arc before the turn is too short for.
    """

    centre_mm: tuple[float, float]
    radius_mm: float = 10.0
    feed_mm_s: float = 100.0 / 60.0
    sense: int = 1
    ramp_mm_s2: float = 20.0

    def __post_init__(self) -> None:
        if not (self.radius_mm > 0.0 and self.feed_mm_s > 0.0 and self.ramp_mm_s2 > 0.0 and self.sense in (1, -1)):
            raise InputError(
                f"circle of {self.radius_mm:g} mm at {self.feed_mm_s:g} mm/s, sense {self.sense}: expected > 0, and 1 or -1"
            )
        if self._ramp_mm > 0.5 * self._lead_mm:
            most = math.floor(10.0 * 60.0 * math.sqrt(self.ramp_mm_s2 * self._lead_mm)) / 10.0
            raise InputError(
                f"a feed of {60.0 * self.feed_mm_s:.10g} mm/min needs {self._ramp_mm:.3f} mm to be reached, and"
                f" {0.5 * self._lead_mm:.3f} mm are allowed, half of the arc before the turn: a circle of"
                f" {self.radius_mm:g} mm takes up to {most:.1f} mm/min"
            )

    @property
    def _lead_mm(self) -> float:
        return self.radius_mm * math.radians(LEAD_DEG)

    @property
    def _ramp_mm(self) -> float:
        return 0.5 * self.feed_mm_s**2 / self.ramp_mm_s2

    @property
    def length_mm(self) -> float:
        """Length of the path with both arcs."""
        return 2.0 * math.pi * self.radius_mm + 2.0 * self._lead_mm

    @property
    def duration_s(self) -> float:
        """Duration with both ramps."""
        return self.length_mm / self.feed_mm_s + self.feed_mm_s / self.ramp_mm_s2

    def at(self, way_mm: float) -> tuple[float, float]:
        """Targets of both axes, mm, after way_mm of the path."""
        angle = self.sense * (math.radians(START_DEG - LEAD_DEG) + way_mm / self.radius_mm)
        return (
            self.centre_mm[0] + self.radius_mm * math.cos(angle),
            self.centre_mm[1] + self.radius_mm * math.sin(angle),
        )

    def starting(self) -> tuple[int, int]:
        """Initial directions of both axes, +1 or -1."""
        here, soon = self.at(0.0), self.at(1e-3 * self.radius_mm)
        return (1 if soon[0] > here[0] else -1), (1 if soon[1] > here[1] else -1)

    def path(self, period_s: float) -> Iterator[tuple[tuple[float, float], float]]:
        """Targets of both axes (mm) and feed (mm/s) of every period: acceleration, a turn and its arcs, deceleration to
        rest.
        """
        ramp_s = self.feed_mm_s / self.ramp_mm_s2
        for index in range(1, math.ceil(self.duration_s / period_s) + 1):
            t = min(index * period_s, self.duration_s)
            up, left = min(t, ramp_s), self.duration_s - t
            feed = min(self.feed_mm_s, self.ramp_mm_s2 * min(t, left))
            if left < ramp_s:
                way = self.length_mm - 0.5 * self.ramp_mm_s2 * left * left
            else:
                way = 0.5 * self.ramp_mm_s2 * up * up + self.feed_mm_s * (t - up)
            yield self.at(way), feed


@dataclass(frozen=True)
class Trace:
    """The driven circle: angle_deg, (n,), of each pair of positions about the fitted centre, increasing in the sense of
    motion;

    deviation_um, (n,): radius there less the commanded radius.
    """

    angle_deg: Floats
    deviation_um: Floats

    def bump_um(self, at_deg: float) -> float:
        """Largest deviation within `AFTER_DEG` after an angle from the straight line through the `BEFORE_DEG` before
        it, µm.

        Raises InputError where the trace has no samples.
        """
        for at in (at_deg, at_deg - 360.0):
            past = self.angle_deg - at
            before = (past >= -BEFORE_DEG) & (past <= -NEAR_DEG)
            after = (past >= 0.0) & (past <= AFTER_DEG)
            if np.count_nonzero(before) >= 5 and np.count_nonzero(after) >= 5:
                line = np.polyfit(past[before], self.deviation_um[before], 1)
                return float(np.max(np.abs(self.deviation_um[after] - np.polyval(line, past[after]))))
        raise InputError(f"the trace has no samples around {at_deg:g}°")

    @property
    def bumps_um(self) -> tuple[float, ...]:
        """Bumps after 0, 90, 180 and 270°, µm."""
        return tuple(self.bump_um(at) for at in QUADRANTS_DEG)

    @property
    def bump_mean_um(self) -> float:
        return float(np.mean(self.bumps_um))

    @property
    def floor_um(self) -> float:
        """The same figure half-way between the quadrants, where no axis reverses; mean of four, µm."""
        return float(np.mean([self.bump_um(at) for at in BETWEEN_DEG]))

    @property
    def roundness_um(self) -> float:
        """Largest less smallest deviation, µm."""
        return float(np.ptp(self.deviation_um))


def by_standard(trace: Trace, circle: Circle) -> Iso230Part4:
    """The figures of ISO 230-4 of a trace. Raises InputError for one that is no full turn."""
    radius = circle.radius_mm + trace.deviation_um / 1000.0
    angle = np.radians(trace.angle_deg)
    return iso230_4([(radius * np.cos(angle), circle.sense * radius * np.sin(angle))], circle.radius_mm)


def trace_of(first_mm: Floats, second_mm: Floats, circle: Circle) -> Trace:
    """Positions of both axes at the same times, mm, (n,) each, in order of time, as deviation over angle for the turn
    from `START_DEG`.

    The centre is fitted by least squares, as its position is no part of roundness. Angles of a clockwise circle are
    mirrored, so that they increase.
    """
    u, v = first_mm - circle.centre_mm[0], circle.sense * (second_mm - circle.centre_mm[1])
    angle = np.degrees(np.unwrap(np.arctan2(v, u)))  # from START_DEG - LEAD_DEG on, which arctan2 gives
    turn = (angle >= START_DEG) & (angle <= START_DEG + 360.0)
    u, v = u[turn], v[turn]
    radius = np.hypot(u, v)
    design = np.column_stack([u / radius, v / radius, np.ones(len(u))])
    centre = np.linalg.lstsq(design, radius - circle.radius_mm, rcond=None)[0]
    u, v = u - centre[0], v - centre[1]
    return Trace(np.degrees(np.unwrap(np.arctan2(v, u))), 1000.0 * (np.hypot(u, v) - circle.radius_mm))


def ring_of(traces: Iterable[Trace]) -> float:
    """µm per ring of a polar plot: 1, 2 or 5 times a power of ten, about four rings to the largest deviation."""
    largest = max((float(np.max(np.abs(trace.deviation_um))) for trace in traces), default=1.0)
    wanted = max(largest, 0.01) / 4.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= wanted)
