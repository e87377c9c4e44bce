"""DriveLimits: the travel, velocity and acceleration that no drive is moved beyond."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import LimitError
from drivers.toml_types import Number, Positive


@dataclass(frozen=True)
class DriveLimits:
    """The limits of the axis file; a target outside is refused, never clipped. mm, mm/s, mm/s²."""

    travel_min_mm: Number
    travel_max_mm: Number
    max_velocity_mm_s: Positive
    max_acceleration_mm_s2: Positive

    @property
    def ends_mm(self) -> tuple[float, float]:
        """Both ends of the travel, mm."""
        return self.travel_min_mm, self.travel_max_mm

    def check_target(self, position_load_mm: float) -> None:
        """Raise LimitError unless the position, mm, lies within the travel; NaN is refused."""
        if not self.travel_min_mm <= position_load_mm <= self.travel_max_mm:
            raise LimitError(
                f"target {position_load_mm:.6f} mm is outside the travel"
                f" {self.travel_min_mm:g} to {self.travel_max_mm:g} mm"
            )

    def check_velocity(self, velocity_mm_s: float) -> None:
        """Raise LimitError unless 0 < velocity <= max, mm/s."""
        if not 0 < velocity_mm_s <= self.max_velocity_mm_s:
            raise LimitError(f"velocity {velocity_mm_s:g} mm/s, allowed is 0 < v <= {self.max_velocity_mm_s:g} mm/s")
