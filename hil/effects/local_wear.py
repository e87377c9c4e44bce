"""Local wear: a zone of the travel with a bump in the error, of the same or of opposite sign in the two directions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.survey import Survey

USUAL_SHARE, USUAL_SPREAD = 1 / 12, 0.7
"""A zone is short against the travel: prior median of its width over half the travel, and standard deviation of the
logarithm.
"""
WIDEST = 1 / 8
"""Largest width over half the travel: a zone, four widths, takes a quarter of the travel; what is wider is a shape of the axis."""
AT_BOUND = 0.95
"""Share of the widest from which the fit wants more than a zone."""
ANYWHERE = -math.log(2 / USUAL_SHARE)
"""Prior log odds: the place of a zone is free over as many places as widths fit into the travel, which the best of them does not
pay.
"""
NARROW = 0.1
"""Width over half the travel up to which a smooth table cannot represent the bump."""
BUMP, REVERSAL, BOTH = "bump", "bump with direction", "bump in each direction"


class LocalWear(Effect):
    """error_um = h·exp(-((x - c)/w)²/2), height h in µm, centre c and width w in mm; alike or opposite in the two
    directions.
    """

    id: ClassVar[str] = "local_wear"
    title: ClassVar[str] = "a worn zone"
    action: ClassVar[Action] = Action.COMPENSATE
    static: ClassVar[bool] = True
    several: ClassVar[bool] = True
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("pitch_shape", "a dense local pass over the zone"),
        Rival("cyclic", "a dense pass over the zone and two periods beside it"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("target_mm"):
            return ()
        low = survey.centre_mm - survey.half_span_mm
        high = survey.centre_mm + survey.half_span_mm
        narrow = min(survey.spacing_mm / 2, survey.half_span_mm * WIDEST / 2)
        centre = NonLinear("centre_mm", low, high, logarithmic=False)
        usual = (survey.half_span_mm * USUAL_SHARE, USUAL_SPREAD)
        width = NonLinear("width_mm", narrow / 2, survey.half_span_mm * WIDEST, usual=usual)
        starts = tuple(
            (float(c), float(w))
            for w in np.geomspace(narrow, survey.half_span_mm * WIDEST, 5)
            for c in np.minimum(np.arange(low, high + w / 2, w), high)
        )
        both = survey.has("direction")
        inputs = ("target_mm", "direction")
        forms = [Form(self.id, BUMP, inputs, {}, (centre, width), starts, log_odds=ANYWHERE)]
        if both:
            forms.append(Form(self.id, REVERSAL, inputs, {}, (centre, width), starts, log_odds=ANYWHERE))
            forms.append(Form(self.id, BOTH, inputs, {}, (centre, width), starts, scan=False, log_odds=ANYWHERE))
        return tuple(forms)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        centre, width = theta
        bump = np.exp(-0.5 * ((columns["target_mm"] - centre) / width) ** 2)
        d = columns["direction"]
        columns_of = {BUMP: [bump], REVERSAL: [d * bump], BOTH: [bump, d * bump]}
        return np.column_stack(columns_of[form.name])

    def is_local(self, form: Form, theta: Sequence[float], survey: Survey) -> bool:
        return theta[1] <= NARROW * survey.half_span_mm

    def is_exceeded(self, form: Form, theta: Sequence[float]) -> bool:
        return theta[1] > AT_BOUND * form.nonlinear[1].upper

    def parameters(self, term: Term) -> dict[str, Estimate]:
        found = {"height_um": term.coefficient(0), "centre_mm": term.nonlinear(0), **term.positive(1, "width_mm")}
        if term.form.name == BOTH:
            found["height_with_direction_um"] = term.coefficient(1)
        return found

    def explain(self, term: Term) -> str:
        sign = " of opposite sign in the two directions" if term.form.name == REVERSAL else ""
        return (
            f"Around {term.nonlinear(0)} mm, with a half width of {term.positive_text(1, 'mm')}, the error bulges by"
            f" {term.coefficient(0)} µm{sign}: a worn or damaged zone."
        )
