"""The joint fit: table and terms together, what an instrument's effect leaves in the machine's table, declared terms as a prior."""

from __future__ import annotations

import numpy as np
import pytest
from study.grammar.machine import draw
from support.campaigns import campaign, wavy

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import prepare
from hil.diagnosis.noise.evidence import LinearCampaign, Noise
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import (
    Choice,
    Known,
    Setting,
    fit_model,
    grid_choices,
    joint_fit,
    start_noise,
    static_part,
)
from hil.diagnosis.search.searcher import Searcher, mixed_covariance
from hil.diagnosis.table import DeclaredShape
from hil.effects import Action, Form, Term
from hil.effects.air_index import AirIndex
from hil.effects.backlash import Backlash
from hil.effects.cyclic import Cyclic
from hil.effects.datum_step import DatumStep
from hil.effects.model import Model, PitchTable
from hil.effects.pitch_shape import PitchShape
from hil.effects.thermal_drift import ThermalDrift
from hil.effects.velocity_lag import VelocityLag
from hil.records.rows import Records

Array = np.ndarray
SMOOTH = Noise(even=100.0, odd=30.0)


def speeds(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    return {"velocity_mm_s": rng.choice([10.0, 30.0, 90.0], len(c["run"]))}


def test_a_fitted_model_predicts_a_fresh_campaign_to_its_noise() -> None:
    model = fit_model(campaign(wavy, runs=5))
    fresh = campaign(wavy, seed=2)
    left = fresh.uncorrected_error_um - model.error_um(fresh.columns)
    assert np.sqrt(np.mean(left**2)) < 1.15 * 0.3
    assert model.declared == ["pitch_table"]


def test_terms_that_follow_each_other_are_estimated_together() -> None:
    """Against least squares of table and both terms at once, written out."""
    records = campaign(
        lambda c: wavy(c) + 0.02 * c["direction"] * c["velocity_mm_s"] + np.where(c["time_s"] > 400.0, 1.5, 0.0),
        sensors=speeds,
    )
    prepared = prepare(records)
    setting = Setting.free(prepared)
    lag = grid_choices(VelocityLag(), VelocityLag().forms(prepared.survey)[0])[0]
    jump = next(c for c in grid_choices(DatumStep(), DatumStep().forms(prepared.survey)[0]) if c.theta[0] > 400.0)
    fit = joint_fit(setting, SMOOTH, setting.error_um, [lag, jump])
    table = setting.linear.table
    wide = np.hstack([lag.columns(prepared), jump.columns(prepared), table.stacked])
    ridge = np.concatenate([[0.0, 0.0], table.ridge(SMOOTH)])
    expected = np.linalg.solve(wide.T @ wide + np.diag(ridge), wide.T @ setting.error_um)
    got = [term.coefficients[0] for term in fit.found]
    np.testing.assert_allclose(got, expected[:2], rtol=1e-4)
    assert got == pytest.approx([0.02, 1.5], rel=0.2)


@pytest.mark.parametrize("declared", [False, True])
def test_what_an_instrument_does_is_found_and_left_out_of_the_correction(declared: bool) -> None:
    """The whole model holds it; the extended one, for the machine, holds the machine's errors and the mean of it, nothing of what a
    table would take from a jump in the middle of a run."""
    records = campaign(lambda c: wavy(c) + np.where(c["time_s"] > 300.0, 2.0, 0.0))
    prepared = prepare(records)
    setting = Setting.free(prepared)
    if declared:
        shape = DeclaredShape.of(fit_model(campaign(wavy, runs=5)).table, 0.3)
        rest_um = prepared.error_um - np.array(shape.table.error_um(prepared.x, prepared.d))
        setting = Setting(LinearCampaign(prepared, shape), rest_um, Known.none(len(prepared)))
    jump = next(c for c in grid_choices(DatumStep(), DatumStep().forms(prepared.survey)[0]) if c.theta[0] > 300.0)
    fit = joint_fit(setting, SMOOTH, setting.error_um, [jump])
    assert jump.effect.action is not Action.COMPENSATE
    assert [term.effect.id for term in fit.whole.terms] == ["datum_step"]
    assert fit.extended.terms == ()
    whole, machine = (model.error_um(prepared.columns) for model in (fit.whole, fit.extended))
    assert np.std(prepared.error_um - whole) < 0.35
    assert np.mean(machine) == pytest.approx(np.mean(whole), abs=0.05)
    before = prepared.columns["time_s"] <= 300.0
    static = np.mean(np.where(before, 0.0, 2.0))
    np.testing.assert_allclose((machine - whole)[before], static, atol=0.1)
    np.testing.assert_allclose((machine - whole)[~before], static - 2.0, atol=0.1)
    assert np.std(machine - wavy(prepared.columns)) < 0.13


@pytest.mark.parametrize(("std", "follows"), [(1e-5, False), (1.0, True)])
def test_a_declared_term_moves_as_far_as_its_uncertainty_allows(std: float, follows: bool) -> None:
    prepared = prepare(campaign(lambda c: wavy(c) + 0.03 * c["direction"] * c["velocity_mm_s"], sensors=speeds))
    form: Form = VelocityLag().forms(prepared.survey)[0]
    declared = Model(
        PitchTable.of([0.0, 300.0], [0.0, 0.0], [0.0, 0.0]), (Term(VelocityLag(), form, (), (0.02,), ((std**2,),)),)
    )
    error_um = prepared.error_um - declared.terms[0].error_um(prepared.columns)
    free = Setting.free(prepared)
    setting = Setting(free.linear, error_um, Known.of(declared, prepared, 0.3))
    moved = joint_fit(setting, SMOOTH, error_um, ()).whole.terms[0].coefficients[0]
    assert moved == pytest.approx(0.03 if follows else 0.02, abs=0.003)


def test_grid_steps_are_the_distance_to_the_nearest_neighbour() -> None:
    prepared = prepare(campaign())
    form = Cyclic().forms(prepared.survey)[0]
    choices = grid_choices(Cyclic(), form)
    logs = np.log([choice.theta[0] for choice in choices])
    for i in (0, 1, len(choices) // 2, len(choices) - 1):
        gaps = np.abs(np.delete(logs, i) - logs[i])
        assert choices[i].steps[0] == pytest.approx(np.min(gaps))


def test_a_prior_on_a_choice_is_that_of_its_parameters() -> None:
    """None where nothing is known beforehand."""
    prepared = prepare(campaign())
    assert all(c.log_prior == 0.0 for c in grid_choices(Cyclic(), Cyclic().forms(prepared.survey)[0])[:3])
    assert AirIndex().forms(prepared.survey) == ()
    form = Form("cyclic", "fundamental", ("target_mm",))
    assert Choice(Cyclic(), form, ()).log_prior == 0.0


def test_a_table_has_absorbed_a_static_effect_but_never_one_that_is_a_table() -> None:
    prepared = prepare(campaign())
    linear = Setting.free(prepared).linear
    backlash, shape = (
        grid_choices(effect, effect.forms(prepared.survey)[0])[0] for effect in (Backlash(), PitchShape())
    )
    assert static_part(linear, [shape]) is None
    beside, alone = static_part(linear, [backlash, shape]), static_part(linear, [backlash])
    assert beside is not None
    assert alone is not None
    x, d = prepared.x, prepared.d
    np.testing.assert_array_equal(beside.at(x, d), alone.at(x, d))


def test_a_noise_that_few_runs_show_makes_uncertainties_wider() -> None:
    """By hand: two noise models of equal weight, variances 1 and 3 and coefficients 0.5 apart; 8 degrees of freedom, t = 2.306."""
    term = Term(Backlash(), Form("backlash", "mean", ("direction",)), (), (2.0,), ((1.0,),))
    other = Term(Backlash(), term.form, (), (2.5,), ((3.0,),))
    ((variance,),) = mixed_covariance(term, [term, other], np.array([0.5, 0.5]))
    assert variance == pytest.approx((2.0 + 0.5 * 0.5**2) * (2.306 / 1.96) ** 2, rel=1e-3)
    ((alone,),) = mixed_covariance(term, [term], np.array([1.0]))
    assert alone == pytest.approx(1.0, rel=1e-6)


@pytest.mark.outside
def test_errors_are_as_large_as_stated_where_noise_remembers() -> None:
    """Noise that remembers ten rows, about a drift with a temperature: under the fitted noise model alone they are larger."""
    off = []
    for seed in range(40):
        rng = np.random.default_rng(2000 + seed)
        memory = np.zeros(144)
        for i in range(144):
            memory[i] = (0.9 * memory[i - 1] if i % 24 else 0.0) + np.sqrt(0.19 if i % 24 else 1.0) * rng.normal()
        records = campaign(
            lambda c: wavy(c) + 2.0 * (c["temp_screw_c"] - 20.0),
            noise_um=0.3 * rng.normal(size=144) + 0.25 * memory,
            sensors=lambda c, _: {"temp_screw_c": 20.0 + 2.0 * np.sin(8.2 * c["time_s"] / c["time_s"][-1] + 1.0)},
            seed=seed,
        )
        rows = prepare(records)
        searcher = Searcher(Setting.free(rows), enumerate_candidates(rows, (ThermalDrift(),)))
        form = next(form for form in ThermalDrift().forms(rows.survey) if form.name == "temperature")
        (choice,) = grid_choices(ThermalDrift(), form)
        noise = searcher.fit_noise([choice], start_noise(rows))
        fits = searcher.fit([choice], noise), searcher.fit_of_unknown_noise([choice], noise)
        assert fits[0].found[0].coefficients == fits[1].found[0].coefficients
        assert fits[1].extended.terms == fits[1].found
        off.append([(fit.found[0].coefficients[0] - 2.0) / np.sqrt(fit.found[0].covariance[0][0]) for fit in fits])
    before, after = np.sqrt(np.mean(np.square(off), axis=0))
    assert 0.9 < after < 1.1 < before


@pytest.mark.outside
def test_a_course_of_which_only_the_sum_is_determined_is_as_large_as_what_the_table_does_not_hold() -> None:
    """Machines of the study whose cause fades after a reversal as no form of the catalogue does; where every stroke is long that is
    nearly a function of position and direction, and 76 and 12 µm of lost motion were said of errors of 2 and 3 µm. Of the first one
    four lengths undid what was left without a name, so that it has none.
    """
    for seed, named in ((109_104, False), (109_025, True)):
        drawn = draw("outside weak", seed)
        said = diagnose(Records.of(drawn.fit.records))
        state, cause_um = drawn.fit.state, drawn.fit.cause_um[0]
        smooth = np.vander(state.u, 12)
        table = np.hstack([smooth, smooth * state.direction[:, None]])
        left_um = float(np.std(cause_um - table @ np.linalg.lstsq(table, cause_um, rcond=None)[0]))
        courses = [one for one in said.findings if one.effect == "lost_motion"]
        if named:
            assert courses[0].summed
            assert courses[0].rms_um == pytest.approx(left_um, rel=0.25)
            assert courses[0].peak_um < 3.0
        else:
            assert not courses
            assert said.carriers[0].columns == ("since_reversal_mm", "direction")
            assert said.carriers[0].rms.value == pytest.approx(left_um, rel=0.25)
