"""Straightness of rows by hand-made numbers: the line taken out, the scatter, the proof; and a command of the other axis."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.errors import CorrectionBoundError, InputError, StateError, UnprovenError
from hil.calibration.straightness import (
    Straightness,
    StraightnessResult,
    check_straighter,
    straightness_of,
    without_straightness,
)
from hil.correction.bound import CorrectionBound
from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.tables import DirectionalTable, TableSet
from hil.machine.cross_axis import check_across
from hil.machine.set_points import CommandState
from hil.records.rows import Records

AT = np.array([0.0, 100.0, 200.0, 300.0])


def rows(deviation_um: list[float], reversal_um: float = 0.0, scatter_um: float = 0.0) -> Records:
    """Two runs both ways; the runs lie `scatter_um` above and below, the − direction `reversal_um` above."""
    columns: dict[str, list[float]] = {
        name: [] for name in ("run", "direction", "target_mm", "measured_mm", "straightness_um")
    }
    for run, off in ((1, scatter_um), (2, -scatter_um)):
        for direction in (1, -1):
            for at, value in zip(AT, deviation_um, strict=True):
                columns["run"].append(run)
                columns["direction"].append(direction)
                columns["target_mm"].append(at)
                columns["measured_mm"].append(at)
                columns["straightness_um"].append(value + off + (reversal_um if direction < 0 else 0.0))
    return Records.of(columns)


def test_the_line_through_the_deviations_is_taken_out() -> None:
    """0, 4, 4, 0 on a slope of 0.5 µm/mm and 7 µm off: the line is the mean, 2, of a curve that is even about its middle."""
    found = straightness_of(rows([7.0, 61.0, 111.0, 157.0]), "straightness_um")
    assert found.deviation_um == pytest.approx([-2.0, 2.0, 2.0, -2.0])
    assert (found.rms_um, found.range_um) == pytest.approx((2.0, 4.0))


def test_its_uncertainty_is_that_of_the_runs() -> None:
    """Two runs 0.3 µm to either side: s = 0.3·√2; four rows a section: s/2; k = 2, of four sections, and of a difference of two."""
    found = straightness_of(rows([0.0, 4.0, 4.0, 0.0], reversal_um=0.8, scatter_um=0.3), "straightness_um")
    assert found.mean_std_um == pytest.approx(0.3 * math.sqrt(2.0) / 2.0)
    assert found.rms_expanded_um == pytest.approx(2.0 * found.mean_std_um / 2.0)
    assert found.range_expanded_um == pytest.approx(2.0 * math.sqrt(2.0) * found.mean_std_um)
    assert found.reversal_um == pytest.approx(0.8)
    assert found.plus_um == pytest.approx([-2.4, 1.6, 1.6, -2.4])
    assert found.minus_um == pytest.approx([-1.6, 2.4, 2.4, -1.6])
    assert found.rms_um == pytest.approx(math.sqrt((2.4**2 + 1.6**2) / 2.0))


@pytest.mark.parametrize(
    ("records", "column", "words"),
    [
        (rows([0.0, 1.0, 1.0, 0.0]), "yaw_urad", "no column yaw_urad"),
        (rows([0.0, math.nan, 1.0, 0.0]), "straightness_um", "no value at 100 mm"),
    ],
)
def test_rows_that_cannot_tell_are_refused(records: Records, column: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        straightness_of(records, column)


def result(before_um: float, after_um: float, mean_std_um: float) -> StraightnessResult:
    def one(size_um: float) -> Straightness:
        deviation_um = size_um * np.array([-1.0, 1.0, 1.0, -1.0])
        return Straightness(AT, deviation_um, deviation_um, mean_std_um)

    return StraightnessResult(one(before_um), one(before_um), one(after_um), Compensation(TableSet.zero(AT)))


def test_only_what_is_better_by_more_than_its_uncertainty_is_proven() -> None:
    """Uncertainty of each 2·1/√4 = 1 µm, of the difference √2."""
    check_straighter(result(5.0, 3.5, 1.0))
    with pytest.raises(UnprovenError, match=r"leaves 3\.70 µm .* of 5\.00 µm"):
        check_straighter(result(5.0, 3.7, 1.0))
    with pytest.raises(UnprovenError, match="its sign is wrong"):
        check_straighter(result(5.0, 10.0, 0.1))


def across(value_um: float) -> TableSet:
    tables = TableSet.zero(AT)
    straightness = DirectionalTable.alike(AT, [0.0, value_um, value_um, 0.0])
    return TableSet(tables.mode, tables.pitch, None, None, straightness, "Y")


def test_the_other_axis_is_taken_out_of_the_tables_and_an_own_part_is_not() -> None:
    assert without_straightness(Compensation(across(5.0)), AT).tables == TableSet.zero(AT)
    assert without_straightness(None, AT).tables == TableSet.zero(AT)
    own = TableSet(across(5.0).mode, across(5.0).pitch, None, None, across(5.0).straightness, "")
    with pytest.raises(InputError, match="corrects this axis itself"):
        without_straightness(Compensation(own), AT)


def test_the_bound_of_the_other_axis_holds_for_the_table() -> None:
    check_across(across(5.0), CorrectionBound(max_um=6.0))
    with pytest.raises(CorrectionBoundError, match="to axis Y"):
        check_across(across(7.0), CorrectionBound(max_um=6.0))
    with pytest.raises(CorrectionBoundError, match="to axis Y"):
        check_across(across(5.0), CorrectionBound(max_slope_um_per_mm=0.04))


def test_what_other_axes_add_is_a_motion_with_its_own_direction_and_correction() -> None:
    """Own tables: +1 µm arriving upwards, −7 µm downwards. 3 µm up from rest: 3 + 1; back to 2 µm: 2 − 7."""
    state = CommandState()
    own = TableSet.zero(AT)
    own = TableSet(own.mode, type(own.pitch)(AT, np.full(4, 1.0), np.full(4, -7.0)))
    state.compensation = Compensation(own)
    with pytest.raises(StateError):
        state.command(200.0, {}, across_um=3.0)
    state.set_position(MotionHistory(199.0).moved_to(200.0), 200.0)
    up = state.command(200.0, {}, across_um=3.0)
    assert up.command_mm == pytest.approx(200.004)
    state.issued(up)
    down = state.command(200.0, {}, across_um=2.0)
    assert down.history.direction == -1
    assert down.command_mm == pytest.approx(200.0 + 0.002 - 0.007)


def test_both_together_hold_within_the_bound_of_the_other_axis() -> None:
    state = CommandState()
    own = TableSet.zero(AT)
    state.compensation = Compensation(TableSet(own.mode, type(own.pitch)(AT, np.full(4, 4.0), np.full(4, 4.0))))
    state.bound = CorrectionBound(max_um=8.0)
    state.set_position(MotionHistory(199.0).moved_to(200.0), 200.0)
    assert state.command(200.0, {}, across_um=3.9).command_mm == pytest.approx(200.0079)
    with pytest.raises(CorrectionBoundError, match=r"with straightness not commanded: \+8\.1 µm at 200"):
        state.command(200.0, {}, across_um=4.1)
