"""Heat against an independent integration, and its limits."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_backends.plant.thermal import Thermal, ThermalParameters

PARAMETERS = ThermalParameters(
    heating_k_per_mm=1e-4, expansion_ppm_per_k=11.5, head_drift_um_per_k=0.5, head_rise_k=3.0, start_screw_rise_k=1.0
)


def integrate(p: ThermalParameters, power: float, air_c: float, seconds: float) -> np.ndarray:
    def rates(_t: float, y: np.ndarray) -> list[float]:
        screw, base, inner, outer = y
        return [
            power - (screw - air_c) / p.screw_to_air_s - (screw - base) / p.screw_to_base_s,
            (screw - base) / p.base_to_screw_s - (base - air_c) / p.base_to_air_s,
            (p.head_rise_k - inner) / p.head_lag_s,
            (inner - outer) / p.head_lag_s,
        ]

    start = [air_c + p.start_screw_rise_k, air_c, 0.0, 0.0]
    return solve_ivp(rates, (0.0, seconds), start, rtol=1e-11, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("steps", [1, 7, 3000])
def test_closed_form_is_exact_for_any_step(steps: int) -> None:
    thermal = Thermal(PARAMETERS, 21.0)
    for _ in range(steps):
        thermal.step(50.0 * 1500.0 / steps, 1500.0 / steps, 21.0)
    state = thermal.state
    expected = integrate(PARAMETERS, 50.0 * 1e-4, 21.0, 1500.0)
    assert [state.screw_c, state.base_c, state.head_inner_k, state.head_rise_k] == pytest.approx(expected, abs=1e-7)


def test_without_work_everything_ends_at_the_air() -> None:
    thermal = Thermal(PARAMETERS, 25.0)
    thermal.step(0.0, 1e6, 19.0)
    assert (thermal.state.screw_c, thermal.state.base_c) == pytest.approx((19.0, 19.0))


def test_expansion_grows_from_the_fixed_bearing() -> None:
    parameters = ThermalParameters(
        expansion_ppm_per_k=10.0, fixed_bearing_mm=100.0, base_share=0.0, start_screw_rise_k=2.0
    )
    thermal = Thermal(parameters, 21.0)  # screw at 23, reference 20
    assert thermal.expansion_mm(100.0) == 0.0
    assert thermal.expansion_mm(600.0) == pytest.approx(500.0 * 10e-6 * 3.0)
    assert thermal.expansion_mm(0.0) == pytest.approx(-100.0 * 10e-6 * 3.0)


def test_head_drift_is_no_plain_exponential() -> None:
    """Two lags in series start with no slope; one exponential fitted to the first half misses it."""
    thermal = Thermal(PARAMETERS, 20.0)
    thermal.step(0.0, 70.0, 20.0)
    early = thermal.head_drift_um
    assert early < 0.5 * 3.0 * 0.5 * (1.0 - math.exp(-70.0 / PARAMETERS.head_lag_s))
