"""The torque recorded through one reversal: step by step with the axis at rest at each, or while it creeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.records.rows import Floats


@dataclass(frozen=True)
class ReversalTrace:
    """One reversal. direction: of the motion after it, +1 or -1.

    position_load_mm: shape (n,), by the motor's encoder; the first is the reversal
    torque_percent: shape (n, k), k readings at each position, % of rated, with the axis's sign
    slides_percent: shape (m, k), the same after each of m longer moves in the new direction, once the table slides; m
    may be 0
    weight_percent: torque that holds the table of a vertical axis, in the axis's sign
    creep_um_s: speed at which the torques were read, 0: at rest
    Raises InputError for another direction or shapes that do not agree.
    """

    direction: int
    position_load_mm: Floats
    torque_percent: Floats
    slides_percent: Floats = field(default_factory=lambda: np.empty((0, 1)))
    weight_percent: float = 0.0
    creep_um_s: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.position_load_mm)
        if self.direction not in (1, -1) or n == 0 or self.torque_percent.shape[:1] != (n,):
            raise InputError(
                f"reversal in direction {self.direction} with {n} places and torques of shape {self.torque_percent.shape},"
                " expected +1 or -1 and one row of torques for each place"
            )

    @property
    def travel_um(self) -> Floats:
        """Travel of the motor since the reversal, µm, shape (n,), > 0 in the new direction."""
        travel = self.direction * (self.position_load_mm - self.position_load_mm[0]) * 1000.0
        return np.asarray(travel + 0.0, dtype=np.float64)  # no −0

    @property
    def rising_percent(self) -> Floats:
        """Mean torque at each position, less the weight, in the sense of the new direction, shape (n,): rises from
        below 0 to above.
        """
        return self._rising(self.torque_percent)

    @property
    def slides_rising_percent(self) -> Floats:
        """The same after each slide, shape (m,)."""
        return self._rising(self.slides_percent)

    def _rising(self, readings_percent: Floats) -> Floats:
        return np.asarray(self.direction * (readings_percent.mean(axis=1) - self.weight_percent), dtype=np.float64)

    def to_json(self) -> dict[str, Any]:
        """Plain values, for a file."""
        return {
            "direction": self.direction,
            "position_load_mm": self.position_load_mm.tolist(),
            "torque_percent": self.torque_percent.tolist(),
            "slides_percent": self.slides_percent.tolist(),
            "weight_percent": self.weight_percent,
            "creep_um_s": self.creep_um_s,
        }


def read_trace(form: Mapping[str, Any]) -> ReversalTrace:
    """A trace from `ReversalTrace.to_json`. Raises InputError for a form that is none."""
    try:
        slides = np.asarray(form["slides_percent"], dtype=np.float64)
        return ReversalTrace(
            int(form["direction"]),
            np.asarray(form["position_load_mm"], dtype=np.float64),
            np.asarray(form["torque_percent"], dtype=np.float64),
            slides if slides.ndim == 2 else np.empty((0, 1)),
            float(form.get("weight_percent", 0.0)),
            float(form.get("creep_um_s", 0.0)),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("holds a reversal that cannot be read") from error


def crept_trace(
    direction: int,
    position_load_mm: Floats,
    torque_percent: Floats,
    *,
    step_um: float,
    creep_um_s: float,
    weight_percent: float = 0.0,
) -> ReversalTrace:
    """The trace of readings taken while the motor creeps, averaged over each step_um of travel.

    position_load_mm, torque_percent: shape (n,), the first at rest at the reversal. Readings without motion since the one before
    are left out, since a motor at rest needs no torque for its own friction; so is the last step, which was not gone through.
    """
    travel_um = 1000.0 * direction * (position_load_mm - position_load_mm[0])
    moved = np.diff(np.maximum.accumulate(travel_um), prepend=0.0) > 0.0
    step = (travel_um // step_um).astype(np.int64)
    last = int(step[moved].max()) if moved.any() else 0
    places, torques = [float(position_load_mm[0])], [float(torque_percent[0])]
    for number in range(last):
        inside = moved & (step == number)
        if inside.any():
            places.append(float(position_load_mm[inside].mean()))
            torques.append(float(torque_percent[inside].mean()))
    column = np.array(torques)[:, None]
    return ReversalTrace(direction, np.array(places), column, weight_percent=weight_percent, creep_um_s=creep_um_s)
