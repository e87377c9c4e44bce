"""The running form of the lost motion: the wind-up as a state from set-point to set-point, without a step at a reversal.

After each reversal the correction follows the rise that was measured after a full stroke, from wherever it stood, in either
direction. A stroke that passes the place of the reversal before last closes a loop: the loop is forgotten, and the stroke goes on
along the branch the loop interrupted, which it meets exactly there (Masing's rules for rate-independent hysteresis; Masing 1926).
So the correction moves between its two ends for any sequence of strokes, and after full strokes equals the published form.
The state consists of the places of the reversals alone; the form is used only to compute a correction.
"""

from __future__ import annotations

from itertools import pairwise

from hil.correction.rise import FULL_UM, Rises

Turns = tuple[float, ...]
"""Places, mm, of the reversals that are still remembered, the oldest first. Without any a full stroke has ended.

Each lies within the loop of the two before it.
"""


def wound_at_turn_um(form: Rises, direction: int, turns: Turns) -> float:
    """The wind-up at the last of the turns, from which the motion goes on in this direction; without one, where it stays."""
    sign = direction if len(turns) % 2 == 0 else -direction  # of the full stroke that the oldest turn ended
    wound = form.amount_um if sign > 0 else 0.0
    for start, end in pairwise(turns):
        sign = -sign
        wound += sign * form.risen_um(abs(end - start))
    return wound


def wound_um(form: Rises, position_mm: float, direction: int, turns: Turns) -> float:
    """0 after a full stroke in −, `form.amount_um` after one in +, between them otherwise."""
    wound = wound_at_turn_um(form, direction, turns)
    return wound + direction * form.risen_um(abs(position_mm - turns[-1])) if turns else wound


def share_of(wound: float, amount_um: float) -> float:
    """A wind-up as a share of the whole, 0 … 1."""
    return min(1.0, max(0.0, wound / amount_um))


def wound_share(form: Rises, position_mm: float, direction: int, turns: Turns) -> float:
    """`wound_um` as a share of the whole, 0 … 1: 0 at the correction of the - direction, 1 at that of the + direction."""
    if form.amount_um < FULL_UM:
        return 1.0 if direction > 0 else 0.0
    return share_of(wound_um(form, position_mm, direction, turns), form.amount_um)
