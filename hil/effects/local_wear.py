"""Local wear: a zone of the travel with a bump in the error, of the same or of opposite sign in the two directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.survey import Survey

USUAL_SHARE, USUAL_SPREAD = 1 / 12, 0.7
"""A zone is short against the travel: prior median of its width over half the travel, and standard deviation of the
logarithm.
"""
WIDEST = 1 / 6
"""Largest width over half the travel: a zone, four widths, takes a third of the travel; what is wider is a shape of the axis."""
AT_BOUND = 0.95
"""Share of the widest from which the fit wants more than a zone."""
NARROW = 0.1
"""Width over half the travel up to which a smooth table cannot represent the bump."""
BUMP, REVERSAL, BOTH = "bump", "bump with direction", "bump in each direction"
FLAT, FADING, RISING = "flat ", "fading ", "rising "
"""Begin of the name of a zone that is worn evenly, and of one that is worn most at its lower or its upper end: a short stroke that was
run again and again ends at one place.
"""
SHAPES = ("", FLAT, FADING, RISING)
STEEP = 1 / 6
"""Width of the steep side of a zone that fades, over that of the other: targets are seldom near enough to tell it."""
WIDER = {"": 1.0, FLAT: 1.5, FADING: 2.0, RISING: 2.0}
"""Largest width of each shape over that of a bump: the zones, outside which less than a seventh of the height is left, are then about
as long, a third of the travel.
"""


class LocalWear(Effect):
    """error_um = h·exp(-((x - c)/w)²/2), height h in µm, centre c and width w in mm; alike or opposite in the two
    directions. As a refinement h·exp(-((x - c)/w)⁴/2), or h·exp(-|x - c|/w) to one side of c.
    """

    id: ClassVar[str] = "local_wear"
    title: ClassVar[str] = "a worn zone"
    action: ClassVar[Action] = Action.COMPENSATE
    static: ClassVar[bool] = True
    several: ClassVar[bool] = True
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("pitch_shape", "a dense local pass over the zone"),
        Rival("cyclic", "a dense pass over the zone and two periods beside it"),
        Rival("lost_motion", "approach the same targets after travels of other lengths"),
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
        inputs = ("target_mm", "direction")
        forms = []
        for shape in SHAPES:
            parameters = centre, replace(width, upper=WIDER[shape] * width.upper)
            for name in (BUMP, REVERSAL, BOTH) if survey.has("direction") else (BUMP,):
                scan = not shape and name != BOTH
                forms.append(Form(self.id, shape + name, inputs, {}, parameters, starts, scan=scan))
        return tuple(forms)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        centre, width = theta
        shape, name = split_name(form.name)
        a = (columns["target_mm"] - centre) / width
        if shape == FLAT:
            zone = np.exp(-0.5 * a**4)
        elif shape:
            ahead = a if shape == FADING else -a
            zone = np.where(ahead < 0.0, np.exp(-0.5 * (ahead / STEEP) ** 2), np.exp(-np.abs(ahead)))
        else:
            zone = np.exp(-0.5 * a**2)
        d = columns["direction"]
        columns_of = {BUMP: [zone], REVERSAL: [d * zone], BOTH: [zone, d * zone]}
        return np.column_stack(columns_of[name])

    def is_exceeded(self, form: Form, theta: Sequence[float]) -> bool:
        return theta[1] > AT_BOUND * form.nonlinear[1].upper

    def parameters(self, term: Term) -> dict[str, Estimate]:
        found = {"height_um": term.coefficient(0), "centre_mm": term.nonlinear(0), **term.positive(1, "width_mm")}
        if split_name(term.form.name)[1] == BOTH:
            found["height_with_direction_um"] = term.coefficient(1)
        return found

    def explain(self, term: Term) -> str:
        shape, name = split_name(term.form.name)
        sign = " of opposite sign in the two directions" if name == REVERSAL else ""
        if name == BOTH:
            sign = f", and with the direction by {term.coefficient(1)} µm"
        place, width = f"{term.nonlinear(0)} mm", term.positive_text(1, "mm")
        where = {
            FADING: f"From {place} upwards, fading over {width}",
            RISING: f"Up to {place}, rising over {width}",
        }.get(shape, f"Around {place}, with a half width of {width}")
        return f"{where}, the error bulges by {term.coefficient(0)} µm{sign}: a worn or damaged zone."


def split_name(name: str) -> tuple[str, str]:
    """Shape ("" for a bump, FLAT …) and direction (BUMP …) of a form's name. Raises KeyError for another form's in `basis`."""
    shape = next((one for one in (FLAT, FADING, RISING) if name.startswith(one)), "")
    return shape, name.removeprefix(shape)
