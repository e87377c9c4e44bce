"""Backlash that varies along the axis: d·u, d·u², or d times a smooth shape, u the position from -1 to 1 over the travel
(worn screw, sagging preload).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.polynomial import legendre

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

LINEAR, QUADRATIC = "linear", "quadratic"
ORDERS = {"shape": 6, "fine shape": 12}
"""Form -> highest Legendre order."""


class BacklashPosition(Effect):
    """error_um = d·(a·u + b·u²), d the direction, u the position over half the travel, a and b in µm; or d·Σ c_i·P_i(u), P_i
    Legendre polynomials.
    """

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
        return tuple(Form(self.id, name, inputs, constants) for name in (LINEAR, QUADRATIC, *ORDERS))

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        d = columns["direction"]
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        if form.name == LINEAR:
            return np.asarray(d * u)[:, None]
        if form.name == QUADRATIC:
            return np.column_stack([d * u, d * u**2])
        return np.asarray(d[:, None] * legendre.legvander(np.clip(u, -1.1, 1.1), ORDERS[form.name])[:, 1:])

    def is_straight(self, form: Form) -> bool:
        return form.name == LINEAR

    def parameters(self, term: Term) -> dict[str, Estimate]:
        if term.form.name in ORDERS:
            odd = np.array([4.0 * (i % 2 == 0) for i in range(len(term.coefficients))])  # P_i(1) - P_i(-1), both sides
            covariance = np.array(term.covariance)
            variance = float(odd @ covariance @ odd)
            return {"change_um": Estimate(float(odd @ np.array(term.coefficients)), max(variance, 0.0) ** 0.5)}
        found = {"change_um": term.coefficient(0, 4.0)}
        if term.form.name == QUADRATIC:
            found["bow_um"] = term.coefficient(1, 2.0)
        return found

    def explain(self, term: Term) -> str:
        if term.form.name in ORDERS:
            change = self.parameters(term)["change_um"]
            return f"The backlash changes by {change} µm from one end of the travel to the other, in a shape of its own along it."
        bow = f", bowed by {term.coefficient(1, 2.0)} µm" if term.form.name == QUADRATIC else ""
        return f"The backlash changes by {term.coefficient(0, 4.0)} µm from one end of the travel to the other{bow}."
