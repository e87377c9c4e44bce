"""A generic search for structure in what the catalogue leaves: smooth functions of columns and of pairs of columns.

What may go in: blocks that stand for "something depends on this", with no physics in them. They decide "unexplained", and they compete
with catalogue effects so that a cause outside the catalogue is not given a catalogue name because it resembles one.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import Campaign
from hil.diagnosis.candidates import Blocks, Stack
from hil.diagnosis.evidence import Whitened
from hil.effects.history import LONG_STROKE_MM

Floats = NDArray[np.float64]

SKIPPED = frozenset({"run", "measured_mm", "command_mm", "direction", "row_order"})
FINE = 4
"""Hat functions per knot interval of the table in the search for structure finer than the table."""


@dataclass(frozen=True, eq=False)
class Structure:
    """A block: the columns it depends on, and its design columns (n, r) of unit size.

    whole: with the lower orders that a dependence on these columns has too, shape (n, w)
    """

    columns: tuple[str, ...]
    design: Floats
    whole: Floats


@dataclass(frozen=True)
class Catalogue:
    """Every structure that is looked for, as blocks; fine: position dependence finer than the table, as wide random effects."""

    structures: tuple[Structure, ...]
    blocks: Blocks
    fine: tuple[Structure, ...]
    _stacks: dict[int, Stack] = field(default_factory=dict, repr=False)

    def stack(self, whitened: Whitened) -> Stack:
        """The blocks whitened, made once per whitening."""
        key = id(whitened)
        if key not in self._stacks or self._stacks[key].whitened is not whitened:
            self._stacks.clear()
            self._stacks[key] = Stack(whitened, self.blocks)
        return self._stacks[key]


def structures(campaign: Campaign) -> Catalogue:
    """Single columns, columns with direction, pairs and pairs with direction, of everything that varies."""
    survey = campaign.survey
    names = [name for name in sorted(survey.varying) if name not in SKIPPED and _usable(campaign, name)]
    if survey.time_column == "row_order" and survey.has("row_order"):
        names.append("row_order")
    d = campaign.d
    both = survey.has("direction")
    powers = {name: _powers(campaign.columns[name]) for name in names}
    found: list[Structure] = []
    for name in names:
        p = powers[name]
        if name != "target_mm":
            found.append(Structure((name,), p, p))
        if both and name != "target_mm":
            turned = p[:, :3] * d[:, None]
            found.append(Structure((name, "direction"), turned, np.hstack([p[:, :3], turned])))
    for a, b in itertools.combinations(names, 2):
        pa, pb = powers[a], powers[b]
        product = np.column_stack([pa[:, 0] * pb[:, 0], pa[:, 1] * pb[:, 0], pa[:, 0] * pb[:, 1], pa[:, 1] * pb[:, 1]])
        mains = np.hstack([*(powers[name][:, :3] for name in (a, b) if name != "target_mm"), product])
        found.append(Structure((a, b), product, mains))
        if both:
            turned = product[:, :1] * d[:, None]
            whole = np.hstack([mains, turned, pa[:, :1] * d[:, None], pb[:, :1] * d[:, None]])
            found.append(Structure((a, b, "direction"), turned, whole))
    blocks = Blocks.of([s.design for s in found], len(campaign))
    return Catalogue(tuple(found), blocks, _fine(campaign))


def static_structures(campaign: Campaign) -> Catalogue:
    """Functions of position and direction alone, for a table that was declared."""
    return Catalogue((), Blocks.of([], len(campaign)), _fine(campaign))


def _fine(campaign: Campaign) -> tuple[Structure, ...]:
    """Position dependence finer than the table, in both directions alike and against each other."""
    if campaign.repeated or not campaign.survey.has("target_mm"):
        return ()
    knots = campaign.basis.knots_mm
    x = campaign.x
    count = int(min(FINE * len(knots), len(campaign) // 2))
    hats = np.maximum(
        0.0, 1.0 - np.abs(x[:, None] - np.linspace(knots[0], knots[-1], count)) * (count - 1) / np.ptp(knots)
    )
    both = campaign.survey.has("direction")
    out = [Structure(("target_mm",), hats, hats)]
    if both:
        turned = hats * campaign.d[:, None]
        out.append(Structure(("target_mm", "direction"), turned, turned))
    return tuple(out)


def _usable(campaign: Campaign, name: str) -> bool:
    return not (name == "stroke_mm" and np.any(campaign.columns[name] >= LONG_STROKE_MM))


def _powers(values: Floats) -> Floats:
    """Legendre polynomials 1 to 4 of a column brought to -1 … 1 by its spread, outliers clipped, shape (n, 4)."""
    low, high = np.quantile(values, [0.01, 0.99])
    v = np.clip((2 * values - low - high) / max(high - low, 1e-300), -1.2, 1.2)
    return np.asarray(np.polynomial.legendre.legvander(v, 4)[:, 1:])
