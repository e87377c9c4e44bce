"""Temperatures without their thermometers' noise: against courses that are known, and another implementation of smoothing."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import make_smoothing_spline

from hil.effects import ALL, Form, Term
from hil.effects.history import Course, complete, lagged, through
from hil.effects.thermometers import MOST_NOISE_K, MOST_ROWS_KEPT, without_noise

ROWS = 300
NOISE_K = 0.03


def times(seed: int) -> np.ndarray:
    """Times of rows with uneven intervals and a pause between two runs, s."""
    steps = np.random.default_rng(seed).uniform(3.0, 9.0, ROWS)
    steps[ROWS // 2] = 400.0
    return np.cumsum(steps)


def body_c(time_s: np.ndarray, tau_s: float = 600.0) -> np.ndarray:
    """A body that a constant heat warms by 2 K in the end and that cools in the pause: exact solution of first-order heat flow."""
    level, out = 0.0, []
    for i, now in enumerate(time_s):
        step = now - (time_s[i - 1] if i else 0.0)
        end = 0.0 if i == ROWS // 2 else 2.0
        level = end + (level - end) * np.exp(-step / tau_s)
        out.append(20.0 + level)
    return np.array(out)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("seed", range(6))
def test_a_body_is_known_better_than_its_thermometer_says(seed: int) -> None:
    time_s = times(seed)
    true_c = body_c(time_s)
    reading = np.round(true_c + np.random.default_rng(seed + 100).normal(0.0, NOISE_K, ROWS), 2)
    found = without_noise(time_s, reading)
    assert rms(found - true_c) < 0.45 * rms(reading - true_c)


def test_it_is_nearly_the_smoothing_spline_of_another_implementation() -> None:
    time_s = np.cumsum(np.random.default_rng(3).uniform(4.0, 8.0, ROWS))
    true_c = 20.0 + np.sin(time_s / 300.0)
    reading = true_c + np.random.default_rng(4).normal(0.0, NOISE_K, ROWS)
    other = make_smoothing_spline(time_s, reading)(time_s)  # generalised cross-validation
    found = without_noise(time_s, reading)
    assert rms(found - other) < 0.5 * NOISE_K
    assert rms(found - true_c) < 1.1 * rms(other - true_c)


def test_a_temperature_that_walks_at_random_is_not_smoothed_away() -> None:
    rng = np.random.default_rng(5)
    true_c = 20.0 + np.cumsum(rng.normal(0.0, NOISE_K, ROWS))
    reading = true_c + rng.normal(0.0, NOISE_K / 2.0, ROWS)
    found = without_noise(np.arange(ROWS) * 5.0, reading)
    assert rms(found - true_c) < rms(reading - true_c)


@pytest.mark.parametrize("resolution_k", [0.0, 0.1])
def test_what_is_within_the_noise_of_thermometers_is_smoothed_and_what_is_not_is_left(resolution_k: float) -> None:
    rng, time_s = np.random.default_rng(6), np.arange(ROWS) * 5.0
    line = 20.0 + time_s / 1000.0
    read = line + rng.normal(0.0, 0.8 * MOST_NOISE_K, ROWS)
    read = np.round(read / resolution_k) * resolution_k if resolution_k else read
    assert rms(without_noise(time_s, read) - line) < 0.3 * MOST_NOISE_K
    at_random = line + rng.normal(0.0, 3.0 * MOST_NOISE_K, ROWS)
    assert np.array_equal(without_noise(time_s, at_random), at_random)


@pytest.mark.parametrize("exact", [np.full(ROWS, 20.0), 20.0 + np.arange(ROWS) * 0.01])
def test_a_course_without_noise_stays(exact: np.ndarray) -> None:
    assert without_noise(np.arange(ROWS) * 5.0, exact) == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize(
    "time_s",
    [np.arange(8) * 5.0, np.full(40, 7.0), np.concatenate([np.arange(9.0), np.arange(9.0)])],
    ids=["too few", "one moment", "too few before a clock starts again"],
)
def test_without_a_course_of_time_readings_stay(time_s: np.ndarray) -> None:
    reading = 20.0 + np.random.default_rng(7).normal(0.0, NOISE_K, len(time_s))
    assert np.array_equal(without_noise(time_s, reading), reading)


def test_where_a_clock_begins_anew_each_stretch_counts_by_itself() -> None:
    rng, time_s = np.random.default_rng(11), np.arange(60) * 5.0
    line = np.linspace(0.0, 1.0, 60)
    first, second = (level + line + rng.normal(0.0, NOISE_K, 60) for level in (20.0, 25.0))
    found = without_noise(np.tile(time_s, 2), np.concatenate([first, second]))
    apart = [without_noise(time_s, one) for one in (first, second)]
    assert np.array_equal(found, np.concatenate(apart))
    assert rms(found[:60] - 20.0 - line) < 0.5 * NOISE_K


@pytest.mark.parametrize("apart_s", [1e-9, 1e-6, 1e-4, 1e-3, 0.1])
def test_rows_that_nearly_coincide_do_no_harm(apart_s: float) -> None:
    """Wherever such a pair lies, also across a border of what is averaged."""
    rng, time_s = np.random.default_rng(12), np.arange(100) * 10.0
    for shift_s in rng.uniform(0.0, 10.0, 20):
        pairs = np.sort(np.concatenate([time_s, time_s[5::9] + shift_s, time_s[5::9] + shift_s + apart_s]))
        reading = 20.0 + pairs / 1000.0 + rng.normal(0.0, NOISE_K, len(pairs))
        assert rms(without_noise(pairs, reading) - 20.0 - pairs / 1000.0) < 0.5 * NOISE_K


def test_a_pause_of_a_day_blurs_nothing() -> None:
    """Two sessions that warm up by 0.2 mK/s, one day apart, and a row alone a day later."""
    one = np.arange(300) * 10.0
    time_s = np.concatenate([one, 86400.0 + one, [2 * 86400.0]])
    true_c = np.concatenate([20.0 + 2e-4 * one, 21.0 + 2e-4 * one, [20.0]])
    found = without_noise(time_s, true_c + np.random.default_rng(13).normal(0.0, 0.005, len(time_s)))
    assert rms(found - true_c) < 0.004
    assert np.max(np.abs(found - true_c)) < 0.02


@pytest.mark.parametrize("leap_k", [0.1, 1.0, 10.0])
def test_a_temperature_that_leaps_is_known_no_worse(leap_k: float) -> None:
    time_s = np.arange(ROWS) * 5.0
    true_c = 20.0 + leap_k * (time_s > 700.0)
    reading = true_c + np.random.default_rng(14).normal(0.0, 0.02, ROWS)
    assert rms(without_noise(time_s, reading) - true_c) <= rms(reading - true_c)


def test_a_line_through_noise_is_no_course() -> None:
    """0.02 K over the record, with as much noise: smoothed it would be a line, which any drift with time follows."""
    time_s = np.arange(48) * 6.0
    reading = np.round(20.0 + time_s * 7e-5 + np.random.default_rng(18).normal(0.0, 0.02, 48), 2)
    assert np.array_equal(without_noise(time_s, reading), reading)


def test_one_wrong_reading_leaves_the_others_as_they_are() -> None:
    reading = np.linspace(20.0, 21.0, ROWS) + np.random.default_rng(17).normal(0.0, 0.01, ROWS)
    assert not np.array_equal(without_noise(np.arange(ROWS) * 5.0, reading), reading)
    reading[100] += 0.6
    assert np.array_equal(without_noise(np.arange(ROWS) * 5.0, reading), reading)


def test_a_reading_that_is_held_counts_once() -> None:
    """One per pass of 40 rows: 16 independent readings, not 640; and a thermometer that rounds holds nothing."""
    time_s = np.arange(640) * 2.0
    true_c = 20.0 + time_s / 2000.0
    off = []
    for seed in range(8):
        held = np.repeat(true_c[20::40] + np.random.default_rng(seed).normal(0.0, NOISE_K, 16), 40)
        off.append((rms(without_noise(time_s, held) - true_c), rms(held - true_c)))
    now, before = np.mean(off, axis=0)
    assert now < 0.65 * before
    rounded = np.round((true_c + np.random.default_rng(16).normal(0.0, NOISE_K, 640)) * 10.0) / 10.0
    assert rms(without_noise(time_s, rounded) - true_c) < 0.3 * NOISE_K


def test_many_rows_take_no_longer_than_few_and_are_as_well_known() -> None:
    time_s = np.sort(np.random.default_rng(8).uniform(0.0, 1e4, 100_000))
    true_c = 20.0 + np.sin(time_s / 2000.0)
    found = without_noise(time_s, true_c + np.random.default_rng(9).normal(0.0, NOISE_K, len(time_s)))
    assert rms(found - true_c) < 0.1 * NOISE_K


SLOW = {"temp_screw_c": 0.03, "air_temp_c": 0.02, "air_pressure_hpa": 0.06, "air_humidity_percent": 0.3}
OTHERS = ("load_kg", "torque_percent", "pitch_urad", "pos_y_mm", "command_mm")


def test_rows_are_completed_once_and_only_sensors_of_what_is_slow_are_touched() -> None:
    """Noise that no barometer has is the air's own: it is left."""
    rng, time_s = np.random.default_rng(10), times(10)
    noise = {**SLOW, **dict.fromkeys(OTHERS, 0.03)}
    read = {name: body_c(time_s) + rng.normal(0.0, size, ROWS) for name, size in noise.items()}
    rows = {"run": np.ones(ROWS), "direction": np.ones(ROWS), "target_mm": np.linspace(0.0, 300.0, ROWS)}
    full = complete(rows | {"time_s": time_s} | read)
    for name, size in SLOW.items():
        assert rms(full[name] - body_c(time_s)) < 0.5 * size
        assert np.array_equal(complete(full)[name], full[name])
    assert all(np.array_equal(full[name], read[name]) for name in OTHERS)
    gusts = body_c(time_s) + rng.normal(0.0, 0.3, ROWS)
    assert np.array_equal(complete(rows | {"time_s": time_s, "air_pressure_hpa": gusts})["air_pressure_hpa"], gusts)


