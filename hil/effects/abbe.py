"""Abbe error: the carriage tilts, and the tilt times the arm between scale and measuring line is an error, h·θ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

ANGLES = ("pitch_urad", "yaw_urad")
TILT, CHANGING = "tilt", "arm changing along the travel"
UM_PER_URAD_MM = 1e-3


class Abbe(Effect):
    id: ClassVar[str] = "abbe"
    title: ClassVar[str] = "Abbe error: tilt times arm"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("pitch_shape", "repeat at a second offset of the measuring line"),
        Rival("load_deflection", "repeat at a second offset of the measuring line, at one load"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        constants = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        angles = [name for name in ANGLES if survey.has(name)]
        return (
            *(Form(self.id, TILT, (name,)) for name in angles),
            *(Form(self.id, CHANGING, (name, "target_mm"), constants, scan=False) for name in angles),
        )

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        tilt = columns[form.inputs[0]] * UM_PER_URAD_MM
        if form.name == TILT:
            return np.asarray(tilt)[:, None]
        if form.name == CHANGING:
            u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
            return np.column_stack([tilt, u * tilt])
        raise KeyError(form.name)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        found = {"arm_mm": term.coefficient(0)}
        if term.form.name == CHANGING:
            found["arm_change_mm"] = term.coefficient(1)
        return found

    def explain(self, term: Term) -> str:
        return f"The error follows {term.form.inputs[0]} on an arm of {term.coefficient(0)} mm: Abbe offset of the measuring line."

    def implausible(self, term: Term) -> str | None:
        size = abs(term.coefficients[0])
        return f"an arm of {size:.0f} mm is longer than a machine" if size > 5000 else None
