"""A machine that lags its thermometer and starts warmer or colder than that says, as after a night; a differential equation's solver,
which the program does not use, makes its temperature.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.diagnosis.diagnosing import diagnose
from hil.effects import ALL
from hil.effects.survey import survey_of
from hil.records.rows import Records

Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
Course = Callable[[Floats], Floats]
PPM_PER_K, LAG_S, NOISE_UM = 11.5, 900.0, 0.4
TIME_S = 12.0 * np.arange(150.0)
LAST_S = float(TIME_S[-1])


def wave(time_s: Floats) -> Floats:
    return np.asarray(20.5 + 1.2 * np.sin(2.0 * np.pi * time_s / (0.8 * LAST_S)))


def steps(time_s: Floats) -> Floats:
    up, down = (np.tanh((time_s - share * LAST_S) / (0.05 * LAST_S)) for share in (0.3, 0.7))
    return np.asarray(20.0 + 1.5 * up - down)


def body_c(sensor: Course, away_k: float) -> Floats:
    """Temperature of what grows behind the sensor, by the solver."""
    found = solve_ivp(
        lambda now, body: (sensor(np.array(now)) - body) / LAG_S,
        (0.0, LAST_S),
        [float(sensor(np.array(0.0))) + away_k],
        t_eval=TIME_S,
        rtol=1e-8,
        atol=1e-8,
        max_step=LAST_S / 500.0,
    )
    return np.asarray(found.y[0])


def campaign(sensor: Course, away_k: float, seed: int = 1, noise_um: float = NOISE_UM) -> Records:
    """Five times up and down over 600 mm, a row each 12 s; the screw grows about the axis's zero."""
    rng = np.random.default_rng(seed)
    way = np.linspace(0.0, 600.0, 15)
    target = np.tile(np.concatenate([way, way[::-1]]), 5)
    direction = np.tile(np.repeat([1.0, -1.0], 15), 5)
    grown_um = PPM_PER_K * target / 1e3 * (body_c(sensor, away_k) - 20.0)
    error_um = 5.0 * np.sin(target / 150.0) + 1.2 * direction + grown_um
    return Records.of(
        {
            "run": np.repeat(np.arange(1.0, 6.0), 30),
            "direction": direction,
            "target_mm": target,
            "measured_mm": target + (error_um + noise_um * rng.normal(size=len(target))) / 1e3,
            "time_s": TIME_S,
            "temp_screw_c": sensor(TIME_S) + 0.03 * rng.normal(size=len(target)),
        }
    )


@pytest.mark.parametrize("sensor", [wave, steps])
@pytest.mark.parametrize("away_k", [-3.0, -1.0, 2.0])
def test_growth_and_start_of_a_machine_that_was_not_settled(sensor: Course, away_k: float) -> None:
    """Without the start, courses of time and drifts were named here, growths of 15 ppm/K, and 2.8 µm RMS left unexplained."""
    found = diagnose(campaign(sensor, away_k))
    (finding,) = found.findings
    assert finding.effect == "thermal_expansion"
    assert not found.unexplained
    for name, true in (("coefficient_ppm_per_k", PPM_PER_K), ("start_away_k", away_k)):
        low, high = finding.parameters[name].interval
        assert low <= true <= high, name
    assert "K away from it at the start" in finding.explanation
    assert found.after.rms_um < 2.0 * NOISE_UM


@pytest.mark.parametrize("sensor", [wave, steps])
def test_another_campaign_is_corrected_from_a_start_of_its_own(sensor: Course) -> None:
    found = diagnose(campaign(sensor, -3.0))
    (term,) = found.extended.terms
    assert "unsettled" not in term.form.name
    assert len(term.coefficients) == 1
    assert len(term.covariance) == 2
    settled = campaign(steps if sensor is wave else wave, 0.0, seed=2, noise_um=0.0)
    left_um = settled.uncorrected_error_um - found.extended.error_um(settled.columns)
    assert np.std(left_um) < 1.5 * NOISE_UM
    assert any("began -" in note and "starts settled" in note for note in found.notes)
    assert np.std(found.residual_um) < 1.1 * NOISE_UM, "its own rows keep their start"


@pytest.mark.parametrize("sensor", [wave, steps])
def test_a_machine_that_was_settled_has_no_start(sensor: Course) -> None:
    (finding,) = diagnose(campaign(sensor, 0.0)).findings
    assert "start_away_k" not in finding.parameters
    low, high = finding.parameters["coefficient_ppm_per_k"].interval
    assert low <= PPM_PER_K <= high


@pytest.mark.parametrize("effect", ["thermal_expansion", "thermal_drift"])
def test_the_form_is_what_the_solver_makes(effect: str) -> None:
    records = campaign(wave, -3.0)
    columns = {**records.columns, "temp_screw_c": wave(TIME_S)}
    known = next(one for one in ALL if one.id == effect)
    name = "lagged temperature, unsettled at the start"
    form = next(one for one in known.forms(survey_of(columns)) if one.name == name)
    basis = known.basis(form, (LAG_S,), columns)
    weight = records.target_mm / 1e3 if effect == "thermal_expansion" else np.ones(len(records))
    assert basis @ [1.0, -3.0] == pytest.approx(weight * (body_c(wave, -3.0) - 20.0), abs=2e-3)
