"""The term without a cause: known to who reads a model, to no search, and held to what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from hil.effects import ALL, BESIDE, Term, survey_of, term_from_json
from hil.effects.history import complete
from hil.effects.non_parametric import FINE, ONE, TURNED, TWO, NonParametric, fine_form, smooth_form, spread_of
from hil.user_effects import catalogue_with

COLUMNS = complete(
    {
        "run": np.repeat([1.0, 2.0], 40),
        "direction": np.tile([1.0, -1.0], 40),
        "target_mm": np.linspace(0.0, 200.0, 80),
        "coolant_l_min": np.linspace(3.0, 7.0, 80),
        "load_kg": np.tile(np.linspace(0.0, 90.0, 8), 10),
    }
)


def term(coefficients: list[float], *names: str, turned: bool = False) -> Term:
    form = smooth_form(names, [spread_of(name, COLUMNS) for name in names], turned=turned)
    spread = np.diag(np.full(len(coefficients), 0.01))
    return Term(NonParametric(), form, (), tuple(coefficients), tuple(map(tuple, spread.tolist())))


def test_nobody_searches_for_it_and_every_reader_knows_it() -> None:
    assert NonParametric.id not in {effect.id for effect in ALL}
    assert [effect.id for effect in BESIDE] == [NonParametric.id]
    assert NonParametric().forms(survey_of(COLUMNS)) == ()
    held = term([1.0, 0.0, 0.0, 0.0], "coolant_l_min")
    read = term_from_json(json.loads(json.dumps(held.to_json())), ALL, "terms[0]")
    np.testing.assert_array_equal(read.error_um(COLUMNS), held.error_um(COLUMNS))


def test_the_forms_are_what_they_say() -> None:
    """v is -1 and 1 at the 1 % and 99 % quantiles: of evenly spaced values, at 0.99 of the half span."""
    v = (COLUMNS["coolant_l_min"] - 5.0) / (0.98 * 2.0)
    w = np.polynomial.Polynomial.fit(np.quantile(COLUMNS["load_kg"], [0.01, 0.99]), [-1.0, 1.0], 1)(COLUMNS["load_kg"])
    d = COLUMNS["direction"]
    one = term([0.5, 0.3, 0.0, 0.0], "coolant_l_min").error_um(COLUMNS)
    np.testing.assert_allclose(one, 0.5 * v + 0.3 * (1.5 * v**2 - 0.5), atol=1e-12)
    turned = term([0, 0, 0, 1.0, 0, 0], "coolant_l_min", turned=True).error_um(COLUMNS)
    np.testing.assert_allclose(turned, d * v, atol=1e-12)
    two = term([0, 0, 0, 0, 0, 0, 2.0, 0, 0, 0], "coolant_l_min", "load_kg").error_um(COLUMNS)
    np.testing.assert_allclose(two, 2.0 * v * w, atol=1e-12)
    beside_the_table = term([3.0, 0, 0, 0, 0, 0, 0], "load_kg", "target_mm").error_um(COLUMNS)
    np.testing.assert_allclose(beside_the_table, 3.0 * w, atol=1e-12, err_msg="the position has no part of its own")


def test_fine_position_is_straight_between_its_places() -> None:
    form = fine_form(0.0, 200.0, 5, COLUMNS, turned=False)
    held = Term(NonParametric(), form, (), (1.0, 3.0, 2.0, -1.0, 0.0), tuple(map(tuple, np.zeros((5, 5)).tolist())))
    at = np.array([0.0, 25.0, 50.0, 120.0, 200.0, 400.0, -30.0])
    expected = np.interp(np.clip(at, 0.0, 200.0), [0, 50, 100, 150, 200], [1, 3, 2, -1, 0])
    np.testing.assert_allclose(held.error_um({"target_mm": at}), expected, atol=1e-12)


def test_it_says_that_the_cause_is_unknown_and_over_which_range() -> None:
    held = term([1.0, 0.0, 0.0, 0.0], "coolant_l_min")
    sentence = held.effect.explain(held)
    assert "the cause is unknown" in sentence
    assert "coolant_l_min (3 to 7)" in sentence
    smallest, largest = held.parameters["smallest_um"], held.parameters["largest_um"]
    assert (smallest.value, largest.value) == pytest.approx((-1 / 0.98, 1 / 0.98))
    v = 1 / 0.98
    assert largest.std == pytest.approx(0.1 * np.sqrt(np.sum(np.polynomial.legendre.legvander([v], 4)[0, 1:] ** 2)))


@pytest.mark.parametrize("name", [ONE, TWO, FINE, FINE + TURNED, "two columns, sideways"])
def test_a_file_that_only_looks_like_one_is_refused(name: str) -> None:
    good = term([1.0, 0.0, 0.0, 0.0], "coolant_l_min").to_json()
    bad = {**good, "form": name, "constants": {**good["constants"], "first_mm": 0.0, "last_mm": 1.0, "places": 1e15}}
    if name == ONE:
        bad["constants"] = {}
    with pytest.raises(InputError, match=r"terms\[0\]"):
        term_from_json(bad, ALL, "terms[0]")


def test_its_name_is_not_free_for_an_effect_of_ones_own(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from hil.effects.cyclic import Cyclic\nclass Own(Cyclic):\n    id = 'non_parametric'\nEFFECTS = (Own(),)\n"
    )
    with pytest.raises(InputError, match="non_parametric"):
        catalogue_with([own])
