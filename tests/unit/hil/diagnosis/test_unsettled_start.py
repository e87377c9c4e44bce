"""A machine that lags its thermometer and starts warmer or colder than that says, as after a night; a differential equation's solver,
which the program does not use, makes its temperature.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.diagnosis import diagnose
from hil.effects.history import complete
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


@pytest.mark.parametrize("sensor", [wave, steps])
@pytest.mark.parametrize("away_k", [-3.0, -1.0, 0.0, 2.0])
def test_wherever_the_screw_starts_it_is_growth_and_all_there_is(sensor: Course, away_k: float) -> None:
    found = diagnose(campaign(sensor, away_k))
    assert found.findings[0].effect == "thermal_expansion"
    assert not found.unexplained
    assert found.after.rms_um < 0.5 * found.before.rms_um
    if away_k == 0.0:
        assert "temp_screw_c" in found.findings[0].term.needs


@pytest.mark.parametrize("away_k", [0.0, -3.0])
def test_what_may_be_a_warm_up_stays_in_the_correction(away_k: float) -> None:
    """A screw that its own motion warms does so each morning; rows of one do not tell that from a start away from the thermometer."""
    found = diagnose(campaign(wave, away_k, heated_ppm=60.0))
    next_day = campaign(wave, away_k, seed=2, noise_um=0.0, heated_ppm=60.0)
    left_um = next_day.uncorrected_error_um - found.extended.error_um(complete(next_day.columns))
    assert np.std(left_um) < 1.5 * NOISE_UM
