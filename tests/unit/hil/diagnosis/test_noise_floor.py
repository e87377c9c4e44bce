"""The noise floor is pure error where targets repeat, and what a model leaves is judged against it, on data certified by NIST."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.campaigns import campaign, wavy
from support.workshop import workshop

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.diagnosing import beyond_noise, predicted_um
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.noise.noise_fit import CORRELATIONS, fit_noise
from hil.diagnosis.noise.repeats import pure_error
from hil.diagnosis.result import NoiseParts
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting, start_noise
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.table import TableBasis
from hil.records.rows import Records

FREE = Noise()
"""A table with a value of its own at every target and direction, white noise."""
LOADS = np.tile(150_000.0 * np.arange(1, 21), 2)
DEFLECTIONS = np.array(
    [
        0.11019, 0.21956, 0.32949, 0.43899, 0.54803, 0.65694, 0.76562, 0.87487, 0.98292, 1.09146,
        1.20001, 1.30822, 1.41599, 1.52399, 1.63194, 1.73947, 1.84646, 1.95392, 2.06128, 2.16844,
        0.11052, 0.22018, 0.32939, 0.43886, 0.54798, 0.65739, 0.76596, 0.87474, 0.98300, 1.09150,
        1.20004, 1.30818, 1.41613, 1.52408, 1.63159, 1.73965, 1.84696, 1.95445, 2.06177, 2.16829,
    ]
)  # fmt: skip
"""Load cell of NIST's statistical reference data (Pontius), 20 loads in lb applied twice (Engineering Statistics Handbook 4.6.1)."""


SLOPE = 7.3e-7


def white_um(linear: LinearCampaign, noise: Noise, y: np.ndarray, columns: int = 0) -> float:
    """Standard deviation of the white noise beside the table and the first powers of the position."""
    z = np.vander(np.asarray(linear.campaign.x) / 1e6, 3)[:, :columns]
    return math.sqrt(linear.projection(noise, y).solve(z).variance)


def load_cell() -> CampaignRows:
    """Loads as positions, deflections as errors; a straight line taken off, which every model here holds."""
    error_um = DEFLECTIONS - SLOPE * LOADS
    columns = {"run": np.repeat([1.0, 2.0], 20), "direction": np.ones(40), "target_mm": LOADS}
    return prepare(Records.of(columns | {"measured_mm": LOADS + error_um / 1000.0}))


def test_what_models_of_the_certified_load_cell_leave_against_its_pure_error() -> None:
    cell = load_cell()
    assert cell.repeated
    y = cell.error_um
    free = LinearCampaign(cell)
    pure = white_um(free, FREE, y)
    assert pure == pytest.approx(math.sqrt(np.mean((y[:20] - y[20:]) ** 2) / 2), rel=1e-5)
    line = LinearCampaign(
        CampaignRows(**{**vars(cell), "basis": TableBasis(np.array([LOADS[0], LOADS[-1]]), both_directions=False)})
    )
    straight = line.projection(FREE, y)
    curved = straight.solve((cell.x[:, None] / 1e6) ** 2)
    left_by_line = float(straight.rss)
    left_by_curve = curved.variance * 37

    def lack_of_fit(rss: float, parameters: int) -> float:
        return (rss - 20 * pure**2) / (20 - parameters) / pure**2

    assert math.sqrt(left_by_line / 38) == pytest.approx(2.171e-3, rel=5e-4)
    assert lack_of_fit(left_by_line, 2) == pytest.approx(214.7, rel=5e-4)
    assert math.sqrt(left_by_curve / 37) == pytest.approx(0.205177424076185e-3, rel=1e-4)  # certified
    assert lack_of_fit(left_by_curve, 3) == pytest.approx(0.8107, rel=1e-3)
    assert math.sqrt(left_by_curve / 37) / pure == pytest.approx(0.956, abs=1e-3)
    assert curved.coefficients[0] == pytest.approx(-0.316081871345029e-2, rel=1e-4)  # certified, per (10⁶ lb)²
    assert math.sqrt(curved.covariance[0, 0]) == pytest.approx(0.486652849992036e-4, rel=1e-4)  # certified


def test_the_evidence_takes_the_curve_of_the_load_cell_and_nothing_beyond_it() -> None:
    cell = load_cell()
    line = LinearCampaign(
        CampaignRows(**{**vars(cell), "basis": TableBasis(np.array([LOADS[0], LOADS[-1]]), both_directions=False)})
    )
    u = (cell.x[:, None] - 1.6e6) / 1.4e6
    square = u**2
    assert line.projection(FREE, cell.error_um).gain(square) > 50.0
    beside = line.projection(FREE, cell.error_um, Extra(square, square[:, :0]))
    for power in (3, 4, 5):
        assert beside.gain(u**power) < 0.0


