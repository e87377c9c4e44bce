"""From measured reversals to one rise with its uncertainties: shapes in competition over the load's own travel.

What may go in: pure functions of reversals. How they are measured is `hil.lost_motion.procedure`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.errors import InputError
from hil.correction.rise import RUNNABLE, TWO_TANH, Rise
from hil.lost_motion.fit import Contender, MeasuredReversal, compete, uncertainties

AS_GOOD = 1.1
"""Two tanh terms are taken unless another shape's held-out RMS is smaller by more than this ratio."""
STILL_RISING = 0.03
"""Share of the lost motion that may come back over the second half of what was measured."""
SURE = 2.0
"""A single amount or length of a sum stands for itself from so many of its own standard uncertainties on."""
LEAST_SHARE = 1e-3
"""Of the whole, below which a single amount is none."""
NOT_SEPARATE = "not determined one by one, only their sum"
"""Said of single amounts."""


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
    def told(self) -> dict[str, Uncertain]:
        """The parameters that are determined: see `told`."""
        return told(self.parameters)

    @property
    def still_rising(self) -> bool:
        """Whether the strokes were too short for the whole lost motion."""
        return self.late_um > STILL_RISING * self.amount_um

    def to_json(self) -> dict[str, Any]:
        return {
            "rise": self.rise.to_json(),
            "amount_um": self.amount_um,
            "parameters": _plain(self.parameters),
            "determined": sorted(self.told),
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
    published = uncertain(two_tanh.fitted.rise, by_load, shortest_mm)
    parameters = published if chosen is two_tanh else uncertain(rise, by_load, shortest_mm)
    end_mm = max(float(reversal.travel_mm.max()) for reversal in by_load)
    late_um = rise.risen_um(end_mm) - rise.risen_um(end_mm / 2.0)
    return Estimate(rise, parameters, published, contenders, tuple(reversals), late_um)


def _plain(parameters: Mapping[str, Uncertain]) -> dict[str, dict[str, float]]:
    return {name: {"value": each.value, "std": each.std} for name, each in parameters.items()}


def uncertain(rise: Rise, reversals: Sequence[MeasuredReversal], shortest_mm: float) -> dict[str, Uncertain]:
    """Parameters under the names people use, each with its standard uncertainty; of straight pieces the whole amount alone.

    rise: as it was fitted to these reversals, over the load's travel; shortest_mm: no rise was to be shorter.
    """
    shape, amounts, lengths = rise.shape, rise.amounts_um, rise.lengths_mm
    u_whole, u_amounts, u_lengths = uncertainties(rise, reversals, shortest_mm)
    found = {"amount_um": Uncertain(rise.amount_um, u_whole)}
    if shape.knots:
        return found
    if len(amounts) > 1:
        found |= {f"amount_{k + 1}_um": Uncertain(amounts[k], u_amounts[k]) for k in range(len(amounts))}
    found |= {f"rise_{k + 1}_mm": Uncertain(lengths[k], u_lengths[k]) for k in range(shape.rises)}
    return found | ({"onset_2_mm": Uncertain(lengths[-1], u_lengths[-1])} if shape.onsets else {})


def separate(parameters: Mapping[str, Uncertain]) -> bool:
    """Whether the amounts of a sum of terms are determined one by one; True for a shape of one term.

    Where one term would do, two can share its amount in any way: each is then as good as unknown, though their sum is sharp.
    """
    whole_um = parameters["amount_um"].value
    singles = [each for name, each in parameters.items() if _is_single(name)]
    return all(one.value > max(SURE * one.std, LEAST_SHARE * whole_um) for one in singles)


def told(parameters: Mapping[str, Uncertain]) -> dict[str, Uncertain]:
    """All of them; where single amounts are not determined the whole one instead, and the lengths that are."""
    if separate(parameters):
        return dict(parameters)
    kept = (name for name in parameters if name != "amount_um" and not _is_single(name))
    sure = {name: each for name in kept if (each := parameters[name]).value > SURE * each.std > 0.0}
    return {"amount_um": parameters["amount_um"], **sure}


def _is_single(name: str) -> bool:
    return name.startswith("amount_") and name != "amount_um"
