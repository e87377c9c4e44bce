"""The rise in force beside tables: no step anywhere, the reversal counted once, after full strokes the tables and nothing else."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import StateError
from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.rise import TWO_TANH, Rise
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet

NODES = np.array([0.0, 50.0, 100.0])
BOTH = TableSet(
    TableMode.BIDIRECTIONAL, DirectionalTable(NODES, np.array([3.0, 8.0, 5.0]), np.array([-9.0, -5.0, -5.5]))
)
BACKLASH = SingleTable(NODES, np.array([12.0, 13.0, 10.5]))
ONE = TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, BOTH.pitch, BACKLASH)
RISE = Rise(TWO_TANH, (8.0, 4.0), (0.2, 1.0, 0.5))
STEEPEST = 8.0 / 0.2 + 4.0 / 1.0  # µm of rise per mm, of the 12 that it rises
TABLE_SLOPE = 5.0 / 50.0

lengths = st.one_of(st.integers(-12, 12).map(lambda n: n / 4), st.floats(-8.0, 8.0))


@pytest.mark.parametrize("tables", [BOTH, ONE])
@settings(max_examples=25)
@given(path=st.lists(lengths, min_size=1, max_size=25))
def test_no_step_in_the_command_larger_than_slope_times_travel(tables: TableSet, path: list[float]) -> None:
    engine = Compensation(tables, (), RISE)
    history = MotionHistory(40.0).moved_to(50.0)
    course = [(50.0, engine.command(50.0, history, {}).correction_um)]
    for travel in path:
        target = min(100.0, max(0.0, history.position_mm + travel))
        command = engine.command(target, history, {})
        history = command.history
        course.append((target, command.correction_um))
    for (x0, c0), (x1, c1) in pairwise(course):
        assert abs(c1 - c0) <= (STEEPEST * 13.0 / 12.0 + TABLE_SLOPE) * abs(x1 - x0) + 1e-9


@pytest.mark.parametrize("tables", [BOTH, ONE])
def test_after_full_strokes_it_is_the_tables_to_the_last_digit_and_in_between_their_share(tables: TableSet) -> None:
    engine, plain = Compensation(tables, (), RISE), Compensation(tables)
    history = MotionHistory(0.0)
    for target in (60.0, 20.0, 90.0, 10.0):
        command = engine.command(target, history, {})
        assert command.correction_um == pytest.approx(plain.command(target, history, {}).correction_um, abs=1e-9)
        history = command.history
    # at 10 after a stroke in −; turn around: where the + table is 12 + something above, the correction starts from the − table
    plus, minus = (float(tables.correction_um([10.3], sign)[0]) for sign in (1, -1))
    share = RISE.risen_um(0.3) / RISE.amount_um
    assert engine.command(10.3, history, {}).correction_um == pytest.approx(minus + share * (plus - minus), abs=1e-9)
    assert plain.command(10.3, history, {}).correction_um == pytest.approx(plus)


def test_the_history_remembers_turns_until_their_loop_is_closed() -> None:
    history = MotionHistory(0.0).moved_to(50.0)
    assert history.turns_mm == ()
    inside = history.moved_to(49.0).moved_to(49.5).moved_to(49.2)
    assert inside.turns_mm == (50.0, 49.0, 49.5)
    assert inside.moved_to(49.6).turns_mm == (50.0, 49.0)
    assert inside.moved_to(51.0).turns_mm == ()
    assert inside.moved_to(51.0).since_reversal_mm == pytest.approx(1.8)  # of the motion, whatever the wind-up forgot


def test_a_row_without_its_share_of_the_wind_up_is_refused() -> None:
    columns = {"target_mm": np.array([50.0]), "direction": np.array([1.0])}
    with pytest.raises(StateError, match="wound_share"):
        Compensation(BOTH, (), RISE).correction_um(columns)
    between = Compensation(BOTH, (), RISE).correction_um({**columns, "wound_share": np.array([0.25])})
    assert between == pytest.approx([-5.0 + 0.25 * 13.0])
