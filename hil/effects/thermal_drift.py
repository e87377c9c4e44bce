"""Thermal drift: an offset of the whole axis that follows a temperature, or settles with time since the start.

Mounts, spindle head, column or nut warm up and carry the origin with them, the same at both ends of the travel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey
from hil.effects.warming import SINCE_START, rise, temperature_forms, time_unit


class ThermalDrift(Effect):
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
        return temperature_forms(self.id, survey)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        return rise(form, theta, columns)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        if term.form.name in SINCE_START:
            return {"drift_um": term.coefficient(0), f"time_constant_{time_unit(term)}": term.nonlinear(0)}
        found = {"coefficient_um_per_k": term.coefficient(0)}
        if term.theta:
            found[f"lag_{time_unit(term)}"] = term.nonlinear(0)
        return found

    def explain(self, term: Term) -> str:
        if term.form.name in SINCE_START:
            return (
                f"The whole axis drifts by {term.coefficient(0)} µm and settles with a time constant of"
                f" {term.nonlinear(0)} {time_unit(term)}: something warms up from the start."
            )
        lag = f" seen through a lag of {term.nonlinear(0)} {time_unit(term)}" if term.theta else ""
        return f"The whole axis drifts with {term.form.inputs[0]}{lag} by {term.coefficient(0)} µm/K."
