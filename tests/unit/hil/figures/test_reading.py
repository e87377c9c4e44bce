"""Averages at rest: what the outlier rule leaves out, what the mean is worth, and when a load is still moving."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import MeasurementLostError
from hil.figures.reading import Average, WindowCreep, average, creep, outliers


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


def test_a_correlated_window_by_hand() -> None:
    """1 2 3 4 µm: deviations ±0.5 and ±1.5, total 5; neighbours 0.75 - 0.25 + 0.75 = 1.25, ρ = 0.25 + 1/4 = 0.5.

    It may be at most 1 - 2/4 = 0.5; s = √(5/3) = 1.290994, of the mean s/√4 · √(1.5/0.5) = 1.118034.
    """
    got = average(np.array([1e-3, 2e-3, 3e-3, 4e-3]))
    assert (got.std_um, got.mean_std_um) == pytest.approx((1.2909944, 1.1180340))
    # 0 0 2 2 2 0 0 2 µm: ±1, total 8; neighbours 1 - 1 + 1 + 1 - 1 + 1 - 1 = 1, ρ = 1/8 + 1/8 = 0.25; s²/n = 8/7/8, · 1.25/0.75
    got = average(np.array([0.0, 0, 2, 2, 2, 0, 0, 2]) * 1e-3)
    assert got.mean_std_um == pytest.approx((8 / 7 / 8 * 1.25 / 0.75) ** 0.5)
    # ±1 2 3 3 µm: total 46; neighbours 9 + 6 + 2 - 1 + 2 + 6 + 9 = 33, ρ = 33/46 + 1/8 = 0.842, but at most 1 - 2/8: · 1.75/0.25
    got = average(np.array([-3.0, -3, -2, -1, 1, 2, 3, 3]) * 1e-3)
    assert got.mean_std_um == pytest.approx((46 / 7 / 8 * 7.0) ** 0.5)
    # 0 2 0 2: neighbours -3 of 4, ρ below 0 counts as none; s = √(4/3)
    got = average(np.array([0.0, 2, 0, 2]) * 1e-3)
    assert got.mean_std_um == pytest.approx((4 / 3 / 4) ** 0.5)
    # 1 2 3 climb steadily, but of three readings no correlation is told: s = 1
    assert average(np.array([1.0, 2, 3]) * 1e-3).mean_std_um == pytest.approx(1 / 3**0.5)
    two = average(np.array([0.0, 2e-3]))
    assert (two.count, two.std_um, two.mean_std_um) == (2, pytest.approx(2**0.5), pytest.approx(1.0))
    still = average(np.full(20, 5.0))
    assert (still.std_um, still.mean_std_um) == (0.0, 0.0)


def test_where_the_outlier_rule_begins_and_what_it_leaves_out() -> None:
    """21 readings -10 … 9 and f: median 0, distances 0 1 1 2 2 … 9 9 10 and f, the middle one 5.

    So σ = 1.4826·5 = 7.413, and the limit 6·(1 + 8/21) = 8.28571 of them, 61.422, whichever side f is on.
    """
    for far, out in ((61.3, False), (61.5, True)):
        readings = np.r_[np.arange(-10.0, 10.0), far]
        assert outliers(readings).tolist() == [False] * 20 + [out], far
        assert outliers(-readings).tolist() == [False] * 20 + [out], far
    nine, ten = np.r_[np.arange(8.0), 1e6], np.r_[np.arange(9.0), 1e6]
    assert not outliers(nine).any()
    assert outliers(ten).nonzero()[0].tolist() == [9]


def test_a_coarse_display_by_hand() -> None:
    """Of 20 readings 17 are 0, two are 1: the median distance is 0, so the mean counts, 1.2533·(2 + f)/20; limit 6·1.4 = 8.4.

    f itself is left out where f > 8.4·1.2533·(2 + f)/20 = 0.52639·(2 + f): beyond 2.2229.
    """
    for far, out in ((2.1, False), (2.3, True)):
        readings = np.r_[np.zeros(17), 1.0, 1.0, far]
        assert outliers(readings).tolist() == [False] * 19 + [out]


def test_how_many_may_be_left_out() -> None:
    """A tenth, and two in any case: of 20 two may go, three not; of 40 four may go, five not."""
    for n, gone, refused in (
        (20, 2, False),
        (20, 3, True),
        (40, 4, False),
        (40, 5, True),
        (100, 10, False),
        (100, 11, True),
    ):
        readings = np.r_[np.linspace(0.0, 1e-4, n - gone), 0.5 + np.arange(gone) / 10]
        if refused:
            with pytest.raises(MeasurementLostError, match=f"{gone} of {n} readings"):
                average(readings)
        else:
            assert average(readings).left_out == gone


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


def test_creep_by_hand() -> None:
    """0 1 2 3 s with 0 2 1 3 µm: about the means -1.5 … 1.5 and -1.5 0.5 -0.5 1.5: Σtx = 2.25 - 0.25 - 0.25 + 2.25 = 4, Σt² = 5.

    Slope 0.8, over 3 s 2.4 µm; residuals -0.3 0.9 -0.9 0.3, squares 1.8; σ of the slope √(1.8/2/5) = 0.424264, · 3 = 1.272792.
    """
    seen = creep(np.array([0.0, 1, 2, 3]) + 50.0, np.array([0.0, 2, 1, 3]) * 1e-3 + 7.0)
    assert (seen.change_um, seen.std_um) == pytest.approx((2.4, 1.2727922))
    back = creep(np.array([0.0, 1, 2, 3]), np.array([3.0, 1, 2, 0]) * 1e-3)
    assert back.change_um == pytest.approx(-2.4)
    for one in (WindowCreep(3.0, 1.0), WindowCreep(-3.0, 1.0)):
        assert one.within(1.0)  # 3 = 1 + 2·1
        assert not one.within(0.99)
    assert creep(np.array([0.0, 1, 2]), np.array([0.0, 9, 18])).std_um == np.inf
    assert np.isfinite(creep(np.array([0.0, 1, 2, 3]), np.array([0.0, 9, 18, 2])).std_um)
    assert creep(np.array([]), np.array([])) == WindowCreep(0.0, np.inf)


def test_a_glitch_is_no_creep() -> None:
    time_s = np.arange(20.0)
    position = 1e-3 * np.tile([0.0, 1.0], 10)
    spoilt = position.copy()
    spoilt[18] = 5.0
    kept = np.arange(20) != 18
    clean = creep(time_s[kept], position[kept])
    found = creep(time_s, spoilt)
    assert (found.change_um, found.std_um) == pytest.approx((clean.change_um, clean.std_um))


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
