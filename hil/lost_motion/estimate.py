"""From measured reversals to one rise with its uncertainties: shapes in competition over the load's own travel.

What may go in: pure functions of reversals. How they are measured is `hil.procedures.lost_motion`'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.lost_motion.fit import Contender, MeasuredReversal, compete, refit
from hil.lost_motion.shapes import RUNNABLE, TWO_TANH, Rise

DRAWS = 60
"""Bootstrap draws of whole strokes: standard uncertainties to a tenth of themselves."""
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


def estimate(reversals: Sequence[MeasuredReversal], shortest_mm: float, seed: int) -> Estimate:
    """The rise of these reversals, of which all that belongs to the place alone has been taken out.

    shortest_mm: no rise is shorter. Raises InputError with fewer than 3 reversals: one has to be left out, and some be drawn.
    """
    if len(reversals) < 3:
        raise InputError(f"{len(reversals)} reversals, expected at least 3")
    by_load = [reversal.by_load() for reversal in reversals]
    contenders = compete(by_load, shortest_mm, RUNNABLE, table=False)
    two_tanh = next(one for one in contenders if one.fitted.shape is TWO_TANH)
    chosen = two_tanh if two_tanh.held_out_rms_um <= AS_GOOD * contenders[0].held_out_rms_um else contenders[0]
    rise = chosen.fitted.rise
    published = _uncertain(two_tanh, by_load, shortest_mm, seed)
    parameters = published if chosen is two_tanh else _uncertain(chosen, by_load, shortest_mm, seed)
    end_mm = max(float(reversal.travel_mm.max()) for reversal in by_load)
    late_um = rise.risen_um(end_mm) - rise.risen_um(end_mm / 2.0)
    return Estimate(rise, parameters, published, contenders, tuple(reversals), late_um)


def _plain(parameters: Mapping[str, Uncertain]) -> dict[str, dict[str, float]]:
    return {name: {"value": each.value, "std": each.std} for name, each in parameters.items()}


def _named(rise: Rise) -> dict[str, float]:
    """Parameters under the names people use."""
    found = {"amount_um": rise.amount_um}
    shape = rise.shape
    if shape.knots:
        return found
    found |= {f"amount_{k}_um": amount for k, amount in enumerate(rise.amounts_um, start=1) if len(rise.amounts_um) > 1}
    lengths = rise.lengths_mm
    found |= {f"rise_{k}_mm": lengths[k - 1] for k in range(1, shape.rises + 1)}
    return found | ({"onset_2_mm": lengths[shape.rises]} if shape.onsets else {})


def _uncertain(
    chosen: Contender, reversals: Sequence[MeasuredReversal], shortest_mm: float, seed: int
) -> dict[str, Uncertain]:
    """Standard uncertainties by a bootstrap over whole strokes; n draws of n spread too little by √((n − 1)/n): made up for."""
    rng = np.random.default_rng(seed)
    n = len(reversals)
    values = _named(chosen.fitted.rise)
    drawn: dict[str, list[float]] = {name: [] for name in values}
    for _ in range(DRAWS):
        some = [reversals[index] for index in rng.integers(0, n, n)]
        for name, value in _named(refit(chosen.fitted, some, shortest_mm, table=False).rise).items():
            drawn[name].append(value)
    more = math.sqrt(n / (n - 1.0))
    return {name: Uncertain(value, more * float(np.std(drawn[name], ddof=1))) for name, value in values.items()}
