"""Datum step: a jump of the whole reading at one moment (a mount slipped, the beam was broken, the reference was lost)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.survey import Survey

STEP = "step"


class DatumStep(Effect):
    """error_um = h where t > t₀, else 0; h in µm, t₀ in s or rows."""

    id: ClassVar[str] = "datum_step"
    title: ClassVar[str] = "a jump at one moment"
    action: ClassVar[Action] = Action.RE_MEASURE
    several: ClassVar[bool] = True
    once: ClassVar[bool] = True
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("thermal_drift", "repeat a reference point several times within a run"),
        Rival("beam_drift", "repeat a reference point several times within a run"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.moments:
            return ()
        lower, upper = survey.moments[0], survey.moments[-1]
        moment = NonLinear("moment", lower, upper, logarithmic=False)
        between = {"interval": survey.interval_s}
        starts = tuple((m,) for m in survey.moments)
        return (Form(self.id, STEP, (survey.time_column,), between, (moment,), starts, exhaustive=True),)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name != STEP:
            raise KeyError(form.name)
        return (columns[form.inputs[0]] > theta[0]).astype(np.float64)[:, None]

    def bases(self, form: Form, thetas: Sequence[Sequence[float]], columns: Columns) -> Floats:
        return (columns[form.inputs[0]][:, None] > np.array(thetas)[:, 0]).astype(np.float64)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        unit = "rows" if term.form.inputs[0] == "row_order" else "s"
        between = term.form.constants.get("interval", 0.0) / math.sqrt(12.0)  # anywhere between two rows
        return {"step_um": term.coefficient(0), f"moment_{unit}": Estimate(term.theta[0], between)}

    def explain(self, term: Term) -> str:
        unit = "rows" if term.form.inputs[0] == "row_order" else "s"
        return (
            f"At {term.theta[0]:.4g} {unit} all readings jump by {term.coefficient(0)} µm: a mount slipped or the"
            " reference was lost; fix it and measure again."
        )
