"""Cross-axis error: the position of another axis shifts this one, y·g(x) (squareness, sag under a moving mass)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import UM_PER_MM_PPM, Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

OFFSET, ALONG, BOTH, CURVED = "shift", "growing along the travel", "shift and growth", "curved"
CURVED_ALONG = "curved and growing along the travel"


class CrossAxis(Effect):
    """error_um = (a + b·u)·y·10⁻³ + (c + e·u)·(y - ȳ)²·10⁻⁶, y the other axis in mm; a, b in µm/m, c, e in µm/m², u the
    position over half the travel.
    """

    id: ClassVar[str] = "cross_axis"
    title: ClassVar[str] = "position of another axis"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("abbe", "repeat at two positions of the other axis with a level on the carriage"),
        Rival("thermal_drift", "alternate between two positions of the other axis within one run"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        forms: list[Form] = []
        for axis in survey.other_axes:
            constants = {
                "centre_mm": survey.centre_mm,
                "half_span_mm": survey.half_span_mm,
                "mean_mm": survey.mean[axis],
            }
            inputs = (axis, "target_mm")
            forms.extend(Form(self.id, name, inputs, constants) for name in (OFFSET, ALONG, CURVED))
            forms.extend(Form(self.id, name, inputs, constants, scan=False) for name in (BOTH, CURVED_ALONG))
        return tuple(forms)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        y = columns[form.inputs[0]] * UM_PER_MM_PPM
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        bend = (columns[form.inputs[0]] - form.constants["mean_mm"]) ** 2 * UM_PER_MM_PPM**2
        columns_of = {
            OFFSET: [y],
            ALONG: [u * y],
            BOTH: [y, u * y],
            CURVED: [y, bend],
            CURVED_ALONG: [y, bend, u * y, u * bend],
        }
        return np.column_stack(columns_of[form.name])

    def is_straight(self, form: Form) -> bool:
        return True

    def parameters(self, term: Term) -> dict[str, Estimate]:
        names = {
            OFFSET: ["slope_um_per_m"],
            ALONG: ["growth_um_per_m"],
            BOTH: ["slope_um_per_m", "growth_um_per_m"],
            CURVED: ["slope_um_per_m", "curvature_um_per_m2"],
            CURVED_ALONG: ["slope_um_per_m", "curvature_um_per_m2", "growth_um_per_m", "growth_of_curvature_um_per_m2"],
        }[term.form.name]
        return {name: term.coefficient(i) for i, name in enumerate(names)}

    def explain(self, term: Term) -> str:
        bend = (
            f" and {term.coefficient(1)} µm per square metre about its middle"
            if term.form.name in (CURVED, CURVED_ALONG)
            else ""
        )
        return f"The error follows {term.form.inputs[0]} ({term.form.name}): {term.coefficient(0)} µm per metre of that axis{bend}."
