"""Thermal expansion of screw or scale: an error proportional to position and temperature rise, x·α·ΔT, or x·(1 -
e^(-t/τ)) while it warms.

The coefficient is in ppm/K. The growth is about the zero of the axis; growth about another point shows as
`thermal_drift` beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import UM_PER_MM_PPM, Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey
from hil.effects.warming import REFERENCE_C, SINCE_START, rise, temperature_forms, time_unit

STEEL_TO_ALUMINIUM_PPM_K = (2.0, 35.0)
"""Low-expansion alloys to above aluminium (about 23); a steel screw is 11 to 12."""


class ThermalExpansion(Effect):
    """error_um = α·x·(T - 20 °C)·10⁻³, α in ppm/K, x in mm, reference temperature of ISO 1; or by time since the start,
    in ppm.
    """

    id: ClassVar[str] = "thermal_expansion"
    title: ClassVar[str] = "thermal expansion of screw or scale"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("air_index", "vary the air and the screw temperature apart: warm the screw by fast strokes in still air"),
        Rival("cosine", "measure once cold and once warm: a misaligned beam does not follow temperature"),
        Rival("thermal_drift", "compare both ends of the travel in one warm run: a drift is the same at both"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        return temperature_forms(self.id, survey, extra_inputs=("target_mm",))

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        x = columns["target_mm"] * UM_PER_MM_PPM
        return np.asarray(x[:, None] * rise(form, theta, columns))

    def parameters(self, term: Term) -> dict[str, Estimate]:
        if term.form.name in SINCE_START:
            return {"expansion_ppm": term.coefficient(0), f"time_constant_{time_unit(term)}": term.nonlinear(0)}
        found = {"coefficient_ppm_per_k": term.coefficient(0)}
        if term.theta:
            found[f"lag_{time_unit(term)}"] = term.nonlinear(0)
        return found

    def explain(self, term: Term) -> str:
        first = term.coefficient(0)
        if term.form.name in SINCE_START:
            tau = term.nonlinear(0)
            return (
                f"The axis grows with time since the start, by {first} ppm of the position in the end,"
                f" with a time constant of {tau} {time_unit(term)}: it warms up."
            )
        lag = f" seen through a lag of {term.nonlinear(0)} {time_unit(term)}" if term.theta else ""
        return (
            f"The error grows with position and {term.form.inputs[0]}{lag}: {first} ppm/K (steel 11 to 12),"
            f" reference {REFERENCE_C:g} °C."
        )

    def implausible(self, term: Term) -> str | None:
        if term.form.name in SINCE_START:
            return None
        low, high = STEEL_TO_ALUMINIUM_PPM_K
        size = abs(term.coefficients[0])
        if low <= size <= high:
            return None
        return f"{size:.3g} ppm/K lies outside the {low:g} to {high:g} ppm/K of machine materials"
