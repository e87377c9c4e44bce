"""The table of a fit on its way back into a model: the same function, with the same uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.model.evidence import Fit, Noise
from hil.diagnosis.model.rows import NO_MEMORY, Given, ModelRows
from hil.diagnosis.table import DeclaredShape, SplineShape, TableBasis
from hil.effects.model import Model, PitchTable
from hil.records.rows import Records

KNOTS = np.linspace(0.0, 90.0, 7)
SHAPE = SplineShape(TableBasis(KNOTS, both_directions=True))
RNG = np.random.default_rng(1)


def test_a_tabulated_spline_is_the_spline_to_within_its_linear_pieces() -> None:
    x, d = np.tile(np.linspace(0.0, 90.0, 200), 2), np.repeat([1.0, -1.0], 200)
    columns = SHAPE.columns(x, d).stacked
    values = np.where(d > 0, np.sin(x / 20.0), 0.5 * np.cos(x / 30.0) - 1.0)
    coefficients = np.linalg.lstsq(columns, values, rcond=None)[0]
    table = SHAPE.tabulate(coefficients)
    curvature = 1.0 / 20.0**2
    piece_mm = 15.0 / 8
    np.testing.assert_allclose(table.error_um(x, d), columns @ coefficients, atol=1.5 * curvature * piece_mm**2 / 8)
    knots = np.concatenate([KNOTS, KNOTS])
    turned = np.repeat([1.0, -1.0], 7)
    np.testing.assert_allclose(
        table.error_um(knots, turned), SHAPE.columns(knots, turned).stacked @ coefficients, atol=1e-9
    )


def test_the_covariance_at_the_nodes_is_that_of_what_is_read_there() -> None:
    """By drawing coefficients and reading their tables."""
    width = SHAPE.columns(KNOTS, np.ones(7)).stacked.shape[1]
    root = RNG.normal(size=(width, width)) / 10
    table = SHAPE.tabulate(np.zeros(width), root @ root.T)
    nodes = np.array(table.positions_mm)[list(table.nodes)]
    drawn = [SHAPE.tabulate(root @ RNG.normal(size=width)) for _ in range(800)]
    read = np.array([np.concatenate([t.error_um(nodes, np.ones(7)), t.error_um(nodes, -np.ones(7))]) for t in drawn])
    expected = np.array(table.covariance_um2)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(read.T @ read / 800 - expected) / size) < 0.2


def moved(table: PitchTable, records: Records) -> PitchTable:
    """A declared table as rows with a noise of 0.3 µm move it."""
    rows = ModelRows(prepare(records), Given(Model(table), DeclaredShape.of(table, noise_um=0.3), ()))
    fit = Fit(rows, (), Noise(NO_MEMORY, np.zeros(3)))
    return rows.shape.tabulate(fit.beta[fit.of_table()])


@pytest.mark.parametrize(("std_um", "moves"), [(0.003, False), (3.0, True)])
def test_a_declared_table_moves_as_far_as_its_uncertainty_allows(std_um: float, moves: bool) -> None:
    """Errors that bend away from it by 1 µm: a table known to 3 nm stays where it is, one known to 3 µm follows."""
    campaign_rows = campaign(lambda c: 1.0 * np.sin(c["target_mm"] / 40.0), noise_um=0.3, runs=4)
    prepared = prepare(campaign_rows)
    nodes = np.linspace(0.0, 300.0, 13)
    flat = tuple(np.zeros(13))
    covariance = tuple(tuple(row) for row in std_um**2 * np.eye(26))
    table = moved(PitchTable(tuple(nodes), flat, flat, tuple(range(13)), covariance), campaign_rows)
    left = np.std(prepared.error_um - table.error_um(prepared.x, prepared.d))
    assert bool(left < 0.35) == moves
    assert bool(np.std(table.forward_um) > 0.5) == moves


def test_a_declared_table_may_always_move_by_a_constant() -> None:
    nodes = np.linspace(0.0, 300.0, 61)
    forward, backward = (3.0 * np.sin(nodes / 70.0) - 0.8 * d for d in (1.0, -1.0))
    exact = PitchTable(tuple(nodes), tuple(forward), tuple(backward), (0, 60), tuple(map(tuple, 1e-12 * np.eye(4))))
    after = moved(exact, campaign(lambda c: wavy(c) + 5.0, noise_um=0.01))
    np.testing.assert_allclose(np.array(after.forward_um) - forward, 5.0, atol=0.01)
