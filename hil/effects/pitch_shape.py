"""Pitch shape: a smooth shape along the travel that the table in force missed (too few nodes, or the screw has changed).

Legendre polynomials of the position from -1 to 1; the first is a pure lead (scale) error.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.polynomial import legendre

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

FINE = "fine shape"
ORDERS = {"lead error": 1, "bow": 3, "shape": 6, FINE: 12}
"""Form -> highest Legendre order."""


class PitchShape(Effect):
    """error_um = Σ c_i·P_i(u), i from 1 to the form's order, P_i Legendre polynomials, u the position over half the
    travel, c_i in µm.
    """

    id: ClassVar[str] = "pitch_shape"
    title: ClassVar[str] = "smooth shape the table missed"
    action: ClassVar[Action] = Action.COMPENSATE
    static: ClassVar[bool] = True
    is_table: ClassVar[bool] = True
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("cosine", "realign the beam and repeat, or measure a reference artefact: data alone cannot tell"),
        Rival("cyclic", "a dense sweep over two periods"),
        Rival("local_wear", "a dense local pass"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("target_mm"):
            return ()
        constants = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        return tuple(Form(self.id, name, ("target_mm",), constants) for name in ORDERS)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        values = legendre.legvander(np.clip(u, -1.1, 1.1), ORDERS[form.name])[:, 1:]
        return np.asarray(values, dtype=np.float64)

    def stands_for(self, form: Form) -> tuple[str, ...]:
        """What stands in a tenth of the travel takes the twelfth order (tuning seeds 106000 to 107999, older tables: 31 smooth shapes
        took the sixth or less, both of the twelfth were wear).
        """
        return ("local_wear", "cyclic") if form.name == FINE else ()

    def parameters(self, term: Term) -> dict[str, Estimate]:
        scale = 1e3 / term.form.constants["half_span_mm"]
        found = {"lead_error_ppm": term.coefficient(0, scale)}
        found |= {f"order_{i + 1}_um": term.coefficient(i) for i in range(1, len(term.coefficients))}
        return found

    def explain(self, term: Term) -> str:
        size = float(np.sqrt(np.sum(np.square(term.coefficients))))
        return (
            f"A smooth shape along the travel, about {size:.3g} µm in size with a lead error of"
            f" {term.parameters['lead_error_ppm']} ppm, is not in the table in force."
        )
