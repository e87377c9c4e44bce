"""The curve that a drive's own table adds at the load: from raw numbers in the drive's frame to µm in the axis's frame.

Signs: on an axis whose counts fall when the table advances (`AxisScaling.direction` -1) the drive's curve for rising
counts applies to the - direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drivers.correction_table import Directions, Interpolation, Outside, RawTable, TableDescription
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.correction.bound import CorrectionBound
from hil.correction.tables import DirectionalTable
from hil.records.rows import UM_PER_MM, Floats

_BESIDE_UM = 1e-4  # distance from a node at which a curve with steps is evaluated on either side


@dataclass(frozen=True)
class DriveCurve:
    """A drive's table with the description and scaling that convert it."""

    description: TableDescription
    raw: RawTable
    scaling: AxisScaling

    @property
    def nodes_mm(self) -> Floats:
        """Positions of its nodes at the load, mm, ascending, shape (m,)."""
        return (
            np.sort(self._nodes_um()) / UM_PER_MM
            if self.scaling.direction > 0
            else np.sort(-self._nodes_um()) / UM_PER_MM
        )

    def correction_um(self, position_mm: ArrayLike, direction: ArrayLike) -> Floats:
        """The amount added at nominal positions (mm) arrived at in a direction (+1, -1), µm at the load, broadcast
        together.

        An empty table adds nothing.
        """
        place_um = self.scaling.direction * np.asarray(position_mm, dtype=np.float64) * UM_PER_MM
        rising = np.asarray(direction, dtype=np.float64) * self.scaling.direction > 0
        plus, minus = self._curves_um()
        value = np.where(rising, self._between(place_um, plus), self._between(place_um, minus))
        return np.asarray(self.scaling.direction * value, dtype=np.float64)

    def value_um(self, raw: int) -> float:
        """The raw value that a drive shows as its present correction, in µm at the load."""
        found = self.description
        return self.scaling.direction * found.sign * raw * found.value.um(self.scaling)

    @property
    def step_um(self) -> float:
        """Distance of two values that a drive can show, µm at the load, above zero."""
        return abs(self.value_um(1))

    def _nodes_um(self) -> Floats:
        return np.array(self.raw.nodes, dtype=np.float64) * self.description.position.um(self.scaling)

    def _curves_um(self) -> tuple[Floats, Floats]:
        """The amounts at the nodes for rising and for falling counts, in the drive's frame."""
        found, raw = self.description, self.raw
        step_um = found.sign * found.value.um(self.scaling)
        plus = np.array(raw.plus, dtype=np.float64) * step_um
        if found.directions is Directions.BOTH:
            return plus, np.array(raw.minus, dtype=np.float64) * step_um
        less = 0.0
        if found.directions is Directions.BACKLASH and found.backlash is not None:
            less = found.sign * raw.backlash * found.backlash.um(self.scaling)
        return plus, plus - less

    def _between(self, place_um: Floats, values: Floats) -> Floats:
        nodes = self._nodes_um()
        if not len(nodes):
            return np.zeros_like(place_um)
        if self.description.interpolation is Interpolation.LINEAR:
            found = np.interp(place_um, nodes, values)
        else:
            found = values[np.maximum(np.searchsorted(nodes, place_um, side="right") - 1, 0)]
        if self.description.outside is Outside.ZERO:
            found = np.where((place_um < nodes[0]) | (place_um > nodes[-1]), 0.0, found)
        return np.asarray(found, dtype=np.float64)


def largest_deviation_um(curve: DriveCurve, wanted: DirectionalTable, low_mm: float, high_mm: float) -> float:
    """The largest difference between the drive's curve and the wanted one from low_mm to high_mm in either direction,
    µm.

    Both are piecewise linear, so it lies on a node of one of them, or directly beside one where a curve has a step.
    """
    beside_mm = _BESIDE_UM / UM_PER_MM
    nodes = curve.nodes_mm
    places = np.concatenate([wanted.position_mm, nodes - beside_mm, nodes, nodes + beside_mm, [low_mm, high_mm]])
    places = places[(places >= low_mm) & (places <= high_mm)]
    return max(float(np.max(np.abs(curve.correction_um(places, sign) - wanted.at(places, sign)))) for sign in (1, -1))


def check_curve(curve: DriveCurve, limits: DriveLimits, bound: CorrectionBound) -> None:
    """Checks the drive's correction over the travel against the axis's bound. Raises CorrectionBoundError."""
    beside_mm = _BESIDE_UM / UM_PER_MM
    nodes = curve.nodes_mm
    places = np.concatenate([nodes - beside_mm, nodes, nodes + beside_mm])
    low, high = limits.travel_min_mm, limits.travel_max_mm
    places = np.unique(np.concatenate([places[(places > low) & (places < high)], [low, high]]))
    curves = {sign: curve.correction_um(places, sign) for sign in (1, -1)}
    bound.check_curves(f"{curve.description.name}: what the drive would add by its table", places, curves)
