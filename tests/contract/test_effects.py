"""One suite for every effect: what the diagnosis, the model file and the engine ask of each.

`pytest tests/contract/test_effects.py --effects FILE.py` runs it on a user's own. Columns that the record format does not name are
made up from the file's `COLUMNS = {"name": usual value}`.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from support.catalogue import NAMES, NEVER_COMPENSATED

from drivers.errors import InputError
from hil.effects import ALL, Action, Effect, Form, Survey, Term, survey_of, term_from_json
from hil.effects.base import Straight, Wave
from hil.effects.history import complete
from hil.effects.non_parametric import NonParametric, smooth_form, spread_of
from hil.effects.user_effects import catalogue_with, effects_of_file
from hil.examples import coolant_level

PARAMETERS = {"cyclic": {"period_mm", "amplitude_um", "phase"}}
"""Names that users of the JSON rely on."""


def rich_columns(more: Mapping[str, float], rows: int = 96) -> dict[str, np.ndarray]:
    """A campaign in which everything varies and nothing follows anything else; `more` columns by name and usual value."""
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
    columns |= {name: usual + 0.1 * max(abs(usual), 1.0) * rng.normal(size=rows) for name, usual in more.items()}
    return complete(columns)


@dataclass(frozen=True)
class Subject:
    """An effect under test, those it may name as rivals, and a campaign that shows it."""

    effect: Effect
    others: frozenset[str]
    columns: Mapping[str, np.ndarray]
    survey: Survey


CATALOGUE_COLUMNS = rich_columns({})
CATALOGUE_SURVEY = survey_of(CATALOGUE_COLUMNS)
UNSEARCHED = Subject(NonParametric(), frozenset(), CATALOGUE_COLUMNS, CATALOGUE_SURVEY)


def forms_of_structures() -> list[Form]:
    """One form of each kind that the diagnosis makes of what it cannot explain; no effect, but a term of models like any."""
    followed = (("load_kg",), ("temp_screw_c", "target_mm"))
    return [
        smooth_form(names, [spread_of(name, CATALOGUE_COLUMNS) for name in names], with_direction=signed)
        for names in followed
        for signed in (False, True)
    ]


def subjects(paths: Sequence[str]) -> list[Subject]:
    """The catalogue, the shipped example and the effects of the files, or of the files alone."""
    if not paths:
        files = [coolant_level.__file__]
        whole = [Subject(effect, NAMES - {effect.id}, CATALOGUE_COLUMNS, CATALOGUE_SURVEY) for effect in ALL]
    else:
        files, whole = list(paths), []
    known = frozenset(effect.id for effect in catalogue_with(files))  # as the command line does, with its checks
    for path in files:
        own = effects_of_file(path)
        columns = rich_columns(getattr(sys.modules[type(own[0]).__module__], "COLUMNS", {}))
        whole.extend(Subject(effect, known - {effect.id}, columns, survey_of(columns)) for effect in own)
    return whole


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """`subject`: every effect; `subject, form`: every form of every effect."""
    if "subject" not in metafunc.fixturenames:
        return
    chosen = subjects(metafunc.config.getoption("--effects"))
    if "form" not in metafunc.fixturenames:
        metafunc.parametrize("subject", chosen, ids=[s.effect.id for s in chosen])
        return
    pairs = [(s, form) for s in chosen for form in s.effect.forms(s.survey)]
    if not metafunc.config.getoption("--effects"):
        pairs += [(UNSEARCHED, form) for form in forms_of_structures()]
    metafunc.parametrize(("subject", "form"), pairs, ids=[f"{s.effect.id}-{form.name}" for s, form in pairs])


def term_of(subject: Subject, form: Form) -> Term:
    """A term with made-up values, at the first grid point of its non-linear parameters."""
    effect, theta = subject.effect, form.starts[0]
    width = effect.basis(form, theta, subject.columns).shape[1]
    size = width + len(theta)
    covariance = tuple(tuple(0.01 if i == j else 0.0 for j in range(size)) for i in range(size))
    return Term(effect, form, theta, tuple(1.0 + 0.1 * i for i in range(width)), covariance)


def test_the_catalogue_is_the_agreed_one() -> None:
    assert [effect.id for effect in ALL] == list(dict.fromkeys(effect.id for effect in ALL))
    assert {effect.id for effect in ALL} == NAMES
    assert {effect.id for effect in ALL if effect.action is not Action.COMPENSATE} == NEVER_COMPENSATED


def test_it_shows_in_a_rich_campaign_and_names_its_rivals(subject: Subject) -> None:
    effect = subject.effect
    assert effect.forms(subject.survey), "no form: does the file's COLUMNS name the columns that it reads?"
    assert effect.rivals
    for rival in effect.rivals:
        assert rival.effect in subject.others
        assert len(rival.separate_by) > 10


def test_its_basis_is_finite_and_of_one_width_over_its_whole_grid(subject: Subject, form: Form) -> None:
    widths = set()
    for theta in form.starts:
        assert len(theta) == len(form.nonlinear)
        for value, parameter in zip(theta, form.nonlinear, strict=True):
            assert parameter.lower <= value <= parameter.upper
        basis = subject.effect.basis(form, theta, subject.columns)
        assert basis.shape[0] == subject.survey.rows
        assert np.all(np.isfinite(basis))
        widths.add(basis.shape[1])
    assert len(widths) == 1


def test_it_reads_only_what_it_says_and_only_the_past(subject: Subject, form: Form) -> None:
    """Rows to come, and columns it did not name, change nothing: the engine asks row by row."""
    term, half = term_of(subject, form), subject.survey.rows // 2
    named_only = {name: subject.columns[name] for name in form.inputs}
    whole = term.error_um(named_only)
    first_half = term.error_um({name: values[:half] for name, values in named_only.items()})
    np.testing.assert_allclose(first_half, whole[:half], rtol=0, atol=1e-9)
    first = term.error_um({name: values[:1] for name, values in named_only.items()})
    np.testing.assert_allclose(first, whole[:1], rtol=0, atol=1e-9)


def test_over_the_place_it_is_as_rows_are(subject: Subject, form: Form) -> None:
    """A stream asks once for the error over the place: straight where the effect says so, else a wave with its steepest slope."""
    term = term_of(subject, form)
    places = np.concatenate([np.linspace(-3.0, 420.0, 100), 200.0 + np.linspace(0.0, 0.1, 40)])
    for at in (0, subject.survey.rows // 2):
        row = {name: float(subject.columns[name][at]) for name in {*form.inputs, "direction"}}
        each = [
            {name: np.array([value]) for name, value in row.items()} | {"target_mm": place[None]} for place in places
        ]
        expected = np.array(
            [term.error_um(columns)[0] for columns in each]
        )  # each alone: a form of history is not that of the rest
        along = term.along(row)
        if isinstance(along, Straight):
            np.testing.assert_allclose(along.at_zero_um + along.slope * places, expected, rtol=1e-9, atol=1e-9)
        elif isinstance(along, Wave):
            np.testing.assert_allclose(
                [along.at_um(place) for place in places.tolist()], expected, rtol=1e-9, atol=1e-9
            )
            assert np.max(np.abs(np.diff(expected) / np.diff(places))) <= along.steepest * (1.0 + 1e-9)
    for name in set(form.inputs) - {"target_mm"}:
        with pytest.raises(InputError, match=name):
            term.along({key: value for key, value in row.items() if key != name})
        with pytest.raises(InputError, match=name):
            term.along(row | {name: math.nan})


def test_it_survives_the_model_file_and_says_what_it_is(subject: Subject, form: Form) -> None:
    term = term_of(subject, form)
    again = term_from_json(json.loads(json.dumps(term.to_json())), [*ALL, subject.effect], "terms[0]")
    np.testing.assert_array_equal(again.error_um(subject.columns), term.error_um(subject.columns))
    sentence = term.effect.explain(term)
    assert sentence.endswith(".")
    assert any(character.isdigit() for character in sentence)
    parameters = term.parameters
    assert parameters
    assert PARAMETERS.get(subject.effect.id, set()) <= set(parameters)
    for estimate in parameters.values():
        assert math.isfinite(estimate.value)
        assert estimate.std >= 0 or math.isnan(estimate.std)


def test_a_missing_or_empty_column_is_refused_by_name(subject: Subject, form: Form) -> None:
    term = term_of(subject, form)
    for name in form.inputs:
        without = {key: values for key, values in subject.columns.items() if key != name}
        with pytest.raises(InputError, match=name):
            term.error_um(without)
        with pytest.raises(InputError, match=name):
            term.error_um({**subject.columns, name: np.full(subject.survey.rows, np.nan)})


def test_a_column_that_does_not_vary_gives_it_nothing_to_fit(subject: Subject) -> None:
    """With position and direction alone, only what position, direction and order can show is offered."""
    bare = {name: subject.columns[name] for name in ("run", "direction", "target_mm", "measured_mm")}
    survey = survey_of(complete(bare))
    for form in subject.effect.forms(survey):
        assert set(form.inputs) <= set(complete(bare))


def test_a_term_of_an_unknown_effect_or_form_is_refused() -> None:
    subject = Subject(ALL[0], frozenset(), CATALOGUE_COLUMNS, CATALOGUE_SURVEY)
    plain = term_of(subject, ALL[0].forms(CATALOGUE_SURVEY)[0]).to_json()
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
