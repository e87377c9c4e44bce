"""Guideway, load and set-up: errors of the measured point that do not come from the screw.

Small frozen terms, each a pure function of the machine's state; all of them zero unless requested.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sim_backends.plant.shapes import SmoothShape


@dataclass(frozen=True)
class Guideway:
    """Angular errors of the table and the arms at which they show: error = pitch·arm_z − yaw·arm_y (Abbe); and how it leaves the line.

    pitch_urad, yaw_urad: shapes over the position; arms in mm from the measuring line to the point that matters.
    straightness_um: how far the table is from a straight way, along + of the axis at right angles, over the position
    """

    pitch_urad: SmoothShape = field(default_factory=SmoothShape)
    yaw_urad: SmoothShape = field(default_factory=SmoothShape)
    straightness_um: SmoothShape = field(default_factory=SmoothShape)
    arm_z_mm: float = 0.0
    arm_y_mm: float = 0.0

    def error_um(self, x_mm: float) -> float:
        """Abbe error at x, µm."""
        error = 0.0
        if self.arm_z_mm:
            error += math.tan(self.pitch_urad.value(x_mm) * 1e-6) * self.arm_z_mm
        if self.arm_y_mm:
            error -= math.tan(self.yaw_urad.value(x_mm) * 1e-6) * self.arm_y_mm
        return error * 1000.0


@dataclass(frozen=True)
class LoadDeflection:
    """Deflection of the table under load, less than proportional; it grows with the distance from the bearing.

    compliance_um_per_100kg at small loads; saturation_kg where half of the proportional deflection is lost;
    growth: relative increase of the deflection over the length; windup_per_100kg: relative increase of the reversal's half widths.
    """

    compliance_um_per_100kg: float = 0.0
    saturation_kg: float = 1500.0
    growth: float = 0.4
    length_mm: float = 500.0
    windup_per_100kg: float = 0.0

    def error_um(self, x_mm: float, load_kg: float) -> float:
        """Deflection at x under this load, µm."""
        if self.compliance_um_per_100kg == 0.0:
            return 0.0
        soft = load_kg / (1.0 + abs(load_kg) / self.saturation_kg)
        return -self.compliance_um_per_100kg * soft / 100.0 * (1.0 + self.growth * x_mm / self.length_mm)


@dataclass(frozen=True)
class CrossAxis:
    """Bending of the structure by another axis's position: proportional, with a bow, and stronger towards the far end.

    um_per_mm of the other axis at x = 0; bow: relative, quadratic over reach_mm; growth over length_mm of this axis.
    """

    um_per_mm: float = 0.0
    bow: float = 0.15
    reach_mm: float = 400.0
    growth: float = 0.25
    length_mm: float = 500.0

    def error_um(self, x_mm: float, other_mm: float) -> float:
        """Error at x with the other axis at other_mm, µm."""
        if self.um_per_mm == 0.0:
            return 0.0
        s = other_mm / self.reach_mm
        return self.um_per_mm * other_mm * (1.0 + self.bow * s * s) * (1.0 + self.growth * x_mm / self.length_mm)


@dataclass(frozen=True)
class VelocityLag:
    """Lag of the table behind the moving motor: nearly proportional to the velocity, a little less at high speed."""

    um_per_mm_s: float = 0.0
    bend_mm_s: float = 400.0

    def error_um(self, velocity_mm_s: float) -> float:
        """Lag at this velocity, µm."""
        if self.um_per_mm_s == 0.0:
            return 0.0
        return -self.um_per_mm_s * velocity_mm_s / math.sqrt(1.0 + (velocity_mm_s / self.bend_mm_s) ** 2)


@dataclass(frozen=True)
class MountSlip:
    """One slip of the reflector's (or nut's) mount: most of it at one moment, the rest as it settles."""

    amount_um: float = 0.0
    at_s: float = math.inf
    settling: float = 0.1
    settle_s: float = 25.0

    def error_um(self, time_s: float) -> float:
        """Displacement at this time, µm."""
        since = time_s - self.at_s
        if self.amount_um == 0.0 or since < 0.0:
            return 0.0
        return self.amount_um * (1.0 - self.settling / (1.0 + since / self.settle_s))
