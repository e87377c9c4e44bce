"""Conditions of the simulated axis: load, position of the other axis, and the angles of a level on the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.errors import CapabilityError
from sim_backends.plant.axis import FeedAxis


class BenchConditions:
    """`Conditions` of the simulated axis. levels: of the axis file, load_kg in kg and pos_y_mm in mm.

    Raises CapabilityError for a condition that the bench cannot vary.
    """

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
        """Column name -> levels of the axis file."""
        return self._levels

    def set(self, name: str, value: float) -> None:
        """Set load_kg or pos_y_mm at once. Raises CapabilityError for any other name."""
        if name == "load_kg":
            self._axis.load_kg = value
        elif name == "pos_y_mm":
            self._axis.other_axis_mm = value
        else:
            raise CapabilityError(f"the bench cannot set {name}")

    def read(self) -> Mapping[str, float]:
        """load_kg and pos_y_mm where the axis file varies them; pitch_urad and yaw_urad of the level, µrad."""
        now = {"load_kg": self._axis.load_kg, "pos_y_mm": self._axis.other_axis_mm}
        return {
            **{name: now[name] for name in self._levels},
            "pitch_urad": self._axis.pitch_urad,
            "yaw_urad": self._axis.yaw_urad,
        }
