"""Runs left out: nothing of them reaches the choice that predicts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.campaigns import campaign, wavy
from support.workshop import Floats, workshop

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.search.choose import Chosen, choose, choose_without, problem_of
from hil.diagnosis.verdict.held_out import HeldOut, folds, improves_held_out
from hil.effects import Effect
from hil.effects.load_deflection import LoadDeflection
from hil.effects.velocity_lag import VelocityLag

Array = np.ndarray
EFFECTS: tuple[Effect, ...] = (VelocityLag(), LoadDeflection())
LEFT_OUT = 2


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {
        "velocity_mm_s": rng.choice([10.0, 30.0, 90.0], n),
        "load_kg": np.where(c["run"] == LEFT_OUT + 1, rng.choice([0.0, 50.0, 100.0], n), 0.0) + rng.normal(size=n),
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


def machine(c: dict[str, Array]) -> Array:
    """It lags, and bends under a load, which one run alone has any to speak of."""
    return wavy(c) + 0.02 * c["direction"] * c["velocity_mm_s"] + 0.03 * c["load_kg"]


CAMPAIGN = prepare(campaign(machine, runs=5, targets=10, sensors=sensors))
OUT = CAMPAIGN.run == LEFT_OUT


@pytest.fixture(scope="module")
def whole() -> Chosen:
    return choose(problem_of(CAMPAIGN, EFFECTS, None, 0))


def without(prepared: CampaignRows, whole: Chosen) -> Chosen:
    return choose_without(problem_of(prepared, EFFECTS, None, 0), OUT, whole)


def test_an_effect_that_one_run_alone_shows_is_not_chosen_without_that_run(whole: Chosen) -> None:
    """A choice made on all rows, or with a look at the run left out, holds the load."""
    assert {choice.effect.id for choice in whole.last.choices} == {"velocity_lag", "load_deflection"}
    chosen = without(CAMPAIGN, whole)
    assert {choice.effect.id for choice in chosen.last.choices} == {"velocity_lag"}


@pytest.mark.parametrize("spoilt", [1e3, -5.0, np.nan], ids=str)
def test_whatever_the_run_left_out_measured_its_prediction_is_the_same(whole: Chosen, spoilt: float) -> None:
    rng = np.random.default_rng(1)
    other = np.where(OUT, 40.0 * rng.normal(size=len(CAMPAIGN)) if np.isnan(spoilt) else spoilt, CAMPAIGN.error_um)
    first = without(CAMPAIGN, whole)
    second = without(replace(CAMPAIGN, error_um=other), whole)
    np.testing.assert_allclose(
        second.fit.extended.error_um(CAMPAIGN.columns), first.fit.extended.error_um(CAMPAIGN.columns), atol=1e-6
    )


@pytest.mark.parametrize(("runs", "how"), [(1, "quarter"), (4, "leave-one-run-out"), (13, "groups")])
def test_folds_are_whole_runs_or_parts_of_the_only_one(runs: int, how: str) -> None:
    run = np.repeat(np.arange(runs), 8)
    fold, said = folds(run)
    assert how in said
    np.testing.assert_array_equal(np.unique(fold), np.arange(np.max(fold) + 1))
    if runs > 1:
        for index in range(runs):
            assert len(set(fold[run == index])) == 1
    assert np.all(np.diff(fold) >= 0)


@given(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=4), st.floats(0.1, 100.0))
@settings(max_examples=50, deadline=None)
def test_a_gain_counts_when_it_is_above_its_standard_error_whatever_the_unit(gain: list[float], unit: float) -> None:
    values = np.array(gain)
    clear = np.mean(values) - np.std(values, ddof=1) / np.sqrt(len(values))
    if abs(clear) > 1e-9:
        assert improves_held_out(unit * values) == (clear > 0)
    assert not improves_held_out(-np.abs(values))


def test_one_fold_that_likes_it_does_not_speak_for_all() -> None:
    assert not improves_held_out(np.array([50.0, -0.1, -0.1, -0.1, -0.1]))
    assert improves_held_out(np.array([3.0, 2.0, 2.5, 2.0, 3.0]))


@pytest.mark.parametrize(
    ("gain", "helps"),
    [
        ([-0.9, 0.0, 0.6, -0.7, 173.2, -17.0, 178.1], True),  # a load that two runs had
        ([4.0, 5.0, -60.0, 6.0, 5.0, 4.5], True),  # the first run is missing
        ([1.0, -1.0, 40.0, -1.5, 0.5, -38.0], False),
        ([98.5, -501.9, -70.7, 34.6, -208.4, -277.7, 39.3, -526.8], False),
    ],
)
def test_an_effect_helps_with_all_runs_or_without_the_best_and_the_worst(gain: list[float], helps: bool) -> None:
    assert improves_held_out(np.array(gain)) is helps


def behind_the_screw(c: dict[str, Floats]) -> Floats:
    """A drift that follows the screw through a lag of 600 s, from the first row on as warm as the screw then was."""
    out, at = np.empty(len(c["time_s"])), c["temp_screw_c"][0]
    for row, step_s in enumerate(np.diff(c["time_s"], prepend=c["time_s"][0])):
        at += (c["temp_screw_c"][row] - at) * -np.expm1(-step_s / 600.0)
        out[row] = at
    return out


@pytest.mark.outside
def test_a_sensors_lag_does_not_begin_anew_in_the_rows_left_out() -> None:
    records, noise_um = workshop(12, behind_the_screw, ratio=2.0, warm_s=3000.0)
    found = diagnose(records)
    (finding,) = found.findings
    assert finding.effect == "thermal_drift"
    later = records["run"] > records["run"].min()  # nothing but the first run shows where the drift began
    left_um = float(np.sqrt(np.mean(found.after_um[later] ** 2)))
    assert left_um < 1.4 * float(np.std(noise_um)), "begun anew in each run it is 2 to 8 times the noise"


@pytest.mark.outside
@pytest.mark.parametrize("jump_um", [1.5, 3.0])
def test_where_the_file_holds_the_table_alone_after_is_what_was_before(jump_um: float) -> None:
    found = diagnose(campaign(lambda c: wavy(c) + jump_um * (c["time_s"] > 300.0), runs=4))
    assert found.findings
    assert not found.extended.terms
    assert np.array_equal(found.after_um, found.before_um)


def test_the_worst_run_left_out_is_not_what_usually_remains() -> None:
    none = np.zeros(4)
    left = HeldOut(none, none, none, np.array([1.0, 1.0, 9.0, 9.0]), {}, none, none, none, np.array([0, 0, 1, 1]), "")
    assert left.usual_um == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("how", "before", "setup", "worse"),
    [
        ("leave-one-run-out", [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.3], False),
        ("leave-one-run-out", [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 3.0], True),
        ("leave-one-run-out", [1.0, 1.0, 1.0, 2000.0], [1.2, 1.2, 1.2, 1990.0], True),  # a row far off decides nothing
        ("leave-one-quarter-out", [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 3.0], False),  # no run was left out
    ],
)
def test_runs_left_out_that_are_worse_by_a_tenth(
    how: str, before: list[float], setup: list[float], worse: bool
) -> None:
    none, fold = np.zeros(4), np.arange(4)
    left = HeldOut(np.array(before), none, none, np.array(setup), {}, none, none, none, fold, how)
    assert left.is_worse is worse
