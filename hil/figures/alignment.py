"""Is the beam along the axis? From where it meets the target at two places: angle, and the cosine error it makes. Pure.

With the axis near the laser, then far from it, read on the target how high the beam stands and how far to the side. A beam at an
angle θ to the motion reads L·cos θ: short by θ²/2, a scale error that no measurement along the same beam can tell from a lead error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import InputError
from drivers.toml_types import Number, Positive


@dataclass(frozen=True)
class Alignment:
    """near_mm, far_mm: the axis's two places; height_mm, side_mm: of the beam on the target, near and far.

    read_within_mm: how well a spot can be read, a half range; returning: it is read where a retroreflector sends the beam back, where
    it stands twice as far off
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
        """Between beam and motion."""
        rise, aside = (pair[1] - pair[0] for pair in (self.height_mm, self.side_mm))
        return 1000.0 * math.hypot(rise, aside) * self._per_mm

    @property
    def readable_mrad(self) -> float:
        """The largest angle that could be there unseen, by how well spots can be read."""
        return 1000.0 * math.sqrt(2.0) * 2.0 * self.read_within_mm * self._per_mm

    @property
    def good(self) -> bool:
        """As well aligned as the spots can be read; beyond that a better alignment would be seen."""
        return self.angle_mrad <= self.readable_mrad

    @property
    def short_ppm(self) -> float:
        """How much the instrument reads short, by the spots as they were read."""
        return self.angle_mrad**2 / 2.0

    @property
    def short_at_most_ppm(self) -> float:
        """The same where all four readings were off by as much as they can be."""
        return (self.angle_mrad + self.readable_mrad) ** 2 / 2.0

    def lateral_mm(self, length_mm: float) -> float:
        """How far the beam may wander sideways over a length: ISO/TR 230-9's range of misalignment."""
        return length_mm * math.sqrt(2e-6 * self.short_at_most_ppm)