@pytest.mark.parametrize("scatter", [0.0, 0.4])
def test_the_floor_of_scattered_targets_is_that_of_repeated_ones(scatter: float) -> None:
    """Pooled over the cells where targets repeat; where they do not, what a smooth table leaves comes to the same."""
    prepared = prepare(campaign(wavy, noise_um=0.3, runs=8, scatter=scatter, seed=4))
    linear = LinearCampaign(prepared)
    y = prepared.error_um
    noise = fit_noise(linear, y, Extra.none(len(y)), start_noise(prepared), correlations=((0.0, 0.0),))
    floor = white_um(linear, noise, y)
    assert floor == pytest.approx(0.3, rel=0.1)
    if scatter == 0.0:
        cells = y.reshape(8, 24)
        pooled = math.sqrt(float(np.mean(np.var(cells, axis=0, ddof=1))))
        assert white_um(linear, FREE, y) == pytest.approx(pooled, rel=1e-6)


def test_rows_far_out_do_not_raise_the_floor() -> None:
    """3 % of the rows 20 standard deviations off: most of what they add to the floor is gone when they are tamed."""
    rng = np.random.default_rng(6)
    noise_um = 0.3 * rng.normal(size=192)
    noise_um[rng.choice(192, 6, replace=False)] += 6.0 * rng.choice([-1.0, 1.0], 6)
    prepared = prepare(campaign(wavy, noise_um=noise_um, runs=8))
    setting = Setting.free(prepared)
    searcher = Searcher(setting, enumerate_candidates(prepared, ()))
    smooth = searcher.fit_noise((), start_noise(prepared))
    searcher.limit_outliers((), smooth)
    raised, tamed = (white_um(setting.linear, smooth, y) for y in (setting.error_um, searcher.y))
    assert raised > 3 * 0.3
    assert 0.9 * 0.3 < tamed < 0.3 + 0.3 * (raised - 0.3)


def test_heavy_tails_keep_the_standard_deviation_they_have() -> None:
    """Student's t of four degrees of freedom, scaled to 0.3: only the far end of its tails is pulled in."""
    floors = []
    for seed in range(8):
        noise_um = 0.3 * np.random.default_rng(seed).standard_t(4, 192) / math.sqrt(2.0)
        prepared = prepare(campaign(wavy, noise_um=noise_um, runs=8, scatter=0.0))
        setting = Setting.free(prepared)
        searcher = Searcher(setting, enumerate_candidates(prepared, ()))
        searcher.limit_outliers((), FREE)
        floors.append(white_um(setting.linear, FREE, searcher.y))
    assert np.mean(floors) == pytest.approx(0.3, rel=0.12)


def test_noise_that_lasts_is_told_from_noise_that_does_not() -> None:
    """AR(1) beside white noise: the floor is the root of the sum of both variances, and no correlation is seen where there is none."""
    white, lasting = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        steady = np.zeros(240)
        state = rng.normal(size=10)
        for i in range(240):
            pass_, row = divmod(i, 24)
            state[pass_] = 0.5 * state[pass_] + math.sqrt(0.75) * rng.normal() if row else rng.normal()
            steady[i] = state[pass_]
        for noise_um, found in (
            (0.3 * rng.normal(size=240), white),
            (0.2 * rng.normal(size=240) + 0.3 * steady, lasting),
        ):
            prepared = prepare(campaign(noise_um=noise_um, runs=5, targets=24, scatter=0.0))
            linear = LinearCampaign(prepared)
            y = prepared.error_um
            noise = fit_noise(linear, y, Extra.none(240), FREE, correlations=CORRELATIONS)
            found.append((noise.ar, white_um(linear, noise, y) * math.hypot(1.0, noise.ar)))
    assert np.median([ar for ar, _ in white]) == 0.0
    assert np.mean([floor for _, floor in white]) == pytest.approx(0.3, rel=0.1)
    assert np.median([ar for ar, _ in lasting]) > 0.5
    assert np.mean([floor for _, floor in lasting]) == pytest.approx(math.hypot(0.2, 0.3), rel=0.15)


def repeats(cause_um: float, seed: int = 3) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """40 targets, each approached twice within 3 s, and a cause that jumps from target to target."""
    rng = np.random.default_rng(seed)
    n = 80
    target = np.repeat(rng.uniform(0.0, 300.0, 40), 2)
    columns = {
        "run": np.repeat([1.0, 2.0], 40),
        "direction": np.where(np.arange(n) % 4 < 2, 1.0, -1.0),
        "target_mm": target,
        "time_s": np.cumsum(np.tile([60.0, 3.0], 40)),
        "load_kg": np.repeat(rng.choice([0.0, 50.0], 40), 2),
    }
    error_um = cause_um * np.repeat(rng.normal(size=40), 2) + 0.4 * rng.normal(size=n)
    return columns, error_um


