"""Air index: an interferometer without (full) compensation for the air, whose reading is wrong by x·Δn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.air import air_inputs, excess_ppm
from hil.effects.base import UM_PER_MM_PPM, Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

INDEX = "air index"
LEAST_SHARE, MOST_SHARE = -1.5, 3.0
"""Shares of the full effect that can be: 1 where nothing is compensated, -1 where all is twice, by instrument and control; more where
a sensor that is wrong is compensated with as well.
"""


class AirIndex(Effect):
    """error_um = share·x·Δn·10⁻³, x in mm, Δn in ppm above standard air; share 1: no compensation at all."""

    id: ClassVar[str] = "air_index"
    title: ClassVar[str] = "air index not compensated"
    action: ClassVar[Action] = Action.FIX_SETUP
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("thermal_expansion", "vary the air and the screw temperature apart"),
        Rival("dead_path", "compare both ends of the travel while the air changes"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        inputs, constants = air_inputs(survey)
        return (Form(self.id, INDEX, (*inputs, "target_mm"), constants),) if inputs else ()

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name != INDEX:
            raise KeyError(form.name)
        excess = excess_ppm(form.inputs[:-1], form.constants, columns)
        return np.asarray(columns["target_mm"] * excess * UM_PER_MM_PPM)[:, None]

    def is_straight(self, form: Form) -> bool:
        return True

    def parameters(self, term: Term) -> dict[str, Estimate]:
        return {"uncompensated_share": term.coefficient(0)}

    def explain(self, term: Term) -> str:
        return (
            f"The reading follows position times the refractive index of the air, {term.coefficient(0)} of the full effect:"
            " the instrument's air compensation is off or its sensors are wrong."
        )

    def implausible(self, term: Term) -> str | None:
        share = term.coefficients[0]
        if LEAST_SHARE <= share <= MOST_SHARE:
            return None
        return f"{share:.2g} times the full effect of the air is neither compensation switched off nor applied twice"
