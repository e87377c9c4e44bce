"""What the diagnosis says of machines made by hand: names, what is unexplained, silence, and figures of the model in the file."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from support.campaigns import Array, Errors, campaign, wavy

from hil.diagnosis import diagnose, fit_model
from hil.diagnosis.campaign import columns_of, prepare
from hil.diagnosis.follow_up import diagnosed
from hil.diagnosis.result import OUTSIDE, Diagnosis
from hil.effects import Action
from hil.effects.model import Model, PitchTable
from hil.records.rows import Records


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """A screw that warms and breathes, a load for each run."""
    t, run = c["time_s"], c["run"].astype(int) - 1
    warm = 20.0 + 3.0 * (1.0 - np.exp(-t / 200.0)) + 0.2 * np.sin(t / 90.0) + 0.02 * rng.normal(size=len(t))
    return {"temp_screw_c": warm, "load_kg": rng.choice([0.0, 50.0, 100.0], 6)[run]}


def x(c: dict[str, Array]) -> Array:
    return c["target_mm"]


def switched(c: dict[str, Array], every_s: float) -> Array:
    return np.where((c["time_s"] // every_s) % 2 == 0, 1.0, -1.0)


def tenth(c: dict[str, Array]) -> Array:
    return (np.arange(len(x(c))) % 10 == 4).astype(float)


CASES: dict[str, Errors] = {
    "nothing": lambda c: 0.0 * x(c),
    "cycle": lambda c: np.sin(2.0 * np.pi * x(c) / 10.0),
    "harmonics": lambda c: np.sin(np.pi * x(c) / 10.0) + 0.7 * np.sin(0.6 * np.pi * x(c) / 2.0 + 2.0),
    "expansion": lambda c: 0.011 * x(c) * (c["temp_screw_c"] - 20.0),
    "load": lambda c: 0.02 * c["load_kg"] * c["direction"],
    "jump": lambda c: 1.5 * (c["time_s"] > 300.0),
    "load zone": lambda c: 0.02 * c["load_kg"] * np.exp(-0.5 * ((x(c) - 150.0) / 20.0) ** 2),
    "play by temperature": lambda c: 0.4 * c["direction"] * (c["temp_screw_c"] - 20.0),
    "state along": lambda c: switched(c, 170.0) * np.sin(x(c) / 40.0),
    "one run": lambda c: 1.5 * (c["run"] == 3) * np.sin(x(c) / 30.0),
    "tenth row": lambda c: 4.0 * tenth(c) * np.sin(x(c) / 60.0),
    "product": lambda c: 0.03 * c["load_kg"] * (x(c) / 150.0 - 1.0) ** 2,
    "relay": lambda c: 2.0 * (c["temp_screw_c"] > 21.8),
}


@functools.cache
def said(case: str, seed: int = 5, without: str = "") -> Diagnosis:
    records = campaign(lambda c: wavy(c) + CASES[case](c), sensors=sensors, seed=seed)
    if without:
        records = type(records).of({name: v for name, v in records.columns.items() if name != without})
    return diagnose(records)


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_noise_is_met_with_silence(seed: int) -> None:
    found = said("nothing", seed)
    assert not found.findings
    assert not found.unexplained
    assert found.noise.within_run_um == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rows_far_off_that_follow_nothing_are_noise(seed: int) -> None:
    """One row in ten with five times the spread."""
    rng = np.random.default_rng(seed)
    noise_um = 0.3 * rng.normal(size=144) * np.where(rng.random(144) < 0.1, 5.0, 1.0)
    found = diagnose(campaign(wavy, noise_um=noise_um, sensors=sensors, seed=seed))
    assert not found.findings
    assert not found.unexplained


@pytest.mark.parametrize(
    ("case", "effect", "parameter", "true"),
    [
        ("cycle", "cyclic", "period_mm", 10.0),
        ("expansion", "thermal_expansion", "coefficient_ppm_per_k", 11.0),
        ("load", "load_deflection", "compliance_with_direction_um_per_kg", 0.02),
        ("jump", "datum_step", "step_um", 1.5),
        ("load zone", "load_deflection", "compliance_um_per_kg", 0.02),
        ("play by temperature", "backlash", "backlash_um_per_k", 0.8),
    ],
)
def test_a_cause_of_the_catalogue_is_named_with_its_parameter(
    case: str, effect: str, parameter: str, true: float
) -> None:
    found = said(case, seed=6)
    assert [finding.effect for finding in found.findings] == [effect]
    assert not found.unexplained
    estimate = found.findings[0].parameters[parameter]
    assert estimate.interval[0] <= true <= estimate.interval[1]


@pytest.mark.parametrize(
    ("case", "columns"),
    [
        ("product", {"load_kg", "target_mm"}),
        ("state along", {"target_mm", "time_s"}),
        ("one run", {"run", "target_mm"}),
        ("tenth row", {"row_order", "target_mm"}),
    ],
)
def test_a_cause_outside_the_catalogue_is_left_with_its_columns(case: str, columns: set[str]) -> None:
    found = said(case)
    assert found.unexplained
    assert columns <= set(found.carriers[0].columns)
    assert not [finding for finding in found.findings if finding.confidence > 0.5]


@pytest.mark.parametrize("case", CASES)
def test_the_figures_are_those_of_the_model_in_the_file(case: str) -> None:
    """Each run predicted by the same terms and a table of the others: nothing corrected leaves what the table alone leaves."""
    found = said(case)
    compensated = [finding for finding in found.findings if finding.action is Action.COMPENSATE]
    if not found.extended.terms and not found.findings and not found.unexplained:
        assert np.array_equal(found.after_um, found.before_um)
    if found.extended.terms:
        assert compensated or any("suspected" in note for note in found.notes)
        assert found.after.rms_um < found.before.rms_um
    assert found.recommended == (found.after.rms_um < np.sqrt(np.mean(_uncorrected(case) ** 2)))


def _uncorrected(case: str) -> Array:
    return campaign(lambda c: wavy(c) + CASES[case](c), sensors=sensors, seed=5).uncorrected_error_um


def test_a_recorded_column_that_passed_a_level_at_the_jump_is_a_rival() -> None:
    found = said("relay")
    assert found.findings[0].effect == "datum_step"
    relay = next(rival for rival in found.findings[0].rivals if rival.effect == OUTSIDE)
    assert relay.separate_by.endswith("comes again: temp_screw_c")
    assert found.findings[0].confidence < 0.9


@pytest.mark.parametrize(
    ("case", "reason"),
    [("product", ""), ("one run", "run is not known when a command is issued"), ("nothing", "nothing is left")],
)
def test_what_is_left_is_corrected_on_request_where_runs_left_out_are_better(case: str, reason: str) -> None:
    found = said(case)
    assert not [term for term in found.extended.terms if term.effect.id == "non_parametric"]
    if reason:
        assert isinstance(found.non_parametric, str)
        assert reason in found.non_parametric
        return
    assert isinstance(found.non_parametric, Diagnosis)
    assert [term.effect.id for term in found.non_parametric.extended.terms] == ["non_parametric"]
    assert found.non_parametric.after.rms_um < found.after.rms_um


@pytest.mark.parametrize("case", ["load", "expansion"])
def test_without_its_sensor_a_cause_has_no_sure_wrong_name(case: str) -> None:
    column, effect = {"load": ("load_kg", "load_deflection"), "expansion": ("temp_screw_c", "thermal_expansion")}[case]
    found = said(case, without=column)
    assert not [f for f in found.findings if f.confidence > 0.9 and f.effect != effect]


def test_harmonics_of_one_part_are_told_of_one_part() -> None:
    (finding,) = said("harmonics").findings
    assert finding.effect == "cyclic"
    assert finding.explanation.count("a part that turns") == 1


@pytest.mark.parametrize(
    ("effect", "came"),
    [
        ("local_wear", lambda c: 2.0 * np.exp(-0.5 * ((x(c) - 200.0) / 25.0) ** 2)),
        ("backlash_position", lambda c: c["direction"] * (1.0 + 1.5 * (x(c) / 150.0 - 1.0))),
        ("backlash", lambda c: 1.0 * c["direction"]),
        ("thermal_expansion", lambda c: 0.011 * x(c) * (c["temp_screw_c"] - 20.0)),
    ],
)
def test_beside_a_table_measured_before_what_came_since_is_named_and_corrected(effect: str, came: Errors) -> None:
    before = campaign(wavy, seed=8)
    now, later = (campaign(lambda c: wavy(c) + came(c), sensors=sensors, seed=seed) for seed in (9, 10))
    found = diagnose(now, fit_model(before))
    assert [finding.effect for finding in found.findings] == [effect]
    assert found.after.rms_um < 0.7 * found.before.rms_um
    read = Model.from_json(found.extended.to_json())
    left_um = later.uncorrected_error_um + read.correction_um(columns_of(later))
    assert np.std(left_um) < 1.4 * 0.3


@pytest.mark.parametrize("period_mm", [2.0, 3.1, 5.0])
def test_a_part_with_harmonics_beside_drift_of_each_run_is_one_part_and_nothing_else(period_mm: float) -> None:
    """Three runs that begin elsewhere and go on, with a reading that wanders and starts anew in each."""
    rng = np.random.default_rng(4)
    run = np.repeat([1.0, 2.0, 3.0], 130)
    target = np.concatenate([begin + 0.131 * np.arange(130) for begin in (-20.0, -9.0, 3.0)])
    turn = 2.0 * np.pi * target / period_mm
    drift = np.concatenate([20.0 * rng.normal() + np.cumsum(0.25 * rng.normal(size=130)) for _ in range(3)])
    error_um = 2.4 * np.sin(turn) + 0.8 * np.sin(2.0 * turn + 1.0) + drift + 0.4 * rng.normal(size=390)
    columns = {"run": run, "direction": np.ones(390), "target_mm": target, "time_s": 8.0 * np.arange(390)}
    found = diagnose(Records.of(columns | {"measured_mm": target + error_um / 1000.0}))
    (finding,) = [one for one in found.findings if one.effect != "beam_drift"]  # that is what the drift is
    assert finding.effect == "cyclic"
    assert finding.confidence > 0.9
    assert min(one.theta[0] for one in finding.terms) <= period_mm * 1.01
    assert finding.explanation.count("a part that turns") == 1


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_lag_is_no_backlash_of_a_temperature_that_differs_between_the_feeds_by_a_digit(seed: int) -> None:
    """Beside a table of their own, which holds any difference of the directions, four passes say as much for the one as for the other.
    The declared table has no such difference: the lag alone is without it. As a backlash it was 13 mm/K, corrected."""
    rng = np.random.default_rng(seed)
    passes = ((30.0, 1, 21.18), (30.0, -1, 21.19), (110.0, 1, 21.19), (110.0, -1, 21.20))
    feed, way, warm = (np.repeat(values, 6) for values in np.array(passes).T)
    along = 11.5 * np.tile(np.arange(6.0), 4)
    target = np.repeat([136.0, 175.0, 121.0, 158.0], 6) + way * along
    columns = {
        "run": np.ones(24),
        "direction": way,
        "target_mm": target,
        "measured_mm": target - (1.66 * way * feed - rng.normal(0.0, 0.4, 24)) / 1000.0,
        "time_s": np.repeat([0.0, 6.0, 12.0, 18.0], 6) + along / feed,
        "velocity_mm_s": feed,
        "since_reversal_mm": 25.0 + along,
        "stroke_mm": np.repeat([106.0, 84.0, 114.0, 112.0], 6),
        "temp_screw_c": warm,
    }
    nothing = PitchTable.of(np.linspace(0.0, 300.0, 31), np.zeros(31), np.zeros(31))
    found = diagnose(Records.of(columns), Model(nothing, ()))
    assert [finding.effect for finding in found.findings] == ["velocity_lag"]
    assert [term.effect.id for term in found.extended.terms] == ["velocity_lag"]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_declared_table_that_was_measured_with_some_of_an_effect_is_set_right(seed: int) -> None:
    """It holds the mean deflection of its own campaign. Nothing else is named for it, and a third campaign is corrected."""

    def loaded(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
        return {"load_kg": rng.permutation([0.0, 50.0, 100.0, 0.0, 50.0, 100.0])[c["run"].astype(int) - 1]}

    first, second, third = (
        campaign(lambda c: wavy(c) + 1e-4 * c["load_kg"] * x(c), sensors=loaded, seed=seed + more)
        for more in (0, 50, 90)
    )
    found = diagnose(second, fit_model(first))
    assert [finding.effect for finding in found.findings] == ["load_deflection"]
    left_um = prepare(third).error_um - found.extended.error_um(columns_of(third))
    assert np.sqrt(np.mean(left_um**2)) < 0.36


def test_the_size_of_two_cycles_of_near_periods_is_as_sure_as_their_sum() -> None:
    """The amplitude of each may be many times as uncertain: 144 rows of 0.3 µm determine the sum within 0.025 µm."""

    def both(c: dict[str, Array]) -> Array:
        return wavy(c) + 2.0 * np.sin(2.0 * np.pi * x(c) / 10.0) + 2.0 * np.sin(2.0 * np.pi * x(c) / 10.3 + 1.0)

    (finding,) = diagnose(campaign(both, seed=2)).findings
    assert len(finding.terms) == 2
    assert 0.0125 < finding.rms_std_um < 0.05


@pytest.mark.parametrize("period_mm", [100.0, 120.0])
def test_rivals_are_not_weighed_by_rows_that_show_nothing_of_the_effect(period_mm: float) -> None:
    """Beside the declared table a long cycle is sure; a table of these rows' own would hold it, and every rival would weigh more."""
    nothing = Model(PitchTable.of(np.linspace(0.0, 300.0, 13), np.zeros(13), np.zeros(13)), ())
    records = campaign(lambda c: 2.0 * np.sin(2.0 * np.pi * x(c) / period_mm + 1.0), scatter=0.2)
    (finding,) = diagnosed(records, nothing).diagnosis.findings
    assert finding.effect == "cyclic"
    assert finding.confidence > 0.99
