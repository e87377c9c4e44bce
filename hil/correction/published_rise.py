"""The published form of the correction after a reversal: two tanh terms (priority JP 2013-016617, technical solutions 3 to 6).

It is the reference for `running_lost_motion`. P counts from the side on which the stroke starts, so it restarts at each reversal and
steps between strokes that were not full: it cannot be used to run a machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from drivers.errors import InputError


@dataclass(frozen=True)
class TwoTanh:
    """The five parameters. On a rotary axis read degrees for mm and thousandths of a degree for µm.

    amount_1_um, amount_2_um: Pc1, Pc2, ≥ 0; rise_1_mm, rise_2_mm: a1, a2, > 0; onset_2_mm: b2, ≥ 0, the travel at which the second
    term begins. Raises InputError for anything else.
    """

    amount_1_um: float
    amount_2_um: float
    rise_1_mm: float
    rise_2_mm: float
    onset_2_mm: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and field.name.startswith("rise")):
                wanted = "> 0" if field.name.startswith("rise") else "≥ 0"
                raise InputError(f"{field.name} is {value:g}, expected a finite number {wanted}")

    @property
    def amount_um(self) -> float:
        """The whole lost motion, Pc1 + Pc2."""
        return self.amount_1_um + self.amount_2_um

    def risen_um(self, travel_mm: float) -> float:
        """Correction reached after this travel, mm, since the reversal that ended a full stroke: 0 … `amount_um`, µm."""
        risen = self.amount_1_um * math.tanh(travel_mm / self.rise_1_mm)
        if travel_mm > self.onset_2_mm:
            risen += self.amount_2_um * math.tanh((travel_mm - self.onset_2_mm) / self.rise_2_mm)
        return risen


def published_um(form: TwoTanh, direction: int, travel_mm: float, stroke_mm: float, last_um: float) -> float:
    """P, µm, in the axis's sign.

    direction: of the motion after the reversal, +1 or -1; travel_mm: x', ≥ 0, since the reversal; stroke_mm: xbm, ≥ 0, travel of the
    stroke before; last_um: Pbm, the last correction of that stroke, of which only the magnitude counts. The source leaves
    |Pbm| = Pc2 open; here it belongs to the second branch.
    Raises InputError for a direction that is neither, a travel below 0, or a stroke of 0 that would have to be scaled by.
    """
    if direction not in (1, -1):
        raise InputError(f"direction is {direction}, expected +1 or -1")
    if not (travel_mm >= 0.0 and stroke_mm >= 0.0 and math.isfinite(last_um)):
        raise InputError(
            f"travel {travel_mm} mm, stroke {stroke_mm} mm, last correction {last_um} µm: expected ≥ 0 and finite"
        )
    travel_mm = _scaled_mm(form, travel_mm, stroke_mm)
    last = abs(last_um)
    if last < form.amount_2_um:
        amount = (form.amount_um - last) + last * math.tanh(travel_mm / form.rise_2_mm)
    else:
        amount = (last - form.amount_2_um) * math.tanh(travel_mm / form.rise_1_mm)
        if travel_mm > form.onset_2_mm:
            amount += form.amount_2_um * math.tanh((travel_mm - form.onset_2_mm) / form.rise_2_mm)
    return direction * amount


@dataclass(frozen=True)
class PublishedMove:
    """The published form at the end of one move; symbols as there: travel_mm x', stroke_mm xbm, last_um |Pbm|, published_um P.

    branch: 1 for |Pbm| < Pc2, else 2; start_um: P at the reversal itself, other than 0 in branch 1 alone.
    """

    target_mm: float
    direction: int
    travel_mm: float
    stroke_mm: float
    last_um: float
    branch: int
    start_um: float
    published_um: float


def published_moves(
    form: TwoTanh, start_mm: float, direction: int, targets_mm: Sequence[float]
) -> tuple[PublishedMove, ...]:
    """The published form along straight moves that begin at start_mm, reached by a full stroke in `direction`.

    Moves of no length are left out. Raises InputError as `published_um`.
    """
    here_mm, turned_mm, stroke_mm = start_mm, -direction * math.inf, math.inf
    last_um = now_um = form.amount_um
    found = []
    for target_mm in targets_mm:
        if target_mm == here_mm:
            continue
        way = 1 if target_mm > here_mm else -1
        if way != direction:
            stroke_mm, last_um = abs(here_mm - turned_mm), abs(now_um)
            turned_mm, direction = here_mm, way
        travel_mm = abs(target_mm - turned_mm)
        now_um = published_um(form, way, travel_mm, stroke_mm, last_um)
        at_once_um = published_um(form, way, 0.0, stroke_mm, last_um)
        branch = 1 if last_um < form.amount_2_um else 2
        found.append(PublishedMove(target_mm, way, travel_mm, stroke_mm, last_um, branch, at_once_um, now_um))
        here_mm = target_mm
    return tuple(found)


def _scaled_mm(form: TwoTanh, travel_mm: float, stroke_mm: float) -> float:
    """x't: the travel, stretched after a stroke too short for the second term to begin."""
    if form.onset_2_mm == 0.0 or form.onset_2_mm <= stroke_mm:
        return travel_mm
    if stroke_mm == 0.0:
        raise InputError("the stroke before the reversal is 0 mm: there was no reversal")
    return travel_mm * (form.onset_2_mm / stroke_mm)
