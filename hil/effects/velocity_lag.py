"""Velocity lag: an error proportional to the feed, d·|v| (following error, latency of the reading).

Refining forms let it saturate or add a quadratic term. The sign of `velocity_mm_s` is not used: the direction gives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import MOST_UNSURE, Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.survey import Survey

PROPORTIONAL, SATURATING, CURVED = "proportional", "saturating", "with square"


class VelocityLag(Effect):
    """error_um = τ·d·|v|, τ in ms (µm per mm/s), v in mm/s; refining forms add d·v² or divide by 1 + |v|/knee."""

    id: ClassVar[str] = "velocity_lag"
    title: ClassVar[str] = "lag proportional to velocity"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("backlash", "three feeds: backlash is the same at each"),
        Rival("lost_motion", "three feeds after the same travel since the reversal"),
        Rival("load_deflection", "three feeds at one load: torque grows with speed too"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("velocity_mm_s", "direction"):
            return ()
        inputs = ("velocity_mm_s", "direction")
        size = max(abs(survey.mean["velocity_mm_s"]), 1e-3)
        fastest = {"fastest_mm_s": max(map(abs, survey.ranges.get("velocity_mm_s", (size, size))))}
        knee = NonLinear("knee_mm_s", size / 10, size * 30)
        starts = tuple((size * factor,) for factor in (0.3, 1.0, 3.0))
        return (
            Form(self.id, PROPORTIONAL, inputs),
            Form(self.id, CURVED, inputs, scan=False),
            Form(self.id, SATURATING, inputs, fastest, (knee,), starts, scan=False),
        )

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        speed, d = np.abs(columns["velocity_mm_s"]), columns["direction"]
        if form.name == PROPORTIONAL:
            return np.asarray(d * speed)[:, None]
        if form.name == CURVED:
            return np.column_stack([d * speed, d * speed**2])
        if form.name == SATURATING:
            return np.asarray(d * speed / (1.0 + speed / theta[0]))[:, None]
        raise KeyError(form.name)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        lag = term.coefficient(0)  # µm per mm/s = ms
        if term.theta and lag.std > MOST_UNSURE * abs(lag.value):
            return {"error_at_fastest_um": _at_fastest(term), **term.positive(0, "knee_mm_s")}
        found = {"lag_ms": lag}
        if term.form.name == CURVED:
            found["curvature_um_s2_per_mm2"] = term.coefficient(1)
        return found | (term.positive(0, "knee_mm_s") if term.theta else {})

    def explain(self, term: Term) -> str:
        kind = "" if term.form.name == PROPORTIONAL else f" ({term.form.name})"
        if term.theta and "lag_ms" not in self.parameters(term):
            fastest = term.form.constants.get("fastest_mm_s", term.theta[0])
            return (
                f"The error grows with velocity in the direction of motion{kind}, to {_at_fastest(term)} µm at"
                f" {fastest:.4g} mm/s; the lag of slow motion these rows do not determine."
            )
        return f"The error grows with velocity in the direction of motion{kind}: {term.coefficient(0)} µm per mm/s, a lag in ms."


def _at_fastest(term: Term) -> Estimate:
    """The error at the highest velocity of the rows, µm."""
    return term.at({"velocity_mm_s": term.form.constants.get("fastest_mm_s", term.theta[0]), "direction": 1.0})
