"""Effects that show when the optics are set up anew: Abbe error at a second offset, cosine error before and after realigning."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hil.effects import ALL, Form, survey_of, term_from_json
from hil.effects.abbe import SECOND_OFFSET, Abbe
from hil.effects.base import Term
from hil.effects.cosine import Cosine
from hil.effects.history import complete

X = np.linspace(0.0, 400.0, 9)


def columns(**more: np.ndarray) -> dict[str, np.ndarray]:
    rows = len(X)
    return complete({"run": np.ones(rows), "direction": np.ones(rows), "target_mm": X, **more})


def term(effect: Abbe | Cosine, form: Form, theta: tuple[float, ...], coefficients: list[float]) -> Term:
    size = len(theta) + len(coefficients)
    covariance = tuple(tuple(float(v) for v in row) for row in np.eye(size) * 1e-4)
    return Term(effect, form, theta, tuple(coefficients), covariance)


def test_abbe_error_is_tilt_times_the_whole_arm() -> None:
    offset = np.where(np.arange(9) % 2, 150.0, 0.0)
    survey = survey_of(columns(abbe_offset_mm=offset))
    forms = [form for form in Abbe().forms(survey) if form.name in SECOND_OFFSET]
    assert len(forms) == len(SECOND_OFFSET)
    tilt_urad, arm_mm = 10.0, 80.0  # at the ends of the travel, of opposite sign
    straight = term(Abbe(), forms[0], (arm_mm,), [0.0, tilt_urad])
    expected_um = (arm_mm + offset) * tilt_urad * (X - 200.0) / 200.0 * 1e-3
    np.testing.assert_allclose(straight.error_um(columns(abbe_offset_mm=offset)), expected_um)
    assert "80" in Abbe().explain(straight)
    assert straight.parameters["tilt_to_the_end_urad"].value == tilt_urad


def test_cosine_error_goes_with_the_realignment() -> None:
    setup = np.where(X > 200.0, 2.0, 1.0)
    (form,) = Cosine().forms(survey_of(columns(setup=setup)))
    found = term(Cosine(), form, (), [20.0])
    np.testing.assert_allclose(
        found.error_um(columns(setup=setup)), np.where(setup == 1.0, -20e-3 * X, 0.0), atol=1e-12
    )
    assert "realigning" in Cosine().explain(found)


@pytest.mark.parametrize("name", ["abbe_offset_mm", "setup"])
def test_they_are_saved_and_read_back(name: str) -> None:
    survey = survey_of(columns(**{name: np.arange(9.0)}))
    forms = [(e, f) for e in (Abbe(), Cosine()) for f in e.forms(survey) if name in f.inputs]
    assert forms
    for effect, form in forms:
        width = effect.basis(form, form.starts[0], columns(**{name: np.arange(9.0)})).shape[1]
        saved = term(effect, form, form.starts[0], [1.0] * width)
        again = term_from_json(json.loads(json.dumps(saved.to_json())), ALL, "term")
        rows = columns(**{name: np.arange(9.0)})
        np.testing.assert_array_equal(saved.error_um(rows), again.error_um(rows))
