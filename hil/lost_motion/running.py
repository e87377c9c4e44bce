"""The form that runs: the wind-up as a state, carried from set-point to set-point, with no step at any reversal.

After each reversal the correction follows the rise that was measured after a full stroke, from wherever it stood, in either
direction. A stroke that passes the place of the reversal before last closes a loop: the loop is forgotten, and the stroke goes on
along the branch the loop interrupted, which it meets exactly there (Masing's rules for rate-independent hysteresis; Masing 1926).
So the correction moves between its two ends for any sequence of strokes, and after full ones equals the published form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import InputError
from hil.lost_motion.published import TwoTanh


@dataclass(frozen=True)
class Turn:
    """A reversal that is still remembered: where, and the correction there."""

    position_mm: float
    correction_um: float


@dataclass(frozen=True)
class WindUp:
    """The state. position_mm: last set-point; direction: of the motion that ended there; turns: the reversals that matter.

    The oldest turn comes first. Without turns a full stroke has ended. Each turn lies within the loop of the two before it.
    """

    position_mm: float
    direction: int
    turns: tuple[Turn, ...] = ()

    def __post_init__(self) -> None:
        if self.direction not in (1, -1) or not math.isfinite(self.position_mm):
            raise InputError(
                f"position {self.position_mm:g} mm, direction of arrival {self.direction}: expected a finite position and +1 or -1"
            )

    def correction_um(self, form: TwoTanh) -> float:
        """What to add to the command, µm: 0 after a full stroke in −, `form.amount_um` after one in +, between them otherwise.

        It counts from the − side; a table whose + direction holds the lost motion already has to be given less that amount there.
        """
        if not self.turns:
            return form.amount_um if self.direction > 0 else 0.0
        turn = self.turns[-1]
        return turn.correction_um + self.direction * form.risen_um(abs(self.position_mm - turn.position_mm))


def after_full_stroke(position_mm: float, direction: int) -> WindUp:
    """Where to start: at a place reached by a long motion in a known direction. Raises InputError for any direction but +1 and -1."""
    return WindUp(position_mm, direction)


def moved_to(form: TwoTanh, state: WindUp, position_mm: float) -> tuple[WindUp, float]:
    """The state after a straight motion to a set-point, and the correction there in µm; a motion of no length changes nothing.

    How a motion is cut into set-points makes no difference. Raises InputError for a position that is not finite.
    """
    if not math.isfinite(position_mm):
        raise InputError(f"set-point is {position_mm} mm, expected a finite position")
    if position_mm == state.position_mm:
        return state, state.correction_um(form)
    direction = 1 if position_mm > state.position_mm else -1
    turns = state.turns
    if direction != state.direction:
        turns = (*turns, Turn(state.position_mm, state.correction_um(form)))
    while len(turns) >= 2 and direction * (position_mm - turns[-2].position_mm) >= 0.0:
        turns = turns[:-2]
    after = WindUp(position_mm, direction, turns)
    return after, after.correction_um(form)
