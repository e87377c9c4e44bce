"""What surrounds the axis of the bench: its load, its other axis, and a level on its table, as `Conditions`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.errors import CapabilityError
from sim_backends.plant.axis import FeedAxis


class BenchConditions:
    """Sets and reads the simulated axis's surroundings; levels are those of the axis file."""

    by_hand = False

    def __init__(self, axis: FeedAxis, levels: Mapping[str, Sequence[float]]) -> None:
        known = {"load_kg", "pos_y_mm"}
        if unknown := set(levels) - known:
            raise CapabilityError(
                f"the bench cannot vary {', '.join(sorted(unknown))}, only {', '.join(sorted(known))}"
            )
        self._axis = axis
        self._levels = {name: tuple(values) for name, values in levels.items()}

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        return self._levels

    def set(self, name: str, value: float) -> None:
        if name == "load_kg":
            self._axis.load_kg = value
        elif name == "pos_y_mm":
            self._axis.other_axis_mm = value
        else:
            raise CapabilityError(f"the bench cannot set {name}")

    def read(self) -> Mapping[str, float]:
        """Load and cross position where they are varied, and the level's angles."""
        now = {"load_kg": self._axis.load_kg, "pos_y_mm": self._axis.other_axis_mm}
        return {
            **{name: now[name] for name in self._levels},
            "pitch_urad": self._axis.pitch_urad,
            "yaw_urad": self._axis.yaw_urad,
        }
