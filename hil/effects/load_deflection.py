"""Load deflection: the axis deflects under load or drive torque, as an offset, with direction, with position, or the more the
farther it is from the point where it is held.

F the load or torque; forms F, d·F, u·F, d·u·F with u the position from -1 to 1, and F with u·F: a screw gives way in proportion to
its free length from the bearing that holds it; or F over a zone: a guide whose foundation is soft in one place gives way there, over
its characteristic length (Hetényi, Beams on Elastic Foundation, 1946). Refining forms combine two others or add a quadratic term.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import (
    FARTHEST_POINT,
    POINT_KNOWN_TO,
    Action,
    Columns,
    Effect,
    Estimate,
    Floats,
    Form,
    NonLinear,
    Rival,
    Term,
)
from hil.effects.local_wear import USUAL_SHARE, USUAL_SPREAD, WIDEST
from hil.effects.survey import Survey

UNITS = {"load_kg": "kg", "torque_percent": "%"}
FROM_A_POINT = "from a stiff point"
SIMPLE = ("offset", "with direction", "with position", "with direction and position", FROM_A_POINT)
ALONG, CURVED, CURVED_REVERSAL = "offset and with direction and position", "curved", "curved with direction"
IN_A_ZONE = "in a zone"
WIDTHS = 4
"""Widths of a zone that are tried, from half the distance of the targets to a sixth of half the travel, as of a worn one."""
BOTH_WAYS_ALIKE = frozenset({"offset", "with position", FROM_A_POINT, CURVED})


class LoadDeflection(Effect):
    """error_um = c·F (also d·F, u·F, d·u·F, (F - mean)²), F in kg or % of rated torque, c in µm per kg or per %; or c·(x - x₀)·F,
    as F and u·F, so that both are linear; or c·F·exp(-((x - x₀)/w)²/2), w in mm.
    """

    id: ClassVar[str] = "load_deflection"
    title: ClassVar[str] = "deflection under load or torque"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("backlash_position", "two loads, in mixed order"),
        Rival("velocity_lag", "two loads at one feed"),
        Rival("thermal_drift", "two loads, in mixed order, so that load and time part"),
        Rival(
            "abbe",
            "log pitch and yaw of the carriage, at two loads",
        ),
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
            if survey.has("target_mm"):
                forms.append(_zone(self.id, inputs, survey))
            forms.extend(Form(self.id, name, inputs, own, scan=False) for name in (ALONG, CURVED, CURVED_REVERSAL))
        return tuple(forms)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        force = columns[form.inputs[0]]
        if form.name == IN_A_ZONE:
            return np.asarray(force * np.exp(-0.5 * ((columns["target_mm"] - theta[0]) / theta[1]) ** 2))[:, None]
        d = columns["direction"]
        u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
        bend = (force - form.constants["mean"]) ** 2
        columns_of = {
            "offset": [force],
            "with direction": [d * force],
            "with position": [u * force],
            "with direction and position": [d * u * force],
            FROM_A_POINT: [force, u * force],
            ALONG: [force, d * u * force],
            CURVED: [force, bend],
            CURVED_REVERSAL: [d * force, d * bend],
        }
        return np.column_stack(columns_of[form.name])

    def is_straight(self, form: Form) -> bool:
        return form.name != IN_A_ZONE

    def parameters(self, term: Term) -> dict[str, Estimate]:
        unit = "kg" if term.form.inputs[0] == "load_kg" else "percent"
        if term.form.name == IN_A_ZONE:
            found = {f"compliance_um_per_{unit}": term.coefficient(0), "centre_mm": term.nonlinear(0)}
            return found | term.positive(1, "width_mm")
        names = {
            "offset": ["compliance"],
            ALONG: ["compliance", "compliance_with_direction_and_position"],
            CURVED: ["compliance", "curvature"],
            CURVED_REVERSAL: ["compliance_with_direction", "curvature"],
            FROM_A_POINT: ["compliance_at_mid_travel", "compliance_with_position"],
        }.get(term.form.name, [f"compliance_{term.form.name.replace(' ', '_')}"])
        found = {f"{name}_um_per_{unit}": term.coefficient(i) for i, name in enumerate(names)}
        point = stiff_point_mm(term) if term.form.name == FROM_A_POINT else None
        return found if point is None else found | {"stiff_point_mm": point}

    def explain(self, term: Term) -> str:
        source = term.form.inputs[0]
        unit = UNITS.get(source, "unit")
        if term.form.name == IN_A_ZONE:
            return (
                f"Around {term.nonlinear(0)} mm, with a half width of {term.positive_text(1, 'mm')}, the axis gives way with {source}:"
                f" {term.coefficient(0)} µm per {unit}: what carries it is soft there."
            )
        if term.form.name == FROM_A_POINT:
            point = stiff_point_mm(term)
            where = "" if point is None else f": it is held at {point} mm"
            return (
                f"The axis gives way with {source}, by {term.coefficient(0)} µm per {unit} in mid-travel and"
                f" {term.coefficient(1)} µm per {unit} more at its upper end{where}."
            )
        how = "" if term.form.name == "offset" else f", {term.form.name}"
        return f"The axis gives way with {source}{how}: {term.coefficient(0)} µm per {unit}."


def _zone(effect: str, inputs: tuple[str, ...], survey: Survey) -> Form:
    low, high = survey.centre_mm - survey.half_span_mm, survey.centre_mm + survey.half_span_mm
    widest = survey.half_span_mm * WIDEST
    narrow = min(survey.spacing_mm / 2, widest / 2)
    centre = NonLinear("centre_mm", low, high, logarithmic=False)
    width = NonLinear("width_mm", narrow / 2, widest, usual=(survey.half_span_mm * USUAL_SHARE, USUAL_SPREAD))
    starts = tuple(
        (float(c), float(w))
        for w in np.geomspace(narrow, widest, WIDTHS)
        for c in np.minimum(np.arange(low, high + w / 2, w), high)
    )
    return Form(effect, IN_A_ZONE, inputs[:2], {}, (centre, width), starts)


def is_tilt(term: Term) -> bool:
    """Whether a load that tilts the carriage makes the same at an arm: it is alike in both directions, and no torque."""
    return term.form.inputs[0] == "load_kg" and term.form.name in BOTH_WAYS_ALIKE


def stiff_point_mm(term: Term) -> Estimate | None:
    """Where a load moves an axis that gives way from a stiff point by nothing, with its first-order uncertainty; None where the rows
    do not know it, or where nothing is that far outside the travel.
    """
    at_middle, change = term.coefficient(0), term.coefficient(1)
    if abs(change.value) <= max(POINT_KNOWN_TO * change.std, abs(at_middle.value) / FARTHEST_POINT):
        return None
    centre, half_span = term.form.constants["centre_mm"], term.form.constants["half_span_mm"]
    return term.derived(lambda c, _: centre - half_span * float(c[0] / c[1]))
