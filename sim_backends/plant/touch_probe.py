"""A probe's ball and faces, a boss or a bore, as vectors: the geometry on which the contact depends.

Frames: machine mm (x, y across the spindle axis, z along it), and the spindle's own, which coincides with the machine's at 0°.
Computed as the distance between a sphere and a solid, independent of the formula by which a run-out is computed from contacts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Stylus:
    """The probe as it sits in the spindle.

    offset_mm: the ball's centre in the spindle's frame; pretravel_mm: overtravel of the ball until the signal comes;
    noise_mm: standard deviation of that from touch to touch
    """

    radius_mm: float = 2.0
    offset_mm: tuple[float, float] = (0.0, 0.0)
    pretravel_mm: float = 0.0
    noise_mm: float = 0.0

    def ball_mm(self, spindle_mm: Vector, spindle_rad: float) -> Vector:
        """The ball's centre for a position and an angle of the spindle, counter-clockwise seen along its axis; mm."""
        reach = math.hypot(*self.offset_mm)
        bearing = math.atan2(self.offset_mm[1], self.offset_mm[0]) + spindle_rad
        x, y, z = spindle_mm
        return x + reach * math.cos(bearing), y + reach * math.sin(bearing), z


class Solid(Protocol):
    """A body that can be touched."""

    def clearance_mm(self, point_mm: Vector) -> float:
        """Distance of a point from the surface, negative inside the material; inf where the solid does not reach."""


@dataclass(frozen=True)
class Face:
    """A plane face of a block, through a point, approached in the direction `facing` (+1 or -1) of x.

    tilt_z_rad turns the face about z (its normal leans towards y), tilt_y_rad about y (the normal leans towards z); the block reaches
    half_width_mm to both sides of the point along y, and depth_mm behind the face.
    """

    point_mm: Vector
    facing: int = 1
    tilt_z_rad: float = 0.0
    tilt_y_rad: float = 0.0
    half_width_mm: float = 20.0
    depth_mm: float = 30.0

    def clearance_mm(self, point_mm: Vector) -> float:
        if abs(point_mm[1] - self.point_mm[1]) > self.half_width_mm:
            return math.inf
        normal = (
            -self.facing * math.cos(self.tilt_z_rad) * math.cos(self.tilt_y_rad),
            math.sin(self.tilt_z_rad) * math.cos(self.tilt_y_rad),
            math.sin(self.tilt_y_rad),
        )
        clearance_mm = sum(n * (p - q) for n, p, q in zip(normal, point_mm, self.point_mm, strict=True))
        return clearance_mm if clearance_mm > -self.depth_mm else math.inf


@dataclass(frozen=True)
class Wall:
    """A plane face along the spindle axis through a point, whose outward normal has a bearing in the xy plane (0: +x, 90: +y).

    It reaches half_width_mm to both sides of the point, and depth_mm into the material; its top edge is at top_mm of z.
    """

    point_mm: Vector
    bearing_deg: float
    half_width_mm: float = 20.0
    depth_mm: float = 30.0
    top_mm: float = math.inf

    def clearance_mm(self, point_mm: Vector) -> float:
        outward = complex(math.cos(math.radians(self.bearing_deg)), math.sin(math.radians(self.bearing_deg)))
        away = complex(point_mm[0] - self.point_mm[0], point_mm[1] - self.point_mm[1]) * outward.conjugate()
        if abs(away.imag) > self.half_width_mm or away.real < -self.depth_mm:
            return math.inf
        above_mm = point_mm[2] - self.top_mm
        return max(away.real, above_mm) if above_mm < 0.0 or away.real < 0.0 else math.hypot(away.real, above_mm)


@dataclass(frozen=True)
class Boss:
    """A cylindrical boss along z."""

    point_mm: Vector
    radius_mm: float

    def clearance_mm(self, point_mm: Vector) -> float:
        return math.hypot(point_mm[0] - self.point_mm[0], point_mm[1] - self.point_mm[1]) - self.radius_mm


@dataclass(frozen=True)
class Bore:
    """A cylindrical bore along a unit axis through a point, in a ring of some wall thickness."""

    point_mm: Vector
    radius_mm: float
    axis: Vector = (0.0, 0.0, 1.0)
    wall_mm: float = 10.0

    def clearance_mm(self, point_mm: Vector) -> float:
        away = [p - q for p, q in zip(point_mm, self.point_mm, strict=True)]
        along = sum(a * e for a, e in zip(away, self.axis, strict=True))
        across = math.sqrt(sum((a - along * e) ** 2 for a, e in zip(away, self.axis, strict=True)))
        return self.radius_mm - across if across <= self.radius_mm + self.wall_mm else math.inf


@dataclass(frozen=True)
class Chip:
    """A chip between ball and work from one touch to another, numbered from 0, both included.

    thickness_mm before anything presses on it; give: the share of it that a touch may flatten, anew at every touch.
    """

    thickness_mm: float
    first_touch: int
    last_touch: int
    give: float = 0.0
