"""Cosine error: a beam at an angle θ to the travel reads short by x·θ²/2, a pure scale error whose sign never changes.

No data along the same beam separate it from a lead error of the screw.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import UM_PER_MM_PPM, Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

SCALE = "scale"
AS_FOUND = "scale, gone since the realignment"
FIRST_SETUP = 1.0
"""Value of the column `setup` before the beam was realigned for the first time; it counts up with every realignment."""


class Cosine(Effect):
    """error_um = -s·x·10⁻³, scale error s = θ²/2 in ppm, x in mm, θ in mrad (ISO/TR 230-9, misalignment)."""

    id: ClassVar[str] = "cosine"
    title: ClassVar[str] = "misaligned beam (cosine error)"
    action: ClassVar[Action] = Action.FIX_SETUP
    static: ClassVar[bool] = True
    log_odds: ClassVar[float] = 0.5  # where a lead error would do as well, the set-up is looked at first
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("pitch_shape", "realign the beam and repeat, or measure a reference artefact: data alone cannot tell"),
        Rival("thermal_expansion", "repeat at another temperature"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("target_mm"):
            return ()
        if survey.has("setup"):
            return (Form(self.id, AS_FOUND, ("target_mm", "setup")),)
        return (Form(self.id, SCALE, ("target_mm",)),)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        scale = np.asarray(columns["target_mm"] * -UM_PER_MM_PPM)
        if form.name == SCALE:
            return scale[:, None]
        if form.name == AS_FOUND:
            return np.asarray(np.where(columns["setup"] == FIRST_SETUP, scale, 0.0))[:, None]
        raise KeyError(form.name)

    def is_straight(self, form: Form) -> bool:
        return True

    def parameters(self, term: Term) -> dict[str, Estimate]:
        scale = term.coefficient(0)
        if scale.value <= 2.0 * scale.std:  # an angle whose square may be zero has a bound and no value
            most = math.sqrt(2e6 * max(scale.value + 2.0 * scale.std, 0.0))
            return {"scale_ppm": scale, "most_angle_urad": Estimate(most, 0.0)}
        angle = math.sqrt(2e6 * scale.value)
        return {"scale_ppm": scale, "angle_urad": Estimate(angle, 1e6 * scale.std / angle)}

    def explain(self, term: Term) -> str:
        rest = "a lead error of the screw looks the same" if term.form.name == SCALE else "realigning it took that away"
        known = self.parameters(term)
        if "angle_urad" not in known:
            return (
                f"The reading differs by {term.coefficient(0)} ppm of the position; a beam misaligned by at most"
                f" {known['most_angle_urad'].value:.3g} µrad would make it short; {rest}."
            )
        return (
            f"The reading is short by {term.coefficient(0)} ppm of the position, as a beam misaligned by"
            f" {known['angle_urad']} µrad is; {rest}."
        )

    def implausible(self, term: Term) -> str | None:
        return "a misaligned beam reads short, never long" if term.coefficients[0] < 0 else None
