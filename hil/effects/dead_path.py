"""Dead path: the uncompensated length of air between the interferometer and the zero of the axis, times the change of
its index.

A laser measures optical length: the offset n_air(t)·L_dead follows the weather.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.air import air_inputs, excess_ppm
from hil.effects.base import UM_PER_MM_PPM, Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

INDEX = "air index"


class DeadPath(Effect):
    """error_um = L·Δn·10⁻³, dead path L in mm, Δn in ppm above standard air; the same at every position."""

    id: ClassVar[str] = "dead_path"
    title: ClassVar[str] = "dead path of the interferometer"
    action: ClassVar[Action] = Action.FIX_SETUP
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("thermal_drift", "change the dead path: the drift changes with it, or not"),
        Rival("beam_drift", "log the air, and change the dead path"),
        Rival("air_index", "compare both ends of the travel while the air changes"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        inputs, constants = air_inputs(survey)
        return (Form(self.id, INDEX, inputs, constants),) if inputs else ()

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name != INDEX:
            raise KeyError(form.name)
        return np.asarray(excess_ppm(form.inputs, form.constants, columns) * UM_PER_MM_PPM)[:, None]

    def parameters(self, term: Term) -> dict[str, Estimate]:
        return {"dead_path_mm": term.coefficient(0)}

    def explain(self, term: Term) -> str:
        return (
            f"The reading follows the refractive index of the air over a fixed length of {term.coefficient(0)} mm:"
            " an uncompensated dead path; set it before zeroing."
        )

    def implausible(self, term: Term) -> str | None:
        size = abs(term.coefficients[0])
        return f"a dead path of {size / 1e3:.0f} m does not fit a machine hall" if size > 20e3 else None
