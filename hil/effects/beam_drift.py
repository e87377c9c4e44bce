"""Beam drift: an offset that varies with time alone (laser warming up, mount creeping, turbulent air).

A sum of cosines of time over the campaign whose amplitudes fall with frequency (random walk or 1/f), shrunk towards
zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Rival, Term
from hil.effects.survey import Survey

UNSTEADY = -2.0
"""Prior log odds: a free course of time fits whatever a warm-up does, and would win over it by a hair. Of 106 machines of the study
with a slow cause (reporting seeds 804980 to 805479, seen) it makes 7 more names right and one fewer; of 40 others two and two.
"""
WAVES = 40
WANDER, FLICKER = "random walk", "flicker"
SLOPES = {WANDER: 1.0, FLICKER: 0.5}
"""Power of the frequency by which the amplitude falls: 1/f² (random walk) and 1/f noise."""


class BeamDrift(Effect):
    """error_um = Σ c_k·k^(-p)·cos(πk·t), t the time as a fraction of the campaign (0 … 1), p 1 for a random walk, 0.5
    for 1/f noise.
    """

    id: ClassVar[str] = "beam_drift"
    title: ClassVar[str] = "wandering beam or mount"
    action: ClassVar[Action] = Action.FIX_SETUP
    once: ClassVar[bool] = True
    log_odds: ClassVar[float] = UNSTEADY
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("thermal_drift", "log the temperatures, let the axis cool down and warm up again"),
        Rival("datum_step", "repeat a reference point several times within a run"),
        Rival("dead_path", "log the air, and change the dead path"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.moments:
            return ()
        waves = min(WAVES, survey.rows // 4)
        constants = {"start": survey.time_start, "duration": survey.duration_s, "waves": float(waves)}
        return tuple(Form(self.id, name, (survey.time_column,), constants, shrunk=True) for name in SLOPES)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        phase = (columns[form.inputs[0]] - form.constants["start"]) / form.constants["duration"]
        waves = np.arange(1, int(form.constants["waves"]) + 1)
        return np.asarray(np.cos(np.pi * np.clip(phase, 0.0, 1.0)[:, None] * waves) * waves ** -SLOPES[form.name])

    def parameters(self, term: Term) -> dict[str, Estimate]:
        k = len(term.coefficients)
        weight = np.arange(1, k + 1) ** -SLOPES[term.form.name]
        c = np.array(term.coefficients) * weight
        covariance = np.array(term.covariance) * np.outer(weight, weight)
        size = float(np.sqrt(np.sum(c**2) / 2))
        variance = float(c @ covariance @ c) / max(4 * size**2, 1e-12)
        return {"wander_rms_um": Estimate(size, float(np.sqrt(max(variance, 0.0))))}

    def explain(self, term: Term) -> str:
        return (
            f"The reading wanders with time by {term.parameters['wander_rms_um']} µm RMS and follows no temperature,"
            " air or position: beam, mount or instrument are not steady."
        )
