"""Backlash: a difference between the two directions, the same everywhere, that the table in force lacks or that a temperature changes.

A nut and a screw that warm up unlike each other change the preload between them, and with it the play (Altintas et al., Machine tool
feed drives, CIRP Annals 60, 2011, section 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

CONSTANT, WITH_TEMPERATURE = "constant", "changing with temperature"


class Backlash(Effect):
    """error_um = ±b/2 by direction, b the difference forward - backward in µm, the same at every position; or
    ±c·(T - mean)/2, c in µm/K.
    """

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
        if not survey.has("direction"):
            return ()
        warm = (
            Form(self.id, WITH_TEMPERATURE, (name, "direction"), {"mean_c": survey.mean[name]})
            for name in survey.warmth
        )
        return (Form(self.id, CONSTANT, ("direction",)), *warm)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name == WITH_TEMPERATURE:
            return np.asarray(columns["direction"] * (columns[form.inputs[0]] - form.constants["mean_c"]))[:, None]
        if form.name != CONSTANT:
            raise KeyError(form.name)
        return np.array(columns["direction"])[:, None]

    def parameters(self, term: Term) -> dict[str, Estimate]:
        name = "backlash_um_per_k" if term.form.name == WITH_TEMPERATURE else "backlash_um"
        return {name: term.coefficient(0, 2.0)}

    def explain(self, term: Term) -> str:
        if term.form.name == WITH_TEMPERATURE:
            return (
                f"The backlash changes with {term.form.inputs[0]} by {term.coefficient(0, 2.0)} µm/K everywhere on the travel: the"
                " preload of the nut changes as it warms up."
            )
        return (
            f"The two directions differ by {term.coefficient(0, 2.0)} µm everywhere on the travel (forward - backward)."
        )
