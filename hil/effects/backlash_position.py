"""Backlash that varies along the axis: d·u, d·u², u the position from -1 to 1 over the travel (worn screw, sagging
preload).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

LINEAR, QUADRATIC = "linear", "quadratic"


class BacklashPosition(Effect):
    """error_um = d·(a·u + b·u²), d the direction, u the position over half the travel, a and b in µm."""

    id: ClassVar[str] = "backlash_position"
    title: ClassVar[str] = "backlash that varies along the axis"
    action: ClassVar[Action] = Action.COMPENSATE
    static: ClassVar[bool] = True
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("lost_motion", "reversals at mid-travel: the same targets after different travel since the reversal"),
        Rival("load_deflection", "two loads, in mixed order"),
        Rival("local_wear", "a dense local pass in both directions"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("direction", "target_mm"):
            return ()
        constants = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        inputs = ("target_mm", "direction")
        return (Form(self.id, LINEAR, inputs, constants), Form(self.id, QUADRATIC, inputs, constants))

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        d = columns["direction"]
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        if form.name == LINEAR:
            return np.asarray(d * u)[:, None]
        if form.name == QUADRATIC:
            return np.column_stack([d * u, d * u**2])
        raise KeyError(form.name)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        found = {"change_um": term.coefficient(0, 4.0)}
        if term.form.name == QUADRATIC:
            found["bow_um"] = term.coefficient(1, 2.0)
        return found

    def explain(self, term: Term) -> str:
        bow = f", bowed by {term.coefficient(1, 2.0)} µm" if term.form.name == QUADRATIC else ""
        return f"The backlash changes by {term.coefficient(0, 4.0)} µm from one end of the travel to the other{bow}."
