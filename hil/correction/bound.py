"""The bound of a correction: its largest value and its largest slope.

A measurement gone wrong (an instrument that froze, a unit mistaken by a factor) makes tables that move the axis by millimetres. Where
a correction is computed, stored, opened, downloaded or commanded, it is held against this bound and refused beyond it; it is never
clipped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from drivers.errors import CorrectionBoundError
from drivers.toml_types import Key, Positive
from hil.correction import MAX_CORRECTION_UM, MAX_SLOPE_UM_PER_MM
from hil.records.rows import Floats

SLOPE_OVER_MM = 1.0
"""The change of a correction is taken within any stretch of this length: shorter than any screw's lead, and longer than the distance
over which the noise of two readings looks steep."""

BEYOND_WITH_STRAIGHTNESS = "correction with straightness not commanded"

_SLACK = 1e-9  # of the rounding of a window's ends, mm, and of a sum, as a share


@dataclass(frozen=True)
class CorrectionBound:
    """max_um: largest correction, either sign, µm; max_slope_um_per_mm: largest change of it within 1 mm of travel, µm."""

    max_um: Annotated[Positive, Key("max_correction_um")] = MAX_CORRECTION_UM
    max_slope_um_per_mm: Positive = MAX_SLOPE_UM_PER_MM

    def check_values(self, what: str, position_mm: ArrayLike, direction: ArrayLike, correction_um: ArrayLike) -> None:
        """Corrections at single places, broadcast together. Raises CorrectionBoundError naming the worst of those beyond `max_um`."""
        places, signs, values = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(part, dtype=np.float64)) for part in (position_mm, direction, correction_um))
        )
        size = np.where(np.isfinite(values), np.abs(values), np.inf)
        if not size.size or not np.max(size) > self.max_um * (1 + _SLACK):
            return
        worst = int(np.argmax(size))
        raise CorrectionBoundError(
            f"{what}: {values[worst]:+.6g} µm at {places[worst]:g} mm ({_sign(signs[worst])}), expected at most"
            f" {self.max_um:g} µm ([correction] max_correction_um)"
        )

    def check_curves(self, what: str, position_mm: ArrayLike, curves_um: Mapping[int, ArrayLike]) -> None:
        """Corrections along the axis, by direction (+1, -1), straight between ascending positions and constant beyond them.

        Raises CorrectionBoundError naming the worst place.
        """
        nodes = np.asarray(position_mm, dtype=np.float64)
        curves = {sign: np.asarray(curve, dtype=np.float64) for sign, curve in curves_um.items()}
        self.check_values(
            what, np.tile(nodes, len(curves)), np.repeat(list(curves), len(nodes)), np.concatenate([*curves.values()])
        )
        changes = [(*_largest_change(nodes, curve), sign) for sign, curve in curves.items()]
        change_um, from_mm, to_mm, sign = max(changes)
        self._check_change(what, change_um, from_mm, to_mm, sign)

    def check_command(self, direction: int, near_mm: Sequence[float], near_um: Sequence[float]) -> None:
        """The correction of a command: first at the target, then at places within `SLOPE_OVER_MM` of each other; in each set-point.

        Raises CorrectionBoundError, upon which the command is not given.
        """
        what = "correction not commanded"
        if not abs(near_um[0]) <= self.max_um:
            self.check_values(what, near_mm[0], direction, near_um[0])
        low, high = min(near_um), max(near_um)
        change_um = high - low if all(map(math.isfinite, near_um)) else math.inf
        if not change_um <= self.max_slope_um_per_mm * SLOPE_OVER_MM:
            from_mm, to_mm = sorted((near_mm[near_um.index(low)], near_mm[near_um.index(high)]))
            self._check_change(what, change_um, from_mm, to_mm, direction)

    def _check_change(self, what: str, change_um: float, from_mm: float, to_mm: float, direction: int) -> None:
        if change_um <= self.max_slope_um_per_mm * SLOPE_OVER_MM * (1 + _SLACK):
            return
        raise CorrectionBoundError(
            f"{what}: changes by {change_um:.6g} µm between {from_mm:.6g} and {to_mm:.6g} mm ({_sign(direction)}), expected at most"
            f" {self.max_slope_um_per_mm:g} µm within {SLOPE_OVER_MM:g} mm ([correction] max_slope_um_per_mm)"
        )


CAREFUL = CorrectionBound()
"""The default bound, of an axis whose file states none."""


def _sign(direction: float) -> str:
    return "+" if direction > 0 else "−"


def _largest_change(nodes: Floats, curve: Floats) -> tuple[float, float, float]:
    """The largest change, µm, within any stretch of `SLOPE_OVER_MM`, with the stretch's ends, mm.

    The curve is straight between nodes, so at one end of the worst stretch there is a node.
    """
    places = np.unique(np.concatenate([nodes, nodes - SLOPE_OVER_MM, nodes + SLOPE_OVER_MM]))
    values = np.interp(places, nodes, curve)
    worst = (0.0, float(places[0]), float(places[0]))
    for apart in range(1, len(places)):
        near = places[apart:] - places[:-apart] <= SLOPE_OVER_MM + _SLACK
        if not near.any():
            break
        change = np.where(near, np.abs(values[apart:] - values[:-apart]), 0.0)
        at = int(np.argmax(change))
        worst = max(worst, (float(change[at]), float(places[at]), float(places[at + apart])))
    return worst