@pytest.mark.parametrize("cause_um", [0.0, 5.0])
def test_the_pure_error_is_that_of_repeats_whatever_the_cause(cause_um: float) -> None:
    columns, error_um = repeats(cause_um)
    floor = pure_error(columns, error_um)
    assert floor is not None
    assert (floor.dof, floor.how) == (40, "repeats within seconds")
    by_hand = math.sqrt(float(np.mean((error_um[::2] - error_um[1::2]) ** 2)) / 2)
    assert floor.std_um.value == pytest.approx(by_hand)
    assert abs(floor.std_um.value - 0.4) < 3 * floor.std_um.std
    assert floor.std_um.std == pytest.approx(floor.std_um.value / math.sqrt(80))


def test_rows_of_other_conditions_or_later_are_no_repeats() -> None:
    columns, error_um = repeats(5.0)
    second = np.arange(80) % 2 == 1
    for name, change in (("load_kg", 20.0), ("time_s", 100.0), ("target_mm", 0.01), ("direction", 0.0)):
        moved = {**columns, name: np.where(second, columns[name] + change, columns[name])}
        if name == "direction":
            moved["direction"] = np.where(second, -columns["direction"], columns["direction"])
        if name == "time_s":
            moved["time_s"] = np.cumsum(np.tile([60.0, 100.0], 40))
        assert pure_error(moved, error_um) is None, name
    each = {**columns, "run": np.arange(1.0, 81.0)}  # the same target at once, but at the begin of another run
    assert pure_error(each, error_um) is None


def test_runs_that_repeat_one_another_count_in_pairs() -> None:
    """The certified load cell: 20 loads twice, about the difference of the two runs."""
    columns = {
        "run": np.repeat([1.0, 2.0], 20),
        "direction": np.ones(40),
        "target_mm": LOADS,
        "row_order": np.arange(40.0),
    }
    floor = pure_error(columns, DEFLECTIONS)
    assert floor is not None
    assert (floor.dof, floor.how) == (19, "runs in pairs")
    assert floor.std_um.value == pytest.approx(np.std(DEFLECTIONS[20:] - DEFLECTIONS[:20], ddof=1) / math.sqrt(2))


def test_more_than_noise_memory_and_offsets_explain_is_never_silent() -> None:
    columns, error_um = repeats(0.0)
    floor = pure_error(columns, error_um)
    parts = NoiseParts(0.4, 0.2, 2.0, 0.1)
    explained = predicted_um(None, parts, 300, 20.0)
    assert explained == pytest.approx(math.hypot(0.4, 0.2, 0.1) * math.sqrt(1.0 + 40.0 / 280.0)), (
        "a table predicts no better"
    )
    assert list(beyond_noise(floor, parts, 1.1 * explained, explained, 300)) == []
    (said,) = beyond_noise(floor, parts, 1.9 * explained, explained, 300)
    assert "left out" in said
    (said,) = beyond_noise(floor, NoiseParts(0.8, 0.0, 0.0, 0.0), 0.5, explained, 300)
    assert "repeats differ" in said
    (said,) = beyond_noise(None, parts, 1.9 * explained, explained, 300)
    assert "left out" in said


@pytest.mark.outside
def test_a_diagnosis_states_the_floor_with_its_degrees_of_freedom_and_none_without_repeats() -> None:
    records, noise_um = workshop(21, wave_by_load, ratio=2.0)
    said = diagnose(records).to_json()
    assert said["noise_floor_dof"] > 20
    assert said["noise_floor_um"] == pytest.approx(np.std(noise_um), rel=0.3)  # the cause is not in it
    assert set(said["noise"]) == {"white_um", "memory_um", "memory_rows", "run_offset_um", "within_run_um"}
    scattered = diagnose(campaign(wavy, noise_um=0.3, runs=4, scatter=0.4, seed=4)).to_json()
    assert scattered["noise_floor_um"] is None
    assert scattered["noise_floor_dof"] == 0
    assert scattered["noise"]["within_run_um"] == pytest.approx(0.3, rel=0.2)


def wave_by_load(c: dict[str, np.ndarray]) -> np.ndarray:
    return np.sin(2 * np.pi * 2.2 * c["target_mm"] / 400.0) * (c["load_kg"] > 50.0)
