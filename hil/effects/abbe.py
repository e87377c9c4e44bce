"""Abbe error: the carriage tilts, and the tilt times the arm between scale and measuring line is an error, h·θ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.polynomial import legendre

from hil.effects.base import UM_PER_MM_PPM, Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.survey import Survey

ANGLES = ("pitch_urad", "yaw_urad")
TILT, CHANGING = "tilt", "arm changing along the travel"
SECOND_OFFSET = {"straight tilt, two offsets": 1, "tilt, two offsets": 3, "wavy tilt, two offsets": 5}
"""Forms without a measured angle, for a measuring line displaced by `abbe_offset_mm` from its first place (0): form ->
Legendre order of the tilt along the travel.
"""
ARMS_MM = (-400.0, -150.0, -60.0, 60.0, 150.0, 400.0)
"""Starting values of the arm."""


class Abbe(Effect):
    """error_um = h·θ·10⁻³, arm h in mm, tilt θ in µrad (Abbe's principle).

    Forms: θ from a level's column (`pitch_urad`, `yaw_urad`), with an arm that may change along the travel; or θ(u) as
    Legendre polynomials, when the measuring line was at two offsets.
    """

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
        arm = NonLinear("arm_mm", -600.0, 600.0, logarithmic=False)
        moved = ("abbe_offset_mm", "target_mm")
        return (
            *(Form(self.id, TILT, (name,)) for name in angles),
            *(Form(self.id, CHANGING, (name, "target_mm"), constants, scan=False) for name in angles),
            *(
                Form(self.id, name, moved, constants, (arm,), tuple((value,) for value in ARMS_MM))
                for name in (SECOND_OFFSET if survey.has(*moved) else ())
            ),
        )

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name in SECOND_OFFSET:
            u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
            course = legendre.legvander(np.clip(u, -1.1, 1.1), SECOND_OFFSET[form.name])
            return np.asarray((theta[0] + columns["abbe_offset_mm"])[:, None] * course * UM_PER_MM_PPM)
        tilt = columns[form.inputs[0]] * UM_PER_MM_PPM
        if form.name == TILT:
            return np.asarray(tilt)[:, None]
        if form.name == CHANGING:
            u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
            return np.column_stack([tilt, u * tilt])
        raise KeyError(form.name)

    def is_straight(self, form: Form) -> bool:
        return form.name not in SECOND_OFFSET

    def parameters(self, term: Term) -> dict[str, Estimate]:
        if term.form.name in SECOND_OFFSET:
            return {"arm_mm": term.nonlinear(0), "tilt_to_the_end_urad": term.coefficient(1)}
        found = {"arm_mm": term.coefficient(0)}
        if term.form.name == CHANGING:
            found["arm_change_mm"] = term.coefficient(1)
        return found

    def explain(self, term: Term) -> str:
        if term.form.name in SECOND_OFFSET:
            return (
                f"The error changes with the offset of the measuring line, as a tilt on an arm of {term.nonlinear(0)} mm"
                " does: Abbe offset."
            )
        return f"The error follows {term.form.inputs[0]} on an arm of {term.coefficient(0)} mm: Abbe offset of the measuring line."

    def implausible(self, term: Term) -> str | None:
        size = abs(term.theta[0] if term.form.name in SECOND_OFFSET else term.coefficients[0])
        return f"an arm of {size:.0f} mm is longer than a machine" if size > 5000 else None
