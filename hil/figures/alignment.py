"""Alignment of the beam with the axis, from where it meets the target at two places: the angle, and the cosine error it
makes. No I/O.

The height and side of the beam on the target are read with the axis near the laser and far from it. A beam at an angle
θ to the motion reads L·cos θ, short by θ²/2: a scale error that no measurement along the same beam separates from a
lead error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import InputError
from drivers.toml_types import Number, Positive


@dataclass(frozen=True)
class Alignment:
    """The spots as read; raises InputError for places less than 10 mm apart or a half range of 0.

    near_mm, far_mm: the axis's two positions; height_mm, side_mm: of the beam on the target, near and far
    read_within_mm: half range to which a spot can be read
    returning: read where a retroreflector sends the beam back, so that its offset is doubled
    """

    near_mm: Number
    far_mm: Number
    height_mm: tuple[Number, Number]
    side_mm: tuple[Number, Number]
    read_within_mm: Positive = 0.5
    returning: bool = False

    def __post_init__(self) -> None:
        if not abs(self.far_mm - self.near_mm) >= 10.0:
            raise InputError(
                f"alignment was read at {self.near_mm:g} and {self.far_mm:g} mm, expected 10 mm apart or more"
            )
        if not self.read_within_mm > 0.0:
            raise InputError(f"alignment read_within_mm is {self.read_within_mm:g}, expected more than 0")

    @property
    def _per_mm(self) -> float:
        """From a difference of two spots to an angle in rad."""
        return 1.0 / abs(self.far_mm - self.near_mm) / (2.0 if self.returning else 1.0)

    @property
    def angle_mrad(self) -> float:
        """Angle between beam and motion."""
        rise, sideways = (pair[1] - pair[0] for pair in (self.height_mm, self.side_mm))
        return 1000.0 * math.hypot(rise, sideways) * self._per_mm

    @property
    def readable_mrad(self) -> float:
        """Largest angle that the reading of the spots cannot show."""
        return 1000.0 * math.sqrt(2.0) * 2.0 * self.read_within_mm * self._per_mm

    @property
    def good(self) -> bool:
        """The angle is within what the spots can show; only beyond that would a better alignment be seen."""
        return self.angle_mrad <= self.readable_mrad

    @property
    def short_ppm(self) -> float:
        """How much the instrument reads short by the measured angle, θ²/2."""
        return self.angle_mrad**2 / 2.0

    @property
    def short_at_most_ppm(self) -> float:
        """The same with the largest error of all four readings."""
        return (self.angle_mrad + self.readable_mrad) ** 2 / 2.0

    def lateral_mm(self, length_mm: float) -> float:
        """Lateral range of the beam over a length: ISO/TR 230-9's range of misalignment."""
        return length_mm * math.sqrt(2e-6 * self.short_at_most_ppm)
