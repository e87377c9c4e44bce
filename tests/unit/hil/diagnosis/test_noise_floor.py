"""The noise floor is pure error where targets repeat, and what a model leaves is judged against it, on data certified by NIST."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.campaigns import campaign, wavy
from support.workshop import workshop

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.model.evidence import Fit, Noise, Part
from hil.diagnosis.model.rows import NO_MEMORY, ModelRows
from hil.diagnosis.repeats import pure_error
from hil.diagnosis.table import TableBasis
from hil.records.rows import Records

FREE = Noise(NO_MEMORY, np.array([12.0, 12.0, -12.0]))
"""A table with a value of its own at every target and direction, white noise, no offsets of runs."""
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


def load_cell() -> CampaignRows:
    """Loads as positions, deflections as errors; a straight line taken off, which every model here holds."""
    error_um = DEFLECTIONS - SLOPE * LOADS
    columns = {"run": np.repeat([1.0, 2.0], 20), "direction": np.ones(40), "target_mm": LOADS}
    return prepare(Records.of(columns | {"measured_mm": LOADS + error_um / 1000.0}))


def straight() -> ModelRows:
    """The same with a line for a table."""
    basis = TableBasis(np.array([LOADS[0], LOADS[-1]]), both_directions=False)
    return ModelRows(CampaignRows(**{**vars(load_cell()), "basis": basis}))


def of_powers(u: np.ndarray, *powers: int) -> Part:
    columns = u[:, None] ** np.array(powers)
    return Part("power", (), columns, columns[:, :0], columns[:, :0])


def test_what_models_of_the_certified_load_cell_leave_against_its_pure_error() -> None:
    cell = load_cell()
    assert cell.repeated
    y = cell.error_um
    pure = Fit(ModelRows(cell), (), FREE).sigma
    assert Fit(ModelRows(cell), (), FREE).spent == pytest.approx(20.0, abs=1e-3)
    pure *= math.sqrt(38 / 20)  # a random part spends no degrees of freedom of the noise
    assert pure == pytest.approx(math.sqrt(np.mean((y[:20] - y[20:]) ** 2) / 2), rel=1e-5)
    curve = of_powers(cell.x / 1e6, 2)
    line, curved = Fit(straight(), (), FREE), Fit(straight(), (curve,), FREE)

    def lack_of_fit(fit: Fit, parameters: int) -> float:
        return (fit.rss - 20 * pure**2) / (20 - parameters) / pure**2

    assert line.sigma == pytest.approx(2.171e-3, rel=5e-4)
    assert lack_of_fit(line, 2) == pytest.approx(214.7, rel=5e-4)
    assert curved.sigma == pytest.approx(0.205177424076185e-3, rel=1e-4)  # certified
    assert lack_of_fit(curved, 3) == pytest.approx(0.8107, rel=1e-3)
    at = curved.where(curve, "free")
    assert curved.beta[at][0] == pytest.approx(-0.316081871345029e-2, rel=1e-4)  # certified, per (10⁶ lb)²
    assert math.sqrt(curved.covariance[at, at][0, 0]) == pytest.approx(0.486652849992036e-4, rel=1e-4)  # certified


def test_the_evidence_takes_the_curve_of_the_load_cell_and_nothing_beyond_it() -> None:
    u = (load_cell().x - 1.6e6) / 1.4e6
    square = of_powers(u, 2)
    assert Fit(straight(), (), FREE).gain(square.free) > 50.0
    beside = Fit(straight(), (square,), FREE)
    for power in (3, 4, 5):
        assert beside.gain(of_powers(u, power).free) < 0.0


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
