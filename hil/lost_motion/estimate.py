"""From measured reversals to one rise with its uncertainties: shapes in competition over the load's own travel.

What may go in: pure functions of reversals. How they are measured is `hil.procedures.lost_motion`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.errors import InputError
from hil.lost_motion.fit import Contender, MeasuredReversal, compete, uncertainties
from hil.lost_motion.shapes import RUNNABLE, TWO_TANH, Rise

AS_GOOD = 1.1
"""Two tanh terms are taken unless another shape's held-out RMS is smaller by more than this ratio."""
STILL_RISING = 0.03
"""Share of the lost motion that may come back over the second half of what was measured."""


@dataclass(frozen=True)
class Uncertain:
    """A value with its standard uncertainty."""

    value: float
    std: float

    def __str__(self) -> str:
        return f"{self.value:.4g} ± {self.std:.2g}"


@dataclass(frozen=True)
class Estimate:
    """What some reversals come to.

    rise: over the load's travel; parameters: of it, and published: of the two tanh terms, by name with standard uncertainties;
    contenders: the best on held-out strokes first; reversals: as measured, over the motor's travel; late_um: what came back over the
    second half of the travel measured
    """

    rise: Rise
    parameters: dict[str, Uncertain]
    published: dict[str, Uncertain]
    contenders: tuple[Contender, ...]
    reversals: tuple[MeasuredReversal, ...]
    late_um: float

    @property
    def amount_um(self) -> float:
        return self.rise.amount_um

    @property
    def still_rising(self) -> bool:
        """Whether the strokes were too short for the whole lost motion."""
        return self.late_um > STILL_RISING * self.amount_um

    def to_json(self) -> dict[str, Any]:
        return {
            "rise": self.rise.to_json(),
            "amount_um": self.amount_um,
            "parameters": _plain(self.parameters),
            "published": _plain(self.published),
            "late_um": self.late_um,
            "contenders": [
                {
                    "rise": one.fitted.rise.to_json(),
                    "rms_um": one.rms_um,
                    "held_out_rms_um": one.held_out_rms_um,
                }
                for one in self.contenders
            ],
        }


def estimate(reversals: Sequence[MeasuredReversal], shortest_mm: float) -> Estimate:
    """The rise of these reversals, of which all that belongs to the place alone has been taken out.

    shortest_mm: no rise is shorter. Raises InputError with fewer than 3 reversals: one has to be left out.
    """
    if len(reversals) < 3:
        raise InputError(f"{len(reversals)} reversals, expected at least 3")
    by_load = [reversal.by_load() for reversal in reversals]
    contenders = compete(by_load, shortest_mm, RUNNABLE, table=False)
    two_tanh = next(one for one in contenders if one.fitted.shape is TWO_TANH)
    chosen = two_tanh if two_tanh.held_out_rms_um <= AS_GOOD * contenders[0].held_out_rms_um else contenders[0]
    rise = chosen.fitted.rise
    published = _uncertain(two_tanh, by_load, shortest_mm)
    parameters = published if chosen is two_tanh else _uncertain(chosen, by_load, shortest_mm)
    end_mm = max(float(reversal.travel_mm.max()) for reversal in by_load)
    late_um = rise.risen_um(end_mm) - rise.risen_um(end_mm / 2.0)
    return Estimate(rise, parameters, published, contenders, tuple(reversals), late_um)


def _plain(parameters: Mapping[str, Uncertain]) -> dict[str, dict[str, float]]:
    return {name: {"value": each.value, "std": each.std} for name, each in parameters.items()}


def _uncertain(chosen: Contender, reversals: Sequence[MeasuredReversal], shortest_mm: float) -> dict[str, Uncertain]:
    """Parameters under the names people use, each with its standard uncertainty; of straight pieces the whole amount alone."""
    rise = chosen.fitted.rise
    shape, amounts, lengths = rise.shape, rise.amounts_um, rise.lengths_mm
    u_whole, u_amounts, u_lengths = uncertainties(rise, reversals, shortest_mm)
    found = {"amount_um": Uncertain(rise.amount_um, u_whole)}
    if shape.knots:
        return found
    if len(amounts) > 1:
        found |= {f"amount_{k + 1}_um": Uncertain(amounts[k], u_amounts[k]) for k in range(len(amounts))}
    found |= {f"rise_{k + 1}_mm": Uncertain(lengths[k], u_lengths[k]) for k in range(shape.rises)}
    return found | ({"onset_2_mm": Uncertain(lengths[-1], u_lengths[-1])} if shape.onsets else {})
