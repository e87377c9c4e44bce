"""The wind-up of the running form as a state of its own, which tests carry from set-point to set-point."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh
from hil.correction.rise import Rises
from hil.correction.running_lost_motion import Turns, wound_um
from hil.effects.history import remembered


@dataclass(frozen=True)
class WindUp:
    """The state. position_mm: last set-point; direction: of the motion that ended there; turns_mm: the reversals that matter."""

    position_mm: float
    direction: int
    turns_mm: Turns = ()

    def __post_init__(self) -> None:
        if self.direction not in (1, -1) or not math.isfinite(self.position_mm):
            raise InputError(
                f"position {self.position_mm:g} mm, direction of arrival {self.direction}: expected a finite position and +1 or -1"
            )

    def correction_um(self, form: Rises) -> float:
        """What to add to the command, µm: 0 after a full stroke in −, `form.amount_um` after one in +, between them otherwise.

        It counts from the − side; beside tables, which hold both ends already, only the share in between is used
        (`hil.correction.compensation`).
        """
        return wound_um(form, self.position_mm, self.direction, self.turns_mm)


def moved_to(form: Rises, state: WindUp, position_mm: float) -> tuple[WindUp, float]:
    """The state after a straight motion to a set-point, and the correction there in µm; a motion of no length changes nothing.

    How a motion is cut into set-points makes no difference. Raises InputError for a position that is not finite.
    """
    if not math.isfinite(position_mm):
        raise InputError(f"set-point is {position_mm} mm, expected a finite position")
    if position_mm == state.position_mm:
        return state, state.correction_um(form)
    turns = remembered(state.turns_mm, state.position_mm, state.direction, position_mm)
    after = WindUp(position_mm, 1 if position_mm > state.position_mm else -1, turns)
    return after, after.correction_um(form)


def steepest_um_per_mm(form: TwoTanh) -> float:
    """Upper bound of the slope of the published rise, µm/mm."""
    first = form.amount_1_um / form.rise_1_mm
    # tanh is steepest where it begins, so the sum is where one of its terms does
    late = math.exp(-form.onset_2_mm / form.rise_1_mm)
    sech = 2.0 * late / (1.0 + late * late)
    return max(first, first * sech * sech + form.amount_2_um / form.rise_2_mm)
