"""Ageing in one series: run lengths against published tables, scores against Student's distribution, alarms against the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.fleet.detect import CLIP, LEAST, arl, cusum, memory, scores, threshold_for, watch


@pytest.mark.parametrize(
    ("threshold", "two_sided"),
    [(4.0, 168.0), (5.0, 465.0)],
)
def test_run_lengths_of_the_published_tables(threshold: float, two_sided: float) -> None:
    """Montgomery, Introduction to Statistical Quality Control, table 9.3: two-sided, k = 0.5. Each side runs twice as long."""
    assert arl(threshold, 0.5) / 2.0 == pytest.approx(two_sided, rel=0.005)


@pytest.mark.parametrize(
    ("reference", "threshold"), [(0.25, 8.01), (0.5, 4.77), (0.75, 3.34), (1.0, 2.52), (1.25, 1.99), (1.5, 1.61)]
)
def test_thresholds_of_the_published_table_for_370(reference: float, threshold: float) -> None:
    """Hawkins (1993), in Montgomery, table 9.4: k and h whose two-sided CUSUM runs 370 values without ageing."""
    assert threshold_for(740.0, reference, math.inf) == pytest.approx(threshold, abs=0.01)


@pytest.mark.parametrize("threshold", [3.0, 4.0, 5.0, 7.0])
@pytest.mark.parametrize("reference", [0.25, 0.5])
def test_run_lengths_beside_siegmunds_formula(threshold: float, reference: float) -> None:
    """Siegmund, Sequential Analysis (1985): (exp(2kb) − 2kb − 1)/(2k²) with b = h + 1.166, an approximation for small k."""
    b = threshold + 1.166
    siegmund = (math.exp(2.0 * reference * b) - 2.0 * reference * b - 1.0) / (2.0 * reference**2)
    assert arl(threshold, reference) == pytest.approx(siegmund, rel=0.03)


def test_a_threshold_gives_back_its_run_length() -> None:
    for wanted in (50.0, 1000.0, 20_000.0):
        assert arl(threshold_for(wanted), clip=CLIP) == pytest.approx(wanted, rel=1e-3)


def test_scores_are_standard_normal_whatever_level_and_noise_are() -> None:
    rng = np.random.default_rng(1)
    for level, noise in ((0.0, 1.0), (10.0, 0.01), (-3.0, 50.0)):
        found = np.concatenate([scores(rng.normal(level, noise, 40)) for _ in range(300)])
        found = found[np.isfinite(found)]
        assert len(found) == 300 * (40 - LEAST + 1)
        assert abs(found.mean()) < 0.03
        assert found.std() == pytest.approx(1.0, abs=0.02)


def test_false_alarms_are_as_frequent_as_stated() -> None:
    """The run length without ageing, of a CUSUM that knows neither level nor noise: 60 alarms, two thirds within 13 %."""
    rng, wanted = np.random.default_rng(3), 200.0
    threshold, values, alarms = threshold_for(wanted), 0, 0
    for _ in range(120):
        found = watch(rng.normal(5.0, 0.3, 100), threshold, either=True)
        first = found.alarms[0].at + 1 if found.alarms else 100
        values, alarms = values + 2 * first, alarms + bool(found.alarms)
    assert values / alarms == pytest.approx(wanted, rel=0.25)


@given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.integers(0, 100))
def test_units_and_zero_change_no_score(factor: float, shift: float, seed: int) -> None:
    values = np.random.default_rng(seed).normal(0.0, 1.0, 12)
    np.testing.assert_allclose(scores(values), scores(shift + factor * values), atol=1e-6)


def test_the_repeats_of_a_campaign_are_the_least_noise() -> None:
    """Three values that agree by chance do not make the fourth an event, where each says that it is uncertain by ±1."""
    values = np.array([10.0, 10.001, 10.0, 10.5])
    assert scores(values)[3] > 2.5
    assert scores(values, np.full(4, 1.0))[3] < 0.5
    assert scores(np.array([1.0, 1.0, 1.0, 1.0]))[3] == 0.0
    assert scores(np.array([1.0, 1.0, 1.0, 2.0]))[3] == CLIP


def test_one_wrong_measurement_is_no_alarm_and_blinds_nobody() -> None:
    rng = np.random.default_rng(4)
    values = rng.normal(10.0, 0.2, 60)
    values[20] = 1e6
    threshold = threshold_for(10_400.0)
    assert not watch(values, threshold).alarms
    values[40:] += 0.1 * np.arange(1.0, 21.0)
    found = watch(values, threshold).standing
    assert found is not None
    assert 40 <= found.at <= 55


def test_growth_is_found_with_its_beginning() -> None:
    values = np.random.default_rng(5).normal(10.0, 0.2, 60)
    values[30:] += 0.1 * np.arange(1.0, 31.0)
    found = watch(values, threshold_for(10_400.0))
    assert found.standing is not None
    assert 28 <= found.standing.onset <= 34 <= found.standing.at <= 42
    assert found.nearness(either=False) > 1.0


def test_after_a_repair_the_axis_is_measured_against_itself() -> None:
    """Worn, repaired, worn again: the second growth stays below the level before the repair."""
    rng = np.random.default_rng(6)
    course = np.concatenate([10.0 + 0.1 * np.arange(30.0), np.full(30, 6.0), 6.0 + 0.05 * np.arange(40.0)])
    found = watch(course + rng.normal(0.0, 0.2, 100), threshold_for(10_400.0), better_at=threshold_for(1e6))
    assert 25 <= found.begun <= 32
    first, *_, last = found.alarms
    assert first.at < 30
    assert first.until is not None
    assert found.standing == last
    assert 60 <= last.at <= 85
    either = watch(course + rng.normal(0.0, 0.2, 100), threshold_for(10_400.0), either=True)
    assert any(not one.upwards for one in either.alarms)


def test_an_alarm_ends_where_the_axis_is_as_before() -> None:
    values = np.random.default_rng(7).normal(10.0, 0.2, 120)
    values[40:46] += 1.0
    found = watch(values, threshold_for(10_400.0), either=True)
    assert found.alarms[0].at in range(41, 46)
    assert found.alarms[0].until is not None
    assert found.standing is None


@pytest.mark.parametrize("values", [[], [1.0], [1.0, 2.0], [0.0] * 9, [1e30, -1e30] * 5])
def test_short_and_odd_series_have_no_alarm(values: list[float]) -> None:
    if values:
        assert not watch(np.array(values), 5.0).alarms
    assert len(cusum(scores(np.array(values)))) == len(values)


def test_memory_is_told_from_chance() -> None:
    rng = np.random.default_rng(8)
    found, std = memory([scores(rng.normal(size=60)) for _ in range(30)])
    assert abs(found) < 3.0 * std
    season = np.sin(np.arange(60) / 8.0)
    found, std = memory([scores(season + rng.normal(0.0, 0.3, 60)) for _ in range(30)])
    assert found > 5.0 * std
    assert math.isnan(memory([])[0])