def test_a_course_that_is_kept_cannot_be_changed_from_outside() -> None:
    time_s = times(3)
    reading = body_c(time_s) + np.random.default_rng(3).normal(0.0, NOISE_K, ROWS)
    found = without_noise(time_s, reading)
    with pytest.raises(ValueError, match="read-only"):
        found += 1.0
    assert without_noise(time_s, reading.copy()) is found  # the same readings are smoothed once
    long = np.arange(MOST_ROWS_KEPT + 1.0), np.tile(reading, MOST_ROWS_KEPT // ROWS + 1)[: MOST_ROWS_KEPT + 1]
    assert without_noise(*long) is not without_noise(*long)  # but not of a record that takes much memory


READINGS = st.lists(st.tuples(st.floats(1.0, 300.0), st.floats(-20.0, 80.0)), min_size=1, max_size=30)


@given(READINGS, st.floats(1.0, 5000.0))
def test_the_course_of_a_sensor_ends_where_the_lag_over_all_its_readings_does(
    said: list[tuple[float, float]], tau_s: float
) -> None:
    time_s, value = np.cumsum([step for step, _ in said]), np.array([one for _, one in said])
    course = Course()
    for i, (now_s, one) in enumerate(zip(time_s, value, strict=True)):
        course.note(float(now_s), {"temp_screw_c": float(one), "load_kg": 3.0})
        if i % 3 == 0:  # asked in between or not, it is the same
            course.now("temp_screw_c", tau_s)
    assert course.now("temp_screw_c", tau_s) == pytest.approx(lagged(time_s, value, tau_s)[-1], abs=1e-6)
    assert course.now("load_kg", tau_s) is None


def test_a_course_has_no_value_before_the_first_reading_and_none_of_a_sensor_that_fails() -> None:
    course = Course()
    assert course.now("temp_screw_c", 60.0) is None
    for now_s, value in ((0.0, 20.0), (60.0, 30.0), (120.0, float("nan"))):
        course.note(now_s, {"temp_screw_c": value})
    assert course.now("temp_screw_c", 60.0) == pytest.approx(
        20.0 + 10.0 * np.exp(-1.0)
    )  # a ramp of 10 K over one time constant


def test_the_course_of_days_stays_small_and_quick_readings_are_thinned() -> None:
    course = Course()
    for i in range(100_000):
        course.note(i * 0.5, {"temp_screw_c": 20.0 + i / 10_000.0})
    assert len(pickle.dumps(course)) <= 20_001 * 22  # of 20,000 readings, each a pair of numbers; all would have 2 MB
    behind_k = 600.0 * 2e-4  # of a ramp, a lag is its time constant behind
    assert course.now("temp_screw_c", 600.0) == pytest.approx(29.9999 - behind_k, abs=1e-4)


@pytest.mark.parametrize("effect", ["thermal_drift", "thermal_expansion"])
def test_a_correction_reads_the_sensor_through_the_lag_of_its_effect(effect: str) -> None:
    thermal = next(one for one in ALL if one.id == effect)
    inputs = ("temp_screw_c", "time_s", "target_mm") if effect == "thermal_expansion" else ("temp_screw_c", "time_s")
    term = Term(thermal, Form(effect, "lagged temperature", inputs), (60.0,), (2.0,), ((0.0, 0.0), (0.0, 0.0)))
    assert term.lag == ("temp_screw_c", 60.0)
    row = {"temp_screw_c": np.full(3, 30.0), "time_s": np.full(3, 99.0), "target_mm": np.full(3, 500.0)}
    now = term.error_um(row | {through("temp_screw_c", 60.0): np.full(3, 22.0)})
    assert now == pytest.approx(np.full(3, 4.0 if effect == "thermal_drift" else 2.0))  # 2 K; 2 ppm/K of 500 mm
    assert term.error_um(row)[0] == pytest.approx(5.0 * now[0])  # its course unknown: as it is
    plain = Term(thermal, Form(effect, "temperature", inputs), (), (2.0,), ((0.0,),))
    assert plain.lag is None
