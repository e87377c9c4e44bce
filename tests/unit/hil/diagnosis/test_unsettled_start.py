"""A machine that lags its thermometer and starts warmer or colder than that says, as after a night; a differential equation's solver,
which the program does not use, makes its temperature.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.diagnosis.campaign import prepare
from hil.diagnosis.diagnosing import diagnose
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Choice, Setting
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.verdict.courses import courses_as_good
from hil.effects import ALL
from hil.effects.history import complete
from hil.effects.survey import survey_of
from hil.effects.thermal_expansion import ThermalExpansion
from hil.effects.warming import from_a_start
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


def campaign(
    sensor: Course, away_k: float, seed: int = 1, noise_um: float = NOISE_UM, *, heated_ppm: float = 0.0
) -> Records:
    """Five times up and down over 600 mm, a row each 12 s; the screw grows about the axis's zero.

    heated_ppm: by how much it grows in the end because it runs, whatever the thermometer says
    """
    rng = np.random.default_rng(seed)
    way = np.linspace(0.0, 600.0, 15)
    target = np.tile(np.concatenate([way, way[::-1]]), 5)
    direction = np.tile(np.repeat([1.0, -1.0], 15), 5)
    grown_um = PPM_PER_K * target / 1e3 * (body_c(sensor, away_k) - 20.0)
    grown_um += heated_ppm * target / 1e3 * (1.0 - np.exp(-TIME_S / LAG_S))
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


SAID = re.compile(r"thermal_expansion by temp_screw_c .*, (\S+) ± (\S+) ppm/K, from a start (\S+) K away")


def said_of_a_start(found: Diagnosis) -> tuple[float, ...] | None:
    """Growth, its uncertainty and the difference at the first row, where a note says them."""
    matches = [match for note in found.notes if (match := SAID.search(note))]
    return tuple(map(float, matches[0].groups())) if matches else None


@pytest.mark.parametrize("sensor", [wave, steps])
@pytest.mark.parametrize("away_k", [-3.0, -1.0, 2.0])
def test_a_start_away_from_the_thermometer_is_said_with_its_figures_and_puts_names_in_doubt(
    sensor: Course, away_k: float
) -> None:
    found = diagnose(campaign(sensor, away_k))
    said = said_of_a_start(found)
    assert said is not None
    growth, uncertainty, away = said
    assert abs(growth - PPM_PER_K) < uncertainty < PPM_PER_K
    assert away == pytest.approx(away_k, rel=0.3)
    assert all(finding.confidence < 0.7 for finding in found.findings)


@pytest.mark.parametrize("sensor", [wave, steps])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_of_a_machine_that_had_settled_nothing_is_said(sensor: Course, seed: int) -> None:
    found = diagnose(campaign(sensor, 0.0, seed))
    assert said_of_a_start(found) is None
    (finding,) = found.findings
    assert finding.confidence > 0.9


@pytest.mark.parametrize("away_k", [0.0, -3.0])
def test_what_may_be_a_warm_up_stays_in_the_correction(away_k: float) -> None:
    """A screw that its own motion warms does so each morning; rows of one do not tell that from a start away from the thermometer."""
    found = diagnose(campaign(wave, away_k, heated_ppm=60.0))
    next_day = campaign(wave, away_k, seed=2, noise_um=0.0, heated_ppm=60.0)
    left_um = next_day.uncorrected_error_um - found.extended.error_um(complete(next_day.columns))
    assert np.std(left_um) < 1.5 * NOISE_UM


@pytest.mark.parametrize("effect", ["thermal_expansion", "thermal_drift"])
def test_the_form_is_what_the_solver_makes(effect: str) -> None:
    records = campaign(wave, -3.0)
    columns = {**records.columns, "temp_screw_c": wave(TIME_S)}
    known, survey = next(one for one in ALL if one.id == effect), survey_of(columns)
    form, *_ = from_a_start(known.forms(survey), survey)
    basis = known.basis(form, (LAG_S,), columns)
    weight = records.target_mm / 1e3 if effect == "thermal_expansion" else np.ones(len(records))
    assert basis @ [1.0, -3.0] == pytest.approx(weight * (body_c(wave, -3.0) - 20.0), abs=2e-3)
    assert form.starts == next(one for one in known.forms(survey) if one.name == "lagged temperature").starts[2:]


@pytest.mark.parametrize("count", [1, 2])
def test_a_course_of_time_is_held_against_what_rows_say_of_the_forms_and_not_against_their_prior(count: int) -> None:
    once = campaign(steps, 0.0).columns
    records = Records.of({**once, "temp_screw_c": 20.0 + 3.0 * (1.0 - np.exp(-TIME_S / LAG_S))})
    rows = prepare(records)
    effect = ThermalExpansion()
    searcher = Searcher(Setting.free(rows), enumerate_candidates(rows, (effect,)))
    forms = {form.name: form for form in effect.forms(rows.survey)}
    found = [Choice(effect, forms["temperature"], ()), Choice(effect, forms["lagged temperature"], (LAG_S,))][:count]
    unlikely = [replace(one, form=replace(one.form, log_odds=one.form.log_odds - 10.0)) for one in found]
    known, shifted = (courses_as_good(searcher, Noise(), some) for some in (found, unlikely))
    assert known
    assert shifted == pytest.approx(known)
