"""The published form of two tanh terms beside the running form, on the moves of the proof: the reference, with its branches and
partial strokes (priority JP 2013-016617, technical solutions 3 to 6). Nothing runs by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hil.correction.published_rise import PublishedMove, TwoTanh, published_moves
from hil.correction.rise import TWO_TANH
from hil.correction.running_lost_motion import Turns, wound_um
from hil.effects.history import remembered
from hil.lost_motion.estimate import ReversalFit


@dataclass(frozen=True)
class BesidePublished:
    """moves: by the published form; running_um: for each of them, what the running form with the same five parameters has changed
    since the reversal before it, with the sign of the motion's direction as P has.
    """

    form: TwoTanh
    moves: tuple[PublishedMove, ...]
    running_um: tuple[float, ...]

    @property
    def apart_um(self) -> float:
        """The largest difference of the two forms after a move."""
        return max((abs(m.published_um - r) for m, r in zip(self.moves, self.running_um, strict=True)), default=0.0)

    @property
    def step_um(self) -> float:
        """The largest step of the published form at a reversal itself; the running form has none."""
        return max((abs(move.start_um) for move in self.moves), default=0.0)

    @property
    def sentence(self) -> str:
        """What the comparison shows."""
        first = sum(move.branch == 1 for move in self.moves)
        scaled = sum(move.stroke_mm < self.form.onset_2_mm for move in self.moves)
        return (
            f"for comparison, not in force: the two tanh terms of the published document would correct these {len(self.moves)} moves"
            f" differently by up to {self.apart_um:.2f} µm, and step by up to {self.step_um:.2f} µm at a reversal"
            f" ({first} by its case for a small last correction, {scaled} after a stroke too short for its second term)"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the symbols of the document."""
        form = self.form
        names = ("Pc1_um", "Pc2_um", "a1_mm", "a2_mm", "b2_mm")
        values = (form.amount_1_um, form.amount_2_um, form.rise_1_mm, form.rise_2_mm, form.onset_2_mm)
        return {
            "parameters": dict(zip(names, values, strict=True)),
            "largest_difference_um": self.apart_um,
            "largest_step_um": self.step_um,
            "moves": [
                {
                    "target_mm": move.target_mm,
                    "direction": move.direction,
                    "travel_mm": move.travel_mm if math.isfinite(move.travel_mm) else None,
                    "xbm_mm": move.stroke_mm if math.isfinite(move.stroke_mm) else None,
                    "Pbm_um": move.last_um,
                    "branch": move.branch,
                    "published_um": move.published_um,
                    "running_um": running,
                }
                for move, running in zip(self.moves, self.running_um, strict=True)
            ],
        }


def beside_published(found: ReversalFit, targets_mm: Sequence[float]) -> BesidePublished:
    """Both forms along the targets of straight moves; the first target was reached by a full stroke in −."""
    rise = next(one.fitted.rise for one in found.contenders if one.fitted.shape is TWO_TANH)
    start_mm, *others = targets_mm
    moves = published_moves(rise.form, start_mm, -1, others)
    here_mm, direction, turns, running = start_mm, -1, Turns(), []
    at_turn_um = rise.amount_um  # where the full stroke in − began
    for move in moves:
        if move.direction != direction:
            at_turn_um = wound_um(rise, here_mm, direction, turns)
        turns = remembered(turns, here_mm, direction, move.target_mm)
        here_mm, direction = move.target_mm, move.direction
        running.append(wound_um(rise, here_mm, direction, turns) - at_turn_um)
    return BesidePublished(rise.form, moves, tuple(running))
