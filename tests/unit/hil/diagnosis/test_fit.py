"""Table and terms fitted together: what an instrument's effect leaves in the machine's table, declared terms as a prior."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis import diagnose, fit_model
from hil.diagnosis.campaign import prepare
from hil.effects import Action, Form, Term
from hil.effects.model import Model, PitchTable
from hil.effects.velocity_lag import VelocityLag

Array = np.ndarray


def speeds(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    return {"velocity_mm_s": rng.choice([10.0, 30.0, 90.0], len(c["run"]))}


def test_a_fitted_model_predicts_a_fresh_campaign_to_its_noise() -> None:
    model = fit_model(campaign(wavy, runs=5))
    fresh = campaign(wavy, seed=2)
    left = fresh.uncorrected_error_um - model.error_um(fresh.columns)
    assert np.sqrt(np.mean(left**2)) < 1.15 * 0.3
    assert model.declared == ["pitch_table"]


def test_terms_that_follow_each_other_are_estimated_together() -> None:
    records = campaign(
        lambda c: wavy(c) + 0.02 * c["direction"] * c["velocity_mm_s"] + np.where(c["time_s"] > 400.0, 1.5, 0.0),
        sensors=speeds,
    )
    found = {finding.effect: finding.term for finding in diagnose(records).findings}
    assert set(found) == {"velocity_lag", "datum_step"}
    for name, true in (("velocity_lag", 0.02), ("datum_step", 1.5)):
        estimate = found[name].coefficient(0)
        assert abs(estimate.value - true) < 3.0 * estimate.std < true


@pytest.mark.parametrize("declared", [False, True])
def test_what_an_instrument_does_is_found_and_left_out_of_the_correction(declared: bool) -> None:
    """The model for the machine holds the machine's errors and the mean of a jump, nothing of what a table would take from it."""
    records = campaign(lambda c: wavy(c) + np.where(c["time_s"] > 300.0, 2.0, 0.0))
    before = fit_model(campaign(wavy, runs=5, seed=3)) if declared else None
    found = diagnose(records, before)
    (finding,) = found.findings
    assert finding.effect == "datum_step"
    assert finding.action is not Action.COMPENSATE
    assert found.extended.terms == ()
    columns = prepare(records).columns
    machine = found.extended.error_um(columns)
    jumped = np.where(columns["time_s"] > 300.0, 2.0, 0.0)
    assert np.mean(machine) == pytest.approx(np.mean(wavy(columns) + jumped), abs=0.15)
    assert np.std(machine - wavy(columns)) < 0.2
    assert np.std(found.residual_um) < 0.35


@pytest.mark.parametrize(("std", "follows"), [(1e-5, False), (1.0, True)])
def test_a_declared_term_moves_as_far_as_its_uncertainty_allows(std: float, follows: bool) -> None:
    records = campaign(lambda c: wavy(c) + 0.03 * c["direction"] * c["velocity_mm_s"], sensors=speeds)
    form: Form = VelocityLag().forms(prepare(records).survey)[0]
    table = fit_model(campaign(wavy, runs=5, seed=3)).table
    declared = Model(table, (Term(VelocityLag(), form, (), (0.02,), ((std**2,),)),))
    found = diagnose(records, declared)
    moved = [term.coefficients[0] for term in found.extended.terms if term.effect.id == "velocity_lag"]
    assert moved[0] == pytest.approx(0.03 if follows else 0.02, abs=0.003)
    assert sum(moved) == pytest.approx(0.03, abs=0.003), "what it may not follow is found beside it"


def test_a_model_without_a_covariance_may_follow_the_rows() -> None:
    flat = Model(PitchTable.of([0.0, 150.0, 300.0], [0.0] * 3, [0.0] * 3))
    assert diagnose(campaign(noise_um=0.3), flat).findings == ()


@pytest.mark.parametrize("gap_um", [0.5, 3.0])
def test_a_constant_gap_that_the_table_lacks_is_no_shape_along_the_travel(gap_um: float) -> None:
    declared = fit_model(campaign(wavy, runs=5, seed=3))
    found = diagnose(campaign(lambda c: wavy(c) + gap_um * c["direction"], runs=10, seed=9), declared)
    assert [(one.effect, one.confidence > 0.9) for one in found.findings] == [("backlash", True)]


def test_a_table_of_the_same_rows_changes_no_name() -> None:
    """It has absorbed the growth at the mean temperature of these rows, smooth as it came out."""

    def warms(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
        return {"temp_screw_c": 20.0 + 4.0 * (1.0 - np.exp(-c["time_s"] / 300.0))} | speeds(c, rng)

    records = campaign(
        lambda c: (
            wavy(c) + 0.02 * c["direction"] * c["velocity_mm_s"] + 11e-3 * c["target_mm"] * (c["temp_screw_c"] - 20.0)
        ),
        sensors=warms,
        runs=4,
    )
    names = [{one.effect for one in diagnose(records, declared).findings} for declared in (None, fit_model(records))]
    assert names[0] == names[1] == {"velocity_lag", "thermal_expansion"}
