"""Averages at rest: what the outlier rule leaves out, what the mean is worth, and when a load is still moving."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import MeasurementLostError
from hil.reading import Average, average, creep, outliers


def correlated(rng: np.random.Generator, rho: float, n: int) -> np.ndarray:
    """n values of unit-noise AR(1), in equilibrium."""
    values = np.empty(n)
    values[0] = rng.normal() / np.sqrt(1 - rho * rho)
    for i in range(1, n):
        values[i] = rho * values[i - 1] + rng.normal()
    return values


def test_a_worked_window() -> None:
    got = average(np.array([1.0, 1.0 + 1e-3, 1.0 - 1e-3]))
    assert got == Average(pytest.approx(1.0), pytest.approx(1.0), pytest.approx(1.0 / np.sqrt(3)), 3, 0)
    alone = average(np.array([2.5]))
    assert (alone.position_mm, alone.count) == (2.5, 1)
    assert np.isnan([alone.std_um, alone.mean_std_um]).all()


@pytest.mark.parametrize("n", [10, 15, 25, 50])
def test_normal_readings_are_left_alone_but_for_one_window_in_some_hundreds(n: int) -> None:
    rng = np.random.default_rng(n)
    lost = sum(bool(outliers(rng.normal(size=n)).any()) for _ in range(500))
    assert lost <= 3


@pytest.mark.parametrize("n", [10, 25, 100])
def test_a_glitch_is_left_out_and_counted(n: int) -> None:
    rng = np.random.default_rng(3)
    clean = 100.0 + 1e-5 * rng.normal(size=n)
    spoilt = clean.copy()
    spoilt[n // 2] += 0.5
    got = average(spoilt)
    assert (got.left_out, got.count) == (1, n - 1)
    assert got.position_mm == pytest.approx(np.delete(clean, n // 2).mean(), abs=1e-12)


def test_a_coarse_display_keeps_its_last_digit_and_loses_its_glitch() -> None:
    coarse = np.full(20, 3.0)
    coarse[[2, 7, 11, 15]] = 3.0001
    assert not outliers(coarse).any()
    coarse[5] = 3.5
    assert outliers(coarse).nonzero()[0].tolist() == [5]
    assert not outliers(np.full(20, 3.0)).any()


def test_an_unsteady_signal_is_refused_not_trimmed() -> None:
    readings = np.r_[np.linspace(0, 1e-4, 17), 0.5, 0.6, 0.7]
    with pytest.raises(MeasurementLostError, match="3 of 20 readings stand apart"):
        average(readings)


@pytest.mark.parametrize(("rho", "least"), [(0.0, 0.93), (0.5, 0.90), (0.8, 0.80)])
def test_the_mean_lies_within_two_of_its_standard_deviations(rho: float, least: float) -> None:
    """50 readings: without the correlation of neighbours the share at 0.8 would be 0.5."""
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(250):
        got = average(correlated(rng, rho, 50))
        inside += abs(got.position_mm * 1000) < 2 * got.mean_std_um
    assert inside / 250 >= least


def test_creep_is_the_change_over_the_window() -> None:
    time_s = np.linspace(5.0, 6.0, 21)
    seen = creep(time_s, 10.0 + 2e-3 * (time_s - 5.0))
    assert seen.change_um == pytest.approx(2.0)
    assert not seen.within(1.9)
    assert seen.within(2.1)


def test_noise_alone_is_at_rest_and_motion_is_not() -> None:
    rng = np.random.default_rng(7)
    time_s = np.arange(25) / 50.0
    still = [creep(time_s, 1e-4 * rng.normal(size=25)).within(0.001) for _ in range(250)]
    moving = [creep(time_s, 1e-4 * rng.normal(size=25) + 1e-3 * time_s).within(0.05) for _ in range(250)]
    assert np.mean(still) > 0.92
    assert np.mean(moving) < 0.02


def test_of_too_few_readings_rest_cannot_be_denied() -> None:
    assert creep(np.array([]), np.array([])).within(0.0)
    assert creep(np.ones(9), np.arange(9.0)).within(0.0)
