"""Thermal drift: an offset of the whole axis that follows a temperature, or settles with time since the start.

Mounts, spindle head, column or nut warm up and move the origin, by the same amount at both ends of the travel. Where
heat enters at one place (a nut that stays near the middle, a motor at one end) the axis also bends: the drift then
differs along the travel, as a cubic of position.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey
from hil.effects.warming import (
    SINCE_START,
    WARMING,
    lag_of,
    rise,
    seen_in_rows,
    since_start,
    temperature_forms,
    time_constants,
    time_of_rows,
    time_unit,
)

UNEVEN = "warming since the start, unlike along the travel"
MOST_UM_PER_K = 60.0
"""Five metres of steel, or two and a half of aluminium, grow by so much: no machine's origin moves farther with one kelvin."""
POWERS = 4
"""Coefficients of the drift along the travel: Legendre orders 0 to 3."""


class ThermalDrift(Effect):
    """error_um = c·(T - 20 °C), c in µm/K, also through a first-order lag; or c·(1 - e^(-t/τ)), c in µm, τ in s or
    rows.
    """

    id: ClassVar[str] = "thermal_drift"
    title: ClassVar[str] = "thermal drift of the origin"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival(
            "beam_drift",
            "log the temperature and let the axis cool down: a thermal drift comes back, a beam's does not",
        ),
        Rival("dead_path", "change the dead path of the instrument, or log the air"),
        Rival("datum_step", "return to one reference point several times within a run"),
        Rival("thermal_expansion", "compare both ends of the travel in one warm run: expansion differs there"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        forms = temperature_forms(self.id, survey)
        if not any(form.name == WARMING for form in forms) or not survey.has("target_mm"):
            return forms
        parameter, grid = time_constants(survey)
        travel = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm, **time_of_rows(survey)}
        return (*forms, Form(self.id, UNEVEN, (survey.time_column, "target_mm"), travel, (parameter,), grid[::2]))

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name != UNEVEN:
            return rise(form, theta, columns)
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        shape = np.polynomial.legendre.legvander(np.clip(u, -1.0, 1.0), POWERS - 1)
        return np.asarray(shape * (1.0 - np.exp(-since_start(form, columns[form.inputs[0]]) / theta[0]))[:, None])

    def lag(self, form: Form, theta: Sequence[float]) -> tuple[str, float] | None:
        return lag_of(form, theta)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        if term.form.name in (UNEVEN, *SINCE_START) and not (seen := seen_in_rows(term)).determined:
            return {"drift_over_the_rows_um": seen.change, **seen.bounds(time_unit(term))}
        if term.form.name == UNEVEN:
            found = {"drift_um": term.coefficient(0), f"time_constant_{time_unit(term)}": term.nonlinear(0)}
            return found | {f"along_the_travel_{i}_um": term.coefficient(i) for i in range(1, POWERS)}
        if term.form.name in SINCE_START:
            return {"drift_um": term.coefficient(0), f"time_constant_{time_unit(term)}": term.nonlinear(0)}
        found = {"coefficient_um_per_k": term.coefficient(0)}
        if term.theta:
            found |= term.positive(0, f"lag_{time_unit(term)}")
        return found

    def implausible(self, term: Term) -> str | None:
        if term.form.name in (UNEVEN, *SINCE_START) or abs(term.coefficients[0]) <= MOST_UM_PER_K:
            return None
        return f"{term.coefficients[0]:.3g} µm/K is more than {MOST_UM_PER_K:g}: no part of a machine moves its origin so far"

    def explain(self, term: Term) -> str:
        if term.form.name in (UNEVEN, *SINCE_START) and not (seen := seen_in_rows(term)).determined:
            where = "on average over the travel" if term.form.name == UNEVEN else "as a whole"
            return (
                f"The axis drifts by {seen.change} µm from the first row to the last, {where}; {seen.open_end(time_unit(term))}:"
                " something warms up from the start."
            )
        if term.form.name == UNEVEN:
            return (
                f"The axis drifts by {term.coefficient(0)} µm on average over the travel, unlike along it, and settles with a"
                f" time constant of {term.nonlinear(0)} {time_unit(term)}: heat enters at one place and bends it."
            )
        if term.form.name in SINCE_START:
            return (
                f"The whole axis drifts by {term.coefficient(0)} µm and settles with a time constant of"
                f" {term.nonlinear(0)} {time_unit(term)}: something warms up from the start."
            )
        lag = f" seen through a lag of {term.positive_text(0, time_unit(term))}" if term.theta else ""
        return f"The whole axis drifts with {term.form.inputs[0]}{lag} by {term.coefficient(0)} µm/K."
