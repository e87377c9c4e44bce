"""Backlash: a constant difference between the two directions that the table in force lacks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

CONSTANT = "constant"


class Backlash(Effect):
    """error_um = ±b/2 by direction, b the difference forward - backward in µm, the same at every position."""

    id: ClassVar[str] = "backlash"
    title: ClassVar[str] = "backlash, the same everywhere"
    action: ClassVar[Action] = Action.COMPENSATE
    static: ClassVar[bool] = True
    mean_of: ClassVar[str] = "backlash_position"
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("backlash_position", "reversals at mid-travel and at both ends"),
        Rival("lost_motion", "the same targets after different travel since the reversal"),
        Rival("velocity_lag", "the same targets at three feeds"),
        Rival("load_deflection", "two loads, in mixed order"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        return (Form(self.id, CONSTANT, ("direction",)),) if survey.has("direction") else ()

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name != CONSTANT:
            raise KeyError(form.name)
        return np.array(columns["direction"])[:, None]

    def parameters(self, term: Term) -> dict[str, Estimate]:
        return {"backlash_um": term.coefficient(0, 2.0)}

    def explain(self, term: Term) -> str:
        return (
            f"The two directions differ by {term.coefficient(0, 2.0)} µm everywhere on the travel (forward - backward)."
        )
