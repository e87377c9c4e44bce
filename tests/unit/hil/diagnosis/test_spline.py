"""The declared table's columns against scipy's splines: cardinal functions, and the smoothing spline they are a prior of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, make_smoothing_spline

from hil.diagnosis.table import TableBasis, cardinal, choose_knots, clusters

KNOTS = np.array([0.0, 11.0, 30.0, 42.0, 55.0, 71.0, 90.0, 100.0])


@given(st.lists(st.floats(-50.0, 50.0), min_size=8, max_size=8))
@settings(max_examples=25)
def test_values_at_the_knots_give_the_natural_spline_through_them(values: list[float]) -> None:
    x = np.linspace(0.0, 100.0, 41)
    expected = CubicSpline(KNOTS, values, bc_type="natural")(x)
    np.testing.assert_allclose(cardinal(KNOTS, x) @ np.array(values), expected, atol=1e-9)


def test_beyond_the_outer_knots_the_line_goes_on_straight() -> None:
    values = np.cos(KNOTS / 20.0)
    spline = CubicSpline(KNOTS, values, bc_type="natural")
    beyond = cardinal(KNOTS, np.array([-7.0, 103.0])) @ values
    np.testing.assert_allclose(beyond, [spline(0.0) - 7.0 * spline(0.0, 1), spline(100.0) + 3.0 * spline(100.0, 1)])


@pytest.mark.parametrize("knots", [np.array([5.0]), np.array([5.0, 9.0])])
def test_few_knots_are_a_constant_and_a_line(knots: np.ndarray) -> None:
    basis = cardinal(knots, np.array([4.0, 7.0, 9.0]))
    np.testing.assert_allclose(basis.sum(axis=1), 1.0)
    np.testing.assert_allclose(basis @ knots, [4.0, 7.0, 9.0] if len(knots) == 2 else 5.0)


@pytest.mark.parametrize("variance", [0.3, 10.0, 1000.0])
def test_a_normal_prior_of_one_variance_is_the_smoothing_spline(variance: float) -> None:
    """Columns over -1 … 1: the prior's inverse variance is the weight of ∫ f''² there, half-span³ times that in mm."""
    rng = np.random.default_rng(2)
    y = np.sin(KNOTS / 15.0) + 0.2 * rng.normal(size=len(KNOTS))
    basis = TableBasis(KNOTS, both_directions=False)
    design = np.hstack([basis.free(KNOTS, np.ones(8)), basis.penalised(KNOTS)])
    ridge = np.concatenate([np.zeros(2), np.full(design.shape[1] - 2, 1.0 / variance)])
    fitted = design @ np.linalg.solve(design.T @ design + np.diag(ridge), design.T @ y)
    np.testing.assert_allclose(fitted, make_smoothing_spline(KNOTS, y, lam=50.0**3 / variance)(KNOTS), atol=1e-8)


def test_both_directions_have_a_table_each() -> None:
    """Free and penalised columns, even and odd in the direction, reach any values at the knots in either direction."""
    x, d = np.tile(KNOTS, 2), np.repeat([1.0, -1.0], 8)
    basis = TableBasis(KNOTS, both_directions=True)
    even = basis.penalised(x)
    design = np.hstack([basis.free(x, d), even, even * d[:, None]])
    y = np.random.default_rng(1).normal(size=16)
    np.testing.assert_allclose(design @ np.linalg.lstsq(design, y, rcond=None)[0], y, atol=1e-8)


def test_targets_within_a_twentieth_of_the_spacing_are_one() -> None:
    means, label = clusters(np.array([10.0, 0.0, 10.4, 20.0, 0.2]), 10.0)
    np.testing.assert_allclose(means, [0.1, 10.2, 20.0])
    np.testing.assert_array_equal(label, [1, 0, 1, 2, 0])


@given(st.integers(5, 60), st.integers(2, 12), st.floats(0.2, 1.0))
@settings(max_examples=30)
def test_scattered_targets_get_no_more_knots_than_a_pass_can_fix(targets: int, runs: int, scatter: float) -> None:
    rng = np.random.default_rng(targets)
    x = np.concatenate([np.arange(targets) + scatter * rng.uniform(-0.5, 0.5, targets) for _ in range(runs)])
    knots, repeated = choose_knots(x, targets)
    assert np.all(np.diff(knots) > 0)
    assert len(knots) <= max(6, 1.5 * targets + 1)
    assert knots[0] >= np.min(x)
    assert knots[-1] <= np.max(x)
    assert not (repeated and scatter > 0.5 and runs > 3)
