"""Load deflection: the axis deflects under load or drive torque, as an offset, with direction, or with position.

F the load or torque; forms F, d·F, u·F, d·u·F with u the position from -1 to 1; refining forms combine two of them or
add a quadratic term.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

UNITS = {"load_kg": "kg", "torque_percent": "%"}
SIMPLE = ("offset", "with direction", "with position", "with direction and position")
ALONG, CURVED, CURVED_REVERSAL = "offset and with direction and position", "curved", "curved with direction"


class LoadDeflection(Effect):
    """error_um = c·F (also d·F, u·F, d·u·F, (F - mean)²), F in kg or % of rated torque, c in µm per kg or per %."""

    id: ClassVar[str] = "load_deflection"
    title: ClassVar[str] = "deflection under load or torque"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("backlash_position", "two loads, in mixed order"),
        Rival("velocity_lag", "two loads at one feed"),
        Rival("thermal_drift", "two loads, in mixed order, so that load and time part"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        constants = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        forms: list[Form] = []
        for source in UNITS:
            if not survey.has(source):
                continue
            inputs = (source, "target_mm", "direction")
            own = constants | {"mean": survey.mean[source]}
            forms.extend(Form(self.id, name, inputs, own) for name in SIMPLE)
            forms.extend(Form(self.id, name, inputs, own, scan=False) for name in (ALONG, CURVED, CURVED_REVERSAL))
        return tuple(forms)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        force, d = columns[form.inputs[0]], columns["direction"]
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        bend = (force - form.constants["mean"]) ** 2
        columns_of = {
            "offset": [force],
            "with direction": [d * force],
            "with position": [u * force],
            "with direction and position": [d * u * force],
            ALONG: [force, d * u * force],
            CURVED: [force, bend],
            CURVED_REVERSAL: [d * force, d * bend],
        }
        return np.column_stack(columns_of[form.name])

    def is_straight(self, form: Form) -> bool:
        return True

    def parameters(self, term: Term) -> dict[str, Estimate]:
        unit = "kg" if term.form.inputs[0] == "load_kg" else "percent"
        names = {
            "offset": ["compliance"],
            ALONG: ["compliance", "compliance_with_direction_and_position"],
            CURVED: ["compliance", "curvature"],
            CURVED_REVERSAL: ["compliance_with_direction", "curvature"],
        }.get(term.form.name, [f"compliance_{term.form.name.replace(' ', '_')}"])
        return {f"{name}_um_per_{unit}": term.coefficient(i) for i, name in enumerate(names)}

    def explain(self, term: Term) -> str:
        source = term.form.inputs[0]
        how = "" if term.form.name == "offset" else f", {term.form.name}"
        return f"The axis gives way with {source}{how}: {term.coefficient(0)} µm per {UNITS.get(source, 'unit')}."
