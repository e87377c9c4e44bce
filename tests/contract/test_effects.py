"""One suite for every effect: what the diagnosis, the model file and the engine ask of each."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from drivers.errors import InputError
from hil.effects import ALL, Action, Effect, Form, Survey, Term, survey_of, term_from_json
from hil.effects.history import complete

PARAMETERS = {"cyclic": {"period_mm", "amplitude_um", "phase"}}
"""Names that users of the JSON rely on."""
NEVER_COMPENSATED = {"datum_step", "dead_path", "air_index", "cosine", "beam_drift"}
IDS = {
    "cyclic",
    "thermal_expansion",
    "thermal_drift",
    "backlash",
    "backlash_position",
    "lost_motion",
    "velocity_lag",
    "load_deflection",
    "abbe",
    "cross_axis",
    "local_wear",
    "pitch_shape",
} | NEVER_COMPENSATED


def rich_columns(rows: int = 96) -> dict[str, np.ndarray]:
    """A campaign in which everything varies and nothing follows anything else."""
    rng = np.random.default_rng(4)
    names = {
        "temp_screw_c": 22.0,
        "air_temp_c": 20.5,
        "load_kg": 50.0,
        "pitch_urad": 3.0,
        "yaw_urad": -2.0,
        "pos_y_mm": 100.0,
        "torque_percent": 12.0,
        "air_humidity_percent": 45.0,
    }
    columns = {name: middle + rng.normal(size=rows) for name, middle in names.items()}
    columns |= {
        "run": np.repeat(np.arange(1.0, 5.0), rows // 4),
        "direction": np.tile([1.0, 1.0, -1.0], rows // 3),
        "target_mm": rng.uniform(0.0, 400.0, rows),
        "measured_mm": rng.normal(size=rows),
        "time_s": np.cumsum(rng.uniform(2.0, 9.0, rows)),
        "velocity_mm_s": rng.choice([5.0, 20.0, 80.0], rows),
        "since_reversal_mm": rng.uniform(0.1, 50.0, rows),
        "stroke_mm": rng.uniform(1.0, 200.0, rows),
        "air_pressure_hpa": 1000.0 + rng.normal(size=rows) * 5,
    }
    return complete(columns)


COLUMNS = rich_columns()
SURVEY: Survey = survey_of(COLUMNS)
FORMS = [(effect, form) for effect in ALL for form in effect.forms(SURVEY)]


def term_of(effect: Effect, form: Form) -> Term:
    """A term with made-up values, at the first grid point of its non-linear parameters."""
    theta = form.starts[0]
    width = effect.basis(form, theta, COLUMNS).shape[1]
    size = width + len(theta)
    covariance = tuple(tuple(0.01 if i == j else 0.0 for j in range(size)) for i in range(size))
    return Term(effect, form, theta, tuple(1.0 + 0.1 * i for i in range(width)), covariance)


def named(value: object) -> str:
    return value.id if isinstance(value, Effect) else value.name if isinstance(value, Form) else str(value)


def test_the_catalogue_is_the_agreed_one() -> None:
    assert [effect.id for effect in ALL] == list(dict.fromkeys(effect.id for effect in ALL))
    assert {effect.id for effect in ALL} == IDS
    assert {effect.id for effect in ALL if effect.action is not Action.COMPENSATE} == NEVER_COMPENSATED


@pytest.mark.parametrize("effect", ALL, ids=named)
def test_it_shows_in_a_rich_campaign_and_names_its_rivals(effect: Effect) -> None:
    assert effect.forms(SURVEY)
    assert effect.rivals
    for rival in effect.rivals:
        assert rival.effect in IDS - {effect.id}
        assert len(rival.separate_by) > 10


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=named)
def test_its_basis_is_finite_and_of_one_width_over_its_whole_grid(effect: Effect, form: Form) -> None:
    widths = set()
    for theta in form.starts:
        assert len(theta) == len(form.nonlinear)
        for value, parameter in zip(theta, form.nonlinear, strict=True):
            assert parameter.lower <= value <= parameter.upper
        basis = effect.basis(form, theta, COLUMNS)
        assert basis.shape[0] == SURVEY.rows
        assert np.all(np.isfinite(basis))
        widths.add(basis.shape[1])
    assert len(widths) == 1


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=named)
def test_it_reads_only_what_it_says_and_only_the_past(effect: Effect, form: Form) -> None:
    """Rows to come, and columns it did not name, change nothing: the engine asks row by row."""
    term = term_of(effect, form)
    named_only = {name: COLUMNS[name] for name in form.inputs}
    whole = term.error_um(named_only)
    half = term.error_um({name: values[: SURVEY.rows // 2] for name, values in named_only.items()})
    np.testing.assert_allclose(half, whole[: SURVEY.rows // 2], rtol=0, atol=1e-9)
    first = term.error_um({name: values[:1] for name, values in named_only.items()})
    np.testing.assert_allclose(first, whole[:1], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=named)
def test_it_survives_the_model_file_and_says_what_it_is(effect: Effect, form: Form) -> None:
    term = term_of(effect, form)
    again = term_from_json(json.loads(json.dumps(term.to_json())), ALL, "terms[0]")
    np.testing.assert_array_equal(again.error_um(COLUMNS), term.error_um(COLUMNS))
    sentence = term.effect.explain(term)
    assert sentence.endswith(".")
    assert any(character.isdigit() for character in sentence)
    parameters = term.parameters
    assert parameters
    assert PARAMETERS.get(effect.id, set()) <= set(parameters)
    for estimate in parameters.values():
        assert math.isfinite(estimate.value)
        assert estimate.std >= 0 or math.isnan(estimate.std)


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=named)
def test_a_missing_or_empty_column_is_refused_by_name(effect: Effect, form: Form) -> None:
    term = term_of(effect, form)
    for name in form.inputs:
        without = {key: values for key, values in COLUMNS.items() if key != name}
        with pytest.raises(InputError, match=name):
            term.error_um(without)
        with pytest.raises(InputError, match=name):
            term.error_um({**COLUMNS, name: np.full(SURVEY.rows, np.nan)})


@pytest.mark.parametrize("effect", ALL, ids=named)
def test_a_column_that_does_not_vary_gives_it_nothing_to_fit(effect: Effect) -> None:
    """With position and direction alone, only what position, direction and order can show is offered."""
    bare = {name: COLUMNS[name] for name in ("run", "direction", "target_mm", "measured_mm")}
    survey = survey_of(complete(bare))
    for form in effect.forms(survey):
        assert set(form.inputs) <= set(complete(bare))


def test_a_term_of_an_unknown_effect_or_form_is_refused() -> None:
    effect, form = FORMS[0]
    plain = term_of(effect, form).to_json()
    for change in (
        {"effect": "gremlins"},
        {"form": "no such form"},
        {"coefficients": [1.0] * 9},
        {"inputs": "target_mm"},
    ):
        with pytest.raises(InputError, match=r"terms\[0\]"):
            term_from_json({**plain, **change}, ALL, "terms[0]")
    with pytest.raises(InputError):
        term_from_json(plain | {"extra": 1}, ALL, "terms[0]")
