"""A generic search for structure that no effect of the catalogue explains: smooth functions of columns and of pairs of
columns.

The blocks represent "something depends on this", without physics. They decide "unexplained", and they compete with
catalogue effects so that another cause is not given the name of an effect that it resembles.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Whitened
from hil.diagnosis.search.candidates import Blocks, Stack
from hil.effects.base import Columns, Form
from hil.effects.history import BRANCH, LONG_STROKE_MM
from hil.effects.non_parametric import NonParametric, fine_form, powers, smooth_form, spread_of

Floats = NDArray[np.float64]

SKIPPED = frozenset({"run", "measured_mm", "command_mm", "direction", "row_order", *BRANCH})
FINE = 4
"""Hat functions per knot interval of the table in the search for structure finer than the table."""


@dataclass(frozen=True, eq=False)
class Structure:
    """A block: the columns it depends on, and its design columns (n, r) of unit size.

    form: of the whole dependence, with the lower orders; values: of all columns, each (n,)
    """

    columns: tuple[str, ...]
    design: Floats
    form: Form
    values: Columns = field(repr=False)

    @cached_property
    def whole(self) -> Floats:
        """The design columns of the whole dependence, shape (n, w)."""
        return NonParametric().basis(self.form, (), self.values)


@dataclass(frozen=True)
class Catalogue:
    """All structures that are tested, as blocks; fine: position dependence finer than the table, as wide random
    effects.
    """

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


def structures(campaign: CampaignRows) -> Catalogue:
    """Single columns, columns with direction, pairs and pairs with direction, of all columns that vary."""
    survey = campaign.survey
    names = usable_columns(campaign)
    d = campaign.d
    both = survey.has("direction")
    spreads = {name: spread_of(name, campaign.columns) for name in names}
    polynomials = {name: powers(name, spreads[name], campaign.columns) for name in names}
    found: list[Structure] = []

    def add(design: Floats, *mine: str, with_direction: bool) -> None:
        form = smooth_form(mine, [spreads[name] for name in mine], with_direction=with_direction)
        found.append(Structure(form.inputs, design, form, campaign.columns))

    for name in names:
        p = polynomials[name]
        if name != "target_mm":
            add(p, name, with_direction=False)
        if both and name != "target_mm":
            add(p[:, :3] * d[:, None], name, with_direction=True)
    for a, b in itertools.combinations(names, 2):
        pa, pb = polynomials[a], polynomials[b]
        product = np.column_stack([pa[:, 0] * pb[:, 0], pa[:, 1] * pb[:, 0], pa[:, 0] * pb[:, 1], pa[:, 1] * pb[:, 1]])
        add(product, a, b, with_direction=False)
        if both:
            add(product[:, :1] * d[:, None], a, b, with_direction=True)
    blocks = Blocks.of([s.design for s in found], len(campaign))
    return Catalogue(tuple(found), blocks, _fine(campaign))


def static_structures(campaign: CampaignRows) -> Catalogue:
    """Functions of position and direction alone, for a declared table."""
    return Catalogue((), Blocks.of([], len(campaign)), _fine(campaign))


def _fine(campaign: CampaignRows) -> tuple[Structure, ...]:
    """Position dependence finer than the table, alike and opposite in the two directions."""
    if campaign.repeated or not campaign.survey.has("target_mm"):
        return ()
    knots = campaign.basis.knots_mm
    count = int(min(FINE * len(knots), len(campaign) // 2))
    out = []
    for with_direction in (False, True) if campaign.survey.has("direction") else (False,):
        form = fine_form(float(knots[0]), float(knots[-1]), count, campaign.columns, with_direction=with_direction)
        hats = NonParametric().basis(form, (), campaign.columns)
        out.append(Structure(form.inputs, hats, form, campaign.columns))
    return tuple(out)


def usable_columns(campaign: CampaignRows) -> list[str]:
    """Names of the columns that vary and may carry an error, sorted; the row order only in place of the time."""
    survey = campaign.survey
    names = [name for name in sorted(survey.varying) if name not in SKIPPED and _usable(campaign, name)]
    return [*names, "row_order"] if survey.time_column == "row_order" and survey.has("row_order") else names


def _usable(campaign: CampaignRows, name: str) -> bool:
    return not (name == "stroke_mm" and np.any(campaign.columns[name] >= LONG_STROKE_MM))
