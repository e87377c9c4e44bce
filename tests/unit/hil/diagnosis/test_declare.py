"""Effects that somebody says are there, fitted beside the table."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from drivers.errors import InputError
from hil.diagnosis import fit_model
from hil.effects.beam_drift import BeamDrift
from hil.effects.lost_motion import LostMotion
from hil.effects.velocity_lag import VelocityLag

Array = np.ndarray


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {
        "velocity_mm_s": rng.choice([10.0, 30.0, 90.0], n),
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


def machine(c: dict[str, Array]) -> Array:
    d = c["direction"]
    return wavy(c) + 0.01 * d * c["velocity_mm_s"] + 1.5 * d * np.exp(-c["since_reversal_mm"] / 15.0)


def test_both_effects_are_in_the_model_with_the_parameters_of_the_machine() -> None:
    records = campaign(machine, sensors=sensors)
    model = fit_model(records, [LostMotion(), VelocityLag()])
    assert set(model.declared) == {"pitch_table", "lost_motion", "velocity_lag"}
    of = {term.effect.id: term for term in model.terms}
    assert of["velocity_lag"].coefficients[0] == pytest.approx(0.01, abs=0.002)
    assert of["lost_motion"].coefficients[0] == pytest.approx(1.5, abs=0.5)
    fresh = campaign(machine, sensors=sensors, seed=2)
    left = fresh.uncorrected_error_um - model.error_um(fresh.columns)
    assert np.sqrt(np.mean(left**2)) < 1.2 * 0.3


def test_none_at_all_is_the_table_alone() -> None:
    records = campaign(wavy)
    assert fit_model(records).declared == ["pitch_table"]


def test_what_cannot_be_corrected_or_seen_is_refused_by_name() -> None:
    records = campaign(wavy)
    with pytest.raises(InputError, match="beam_drift is never corrected"):
        fit_model(records, [BeamDrift()])
    with pytest.raises(InputError, match="cannot show velocity_lag: a column is missing"):
        fit_model(records, [VelocityLag()])
