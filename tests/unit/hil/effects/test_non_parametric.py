"""The term without a cause: known to who reads a model, to no search, and held to what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from hil.effects import ALL, NEVER_SEARCHED, Term, survey_of, term_from_json
from hil.effects.history import complete
from hil.effects.non_parametric import (
    FINE,
    ONE,
    TWO,
    WITH_DIRECTION,
    NonParametric,
    fine_form,
    smooth_form,
    spread_of,
    without_cause,
)
from hil.effects.user_effects import catalogue_with

COLUMNS = complete(
    {
        "run": np.repeat([1.0, 2.0], 40),
        "direction": np.tile([1.0, -1.0], 40),
        "target_mm": np.linspace(0.0, 200.0, 80),
        "coolant_l_min": np.linspace(3.0, 7.0, 80),
        "load_kg": np.tile(np.linspace(0.0, 90.0, 8), 10),
    }
)


def term(coefficients: list[float], *names: str, with_direction: bool = False) -> Term:
    form = smooth_form(names, [spread_of(name, COLUMNS) for name in names], with_direction=with_direction)
    spread = np.diag(np.full(len(coefficients), 0.01))
    return Term(NonParametric(), form, (), tuple(coefficients), tuple(map(tuple, spread.tolist())))


def test_nobody_searches_for_it_and_every_reader_knows_it() -> None:
    assert NonParametric.id not in {effect.id for effect in ALL}
    assert [effect.id for effect in NEVER_SEARCHED] == [NonParametric.id]
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
    with_direction = term([0, 0, 0, 1.0, 0, 0], "coolant_l_min", with_direction=True).error_um(COLUMNS)
    np.testing.assert_allclose(with_direction, d * v, atol=1e-12)
    two = term([0, 0, 0, 0, 0, 0, 2.0, 0, 0, 0], "coolant_l_min", "load_kg").error_um(COLUMNS)
    np.testing.assert_allclose(two, 2.0 * v * w, atol=1e-12)
    beside_the_table = term([3.0, 0, 0, 0, 0, 0, 0], "load_kg", "target_mm").error_um(COLUMNS)
    np.testing.assert_allclose(beside_the_table, 3.0 * w, atol=1e-12, err_msg="the position has no part of its own")


def test_fine_position_is_straight_between_its_places() -> None:
    form = fine_form(0.0, 200.0, 5, COLUMNS, with_direction=False)
    held = Term(NonParametric(), form, (), (1.0, 3.0, 2.0, -1.0, 0.0), tuple(map(tuple, np.zeros((5, 5)).tolist())))
    at = np.array([0.0, 25.0, 50.0, 120.0, 200.0, 400.0, -30.0])
    expected = np.interp(np.clip(at, 0.0, 200.0), [0, 50, 100, 150, 200], [1, 3, 2, -1, 0])
    np.testing.assert_allclose(held.error_um({"target_mm": at}), expected, atol=1e-12)


SPREADS = [
    {f"{name}.low": -1.0, f"{name}.high": 1.0, f"{name}.least": -3.0, f"{name}.most": 3.0} for name in ("a", "b")
]
"""Columns that are their own v."""


def design(*names: str, with_direction: bool, **values: float) -> list[float]:
    form = smooth_form(names, SPREADS[: len(names)], with_direction=with_direction)
    rows: list[list[float]] = NonParametric().basis(form, (), {k: np.array([v]) for k, v in values.items()}).tolist()
    return rows[0]


def test_every_column_of_the_smooth_forms_by_hand() -> None:
    """v = 0.5: P1 … P4 = 0.5, -0.125, -0.4375, -0.2890625; w = -0.4: -0.4, -0.26, 0.44."""
    p, q = [0.5, -0.125, -0.4375, -0.2890625], [-0.4, -0.26, 0.44]
    assert design("a", with_direction=False, a=0.5) == pytest.approx(p)
    assert design("a", with_direction=True, a=0.5, direction=-1.0) == pytest.approx([*p[:3], *[-v for v in p[:3]]])
    products = [0.5 * -0.4, -0.125 * -0.4, 0.5 * -0.26, -0.125 * -0.26]
    assert design("a", "b", with_direction=False, a=0.5, b=-0.4) == pytest.approx([*p[:3], *q, *products])
    with_direction = design("a", "b", with_direction=True, a=0.5, b=-0.4, direction=-1.0)
    assert with_direction == pytest.approx([*p[:3], *q, *products, 0.2, -0.5, 0.4])


def test_outliers_are_held_at_1_2_half_spans_and_at_the_range_measured() -> None:
    """P2(1.2) = (3·1.44 - 1)/2 = 1.66; beyond 3, the largest that was measured, nothing is extrapolated either."""
    for value, v in ((3.0, 1.2), (-3.0, -1.2), (99.0, 1.2)):
        assert design("a", with_direction=False, a=value)[:2] == pytest.approx([v, 1.66])
    narrow = smooth_form(("a",), [SPREADS[0] | {"a.most": 0.5}], with_direction=False)
    assert NonParametric().basis(narrow, (), {"a": np.array([2.0])})[0, 0] == pytest.approx(0.5)


def test_fine_position_between_places_that_do_not_begin_at_zero() -> None:
    form = fine_form(100.0, 300.0, 3, {"target_mm": np.array([100.0, 300.0])}, with_direction=True)
    rows = NonParametric().basis(form, (), {"target_mm": np.array([150.0, 275.0]), "direction": np.array([1.0, -1.0])})
    assert rows.tolist() == [[0.5, 0.5, 0.0], [0.0, -0.25, -0.75]]
    for places, first_mm, good in (
        (2, 0.0, True),
        (1, 0.0, False),
        (1000, 0.0, True),
        (1001, 0.0, False),
        (5, 200.0, False),
    ):
        fine = fine_form(first_mm, 200.0, places, COLUMNS, with_direction=False)
        if good:
            assert NonParametric().basis(fine, (), COLUMNS).shape[1] == places
        else:
            with pytest.raises(ValueError, match="places from"):
                NonParametric().basis(fine, (), COLUMNS)


def test_the_extremes_are_looked_for_in_both_directions() -> None:
    """d·v over v = -1 … 1 (beyond it is held at the range measured): from -1 to 1 µm, and it says that the direction counts."""
    spread = SPREADS[0] | {"a.least": 0.2, "a.most": 1.0}
    form = smooth_form(("a",), [spread], with_direction=True)
    held = Term(NonParametric(), form, (), (0.0, 0.0, 0.0, 1.0, 0.0, 0.0), tuple(map(tuple, np.eye(6).tolist())))
    found = held.parameters
    assert (found["smallest_um"].value, found["largest_um"].value) == pytest.approx((-1.0, 1.0))
    # one of 1000 places alone, at 100.1 mm: looked for every 0.1 mm
    fine = fine_form(0.0, 200.0, 1000, COLUMNS, with_direction=False)
    peak = Term(
        NonParametric(),
        fine,
        (),
        tuple(float(k == 500) for k in range(1000)),
        tuple(map(tuple, np.zeros((1000, 1000)))),
    )
    assert peak.parameters["largest_um"].value == pytest.approx(1.0, abs=0.01)
    assert "a (0.2 to 1) and direction: the cause" in held.effect.explain(held)
    plain = term([1.0, 0.0, 0.0, 0.0], "coolant_l_min")
    assert "direction" not in plain.effect.explain(plain)
    assert without_cause([held]) == (held,)
    other = Term(ALL[0], form, (), (), ())
    assert without_cause([other, held]) == (held,)


def test_it_says_that_the_cause_is_unknown_and_over_which_range() -> None:
    held = term([1.0, 0.0, 0.0, 0.0], "coolant_l_min")
    sentence = held.effect.explain(held)
    assert "the cause is unknown" in sentence
    assert "coolant_l_min (3 to 7)" in sentence
    smallest, largest = held.parameters["smallest_um"], held.parameters["largest_um"]
    assert (smallest.value, largest.value) == pytest.approx((-1 / 0.98, 1 / 0.98))
    v = 1 / 0.98
    assert largest.std == pytest.approx(0.1 * np.sqrt(np.sum(np.polynomial.legendre.legvander([v], 4)[0, 1:] ** 2)))


@pytest.mark.parametrize("name", [ONE, TWO, FINE, FINE + WITH_DIRECTION, "two columns, sideways"])
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
