"""Effects moved into tables: the same correction at every place, in both directions and both table modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.correction.compensation import Columns, Compensation
from hil.correction.fold import folded
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.effects import ALL, Term, term_from_json
from hil.records.rows import Floats

NODES = np.arange(0.0, 401.0, 20.0)


def term(effect: str, form: str, inputs: list[str], nonlinear: dict[str, float], coefficients: list[float]) -> Term:
    size = len(coefficients) + len(nonlinear)
    plain = {
        "effect": effect,
        "form": form,
        "inputs": inputs,
        "constants": {},
        "nonlinear": nonlinear,
        "coefficients": coefficients,
        "covariance": [[0.0] * size] * size,
    }
    return term_from_json(plain, ALL, effect)


def cyclic(period_mm: float, size_um: float) -> Term:
    return term("cyclic", "fundamental", ["target_mm"], {"period_mm": period_mm}, [size_um, 0.3 * size_um])


def worn(centre_mm: float, width_mm: float, height_um: float) -> Term:
    theta = {"centre_mm": centre_mm, "width_mm": width_mm}
    return term("local_wear", "bump with direction", ["target_mm", "direction"], theta, [height_um])


LAG = term("velocity_lag", "proportional", ["velocity_mm_s", "direction"], {}, [0.02])


@settings(max_examples=40)
@given(
    period=st.floats(2.0, 60.0),
    size=st.floats(0.1, 10.0),
    centre=st.floats(0.0, 400.0),
    width=st.floats(3.0, 80.0),
    height=st.floats(-10.0, 10.0),
    mode=st.sampled_from(TableMode),
    seed=st.integers(0, 999),
)
def test_the_folded_correction_is_the_same(
    *, period: float, size: float, centre: float, width: float, height: float, mode: TableMode, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pitch = DirectionalTable(NODES, rng.normal(0, 5, len(NODES)), rng.normal(0, 5, len(NODES)))
    tables = TableSet(mode, pitch, SingleTable(NODES[::3], rng.uniform(0, 8, len(NODES[::3]))))
    before = Compensation(tables, (cyclic(period, size), LAG, worn(centre, width, height)))
    after = folded(before)
    assert after.terms == (LAG,)
    at = rng.uniform(0.0, 400.0, 500)
    columns = {"target_mm": at, "direction": rng.choice([1.0, -1.0], 500), "velocity_mm_s": rng.uniform(0, 100, 500)}
    # the lines are compared at seven places of each stretch: between them an effect may be off by a little more
    assert after.correction_um(columns) == pytest.approx(before.correction_um(columns), abs=0.065)  # 1.3 · 0.05 µm


def test_what_depends_on_more_stays_an_effect() -> None:
    only = Compensation(TableSet.zero(NODES), (LAG,))
    assert folded(only) is only


def test_a_period_too_fine_for_any_table_is_refused() -> None:
    with pytest.raises(InputError, match="need more than 20000 nodes"):
        folded(Compensation(TableSet.zero(NODES), (cyclic(0.05, 500.0),)))


def test_a_backlash_on_places_of_its_own_stays_what_it_is() -> None:
    """10 µm at 0 and 400 mm and 40 µm at 90 mm, where the pitch has no node."""
    ends = np.array([0.0, 400.0])
    backlash = SingleTable(np.array([0.0, 90.0, 400.0]), np.array([10.0, 40.0, 10.0]))
    tables = TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, DirectionalTable(ends, np.zeros(2), np.zeros(2)), backlash)
    found = folded(Compensation(tables, (cyclic(1000.0, 0.01),))).tables
    assert found.correction_um([45.0, 90.0], -1) == pytest.approx([-25.0, -40.0], abs=0.06)


@dataclass(frozen=True)
class Bow:
    """An error that grows with the square of the position, arrived at in one direction alone: µm/mm²."""

    um_per_mm2: float
    arrived: int
    needs: tuple[str, ...] = ("target_mm", "direction")

    def error_um(self, columns: Columns) -> Floats:
        return np.where(columns["direction"] == self.arrived, self.um_per_mm2 * columns["target_mm"] ** 2, 0.0)


@pytest.mark.parametrize("arrived", [1, -1])
@pytest.mark.parametrize(("um_per_mm2", "nodes_mm"), [(0.00048, [0.0, 20.0]), (0.00052, [0.0, 10.0, 20.0])])
def test_a_stretch_is_halved_where_a_line_leaves_the_effect(
    um_per_mm2: float, nodes_mm: list[float], arrived: int
) -> None:
    """Midway in 20 mm a line is 100 mm² times the coefficient above the parabola: 0.048 µm, or 0.052 of the 0.05 that are allowed."""
    start = Compensation(TableSet.zero(np.array([0.0, 20.0])), (Bow(um_per_mm2, arrived),))
    found = folded(start).tables.pitch
    assert found.position_mm.tolist() == nodes_mm
    assert float(found.at(20.0, arrived)) == pytest.approx(-400.0 * um_per_mm2)
    assert float(found.at(20.0, -arrived)) == 0.0
