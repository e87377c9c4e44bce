"""What a drive's own table adds, point by point on paper: 10 000 counts/mm, values in steps of 0.05 µm.

Nodes at 10 000, 20 000 and 40 000 counts, 1, 2 and 4 mm; for rising counts 5, -2, 3 µm, for falling ones 0, 1, 2 µm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.correction_table import Directions, Interpolation, Nodes, Outside, RawFormat, RawTable, TableDescription
from drivers.errors import CorrectionBoundError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.correction.bound import CorrectionBound
from hil.correction.tables import DirectionalTable
from hil.drive_table.curve import DriveCurve, check_curve, largest_deviation_um

COUNTS, TWENTIETHS = RawFormat("counts", 1.0, -100_000, 100_000), RawFormat("um", 0.05, -1000, 1000)
PLAIN = TableDescription(
    "table",
    10,
    Nodes.EXPLICIT,
    Interpolation.LINEAR,
    Outside.HOLD,
    Directions.BOTH,
    1,
    COUNTS,
    TWENTIETHS,
    backlash=TWENTIETHS,
)
RAW = RawTable((100, -40, 60), (0, 20, 40), (10_000, 20_000, 40_000), backlash=30)


def curve(direction: int = 1, raw: RawTable = RAW, **changes: object) -> DriveCurve:
    return DriveCurve(replace(PLAIN, **changes), raw, AxisScaling(100_000, 10.0, direction=direction))  # type: ignore[arg-type]


def test_straight_between_nodes_and_held_beyond_them() -> None:
    found = curve()
    assert found.nodes_mm.tolist() == [1.0, 2.0, 4.0]
    assert found.correction_um([0.5, 1.0, 1.5, 3.0, 9.0], 1) == pytest.approx([5.0, 5.0, 1.5, 0.5, 3.0])
    assert found.correction_um([0.5, 1.0, 1.5, 3.0, 9.0], -1) == pytest.approx([0.0, 0.0, 0.5, 1.5, 2.0])
    assert found.value_um(100) == pytest.approx(5.0)


def test_the_step_of_a_shown_value_is_a_distance_whichever_way_counts_and_signs_run() -> None:
    """100 raw are 5 µm, so one is 0.05."""
    for direction, sign in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        assert curve(direction, sign=sign).step_um == pytest.approx(0.05)


def test_counts_that_fall_when_the_table_advances() -> None:
    """The drive's 1.5 mm is our -1.5, its + is our -; arriving in + its counts fall, and what it adds moves us the other way."""
    found = curve(-1)
    assert found.nodes_mm.tolist() == [-4.0, -2.0, -1.0]
    assert found.correction_um([-1.5, -3.0], 1) == pytest.approx([-0.5, -1.5])
    assert found.correction_um([-1.5, -3.0], -1) == pytest.approx([-1.5, -0.5])
    assert found.value_um(100) == pytest.approx(-5.0)
    assert curve(-1, sign=-1).value_um(100) == pytest.approx(5.0)


def test_a_drive_that_subtracts() -> None:
    found = curve(sign=-1)
    assert found.correction_um([1.0, 1.5], [1, -1]) == pytest.approx([-5.0, -0.5])
    assert found.value_um(100) == pytest.approx(-5.0)


def test_a_value_that_holds_until_the_next_node() -> None:
    found = curve(interpolation=Interpolation.STEP)
    assert found.correction_um([0.5, 1.0, 1.999, 2.0, 3.9, 4.0, 9.0], 1) == pytest.approx([5, 5, 5, -2, -2, 3, 3])


@pytest.mark.parametrize("interpolation", Interpolation)
def test_nothing_beyond_the_last_node_where_the_drive_adds_nothing_there(interpolation: Interpolation) -> None:
    found = curve(interpolation=interpolation, outside=Outside.ZERO)
    assert found.correction_um([0.999, 1.0, 4.0, 4.001], 1) == pytest.approx([0.0, 5.0, 3.0, 0.0])


def test_a_backlash_is_taken_off_for_falling_counts_where_the_drive_has_one() -> None:
    """30 steps are 1.5 µm; subtracted values make it 1.5 µm more."""
    one = replace(RAW, minus=())
    assert curve(raw=one, directions=Directions.BACKLASH).correction_um([1.5, 1.5], [1, -1]) == pytest.approx(
        [1.5, 0.0]
    )
    subtracted = curve(raw=one, directions=Directions.BACKLASH, sign=-1)
    assert subtracted.correction_um([1.5, 1.5], [1, -1]) == pytest.approx([-1.5, 0.0])
    for same in (
        curve(raw=one, directions=Directions.ONE),
        curve(raw=one, directions=Directions.BACKLASH, backlash=None),
    ):
        assert same.correction_um([1.5, 1.5], [1, -1]) == pytest.approx([1.5, 1.5])


def both(places: list[float], values: list[float]) -> DirectionalTable:
    return DirectionalTable(np.array(places), np.array(values), np.array(values))


def test_the_largest_deviation_right_beside_a_step() -> None:
    """Wanted x µm at x mm. Steps at 0, 2 and 4 mm of 0, 2 and 4 µm: 2 µm are missing right before each."""
    stairs = curve(raw=RawTable((0, 40, 80), (0, 40, 80), (0, 20_000, 40_000)), interpolation=Interpolation.STEP)
    assert largest_deviation_um(stairs, both([0.0, 4.0], [0.0, 4.0]), 0.0, 4.0) == pytest.approx(2.0, abs=1e-3)


def test_the_largest_deviation_right_behind_the_last_node_and_before_the_first() -> None:
    """3 µm up to 2 mm, from there on nothing; wanted 3 µm up to there and down to 0 at 10 mm; and the other way round."""
    ends = curve(raw=RawTable((60, 60), (60, 60), (0, 20_000)), outside=Outside.ZERO)
    assert largest_deviation_um(ends, both([0.0, 2.0, 10.0], [3.0, 3.0, 0.0]), 0.0, 10.0) == pytest.approx(
        3.0, abs=1e-3
    )
    begins = curve(raw=RawTable((60, 60), (60, 60), (80_000, 100_000)), outside=Outside.ZERO)
    assert largest_deviation_um(begins, both([0.0, 8.0, 10.0], [0.0, 3.0, 3.0]), 0.0, 10.0) == pytest.approx(
        3.0, abs=1e-3
    )


def test_the_largest_deviation_at_the_ends_of_the_travel() -> None:
    nothing = curve(raw=RawTable())
    assert largest_deviation_um(nothing, both([0.0, 10.0], [0.0, 10.0]), 2.0, 7.0) == pytest.approx(7.0)
    assert largest_deviation_um(nothing, both([0.0, 10.0], [10.0, 0.0]), 2.0, 7.0) == pytest.approx(8.0)
    one_way = DirectionalTable(np.array([0.0, 10.0]), np.zeros(2), np.array([-1.0, -4.0]))
    assert largest_deviation_um(nothing, one_way, 0.0, 10.0) == pytest.approx(4.0)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_step_is_no_slope_to_the_bound(direction: int) -> None:
    """12 µm at once, 20 mm apart: 0.6 µm/mm as a slope, more than the 10 µm within a mm as what it is, whichever way counts run."""
    places = (0, 200_000, 400_000) if direction > 0 else (-400_000, -200_000, 0)
    straight = curve(direction, RawTable((0, 240, 240), (0, 240, 240), places))
    limits = DriveLimits(0.0, 40.0, 200.0, 2000.0)
    check_curve(straight, limits, CorrectionBound())
    with pytest.raises(CorrectionBoundError, match=r"changes by 12 µm between"):
        check_curve(curve(direction, straight.raw, interpolation=Interpolation.STEP), limits, CorrectionBound())


def test_two_steps_less_than_a_mm_apart_are_one_change_to_the_bound() -> None:
    """6 µm at 20 mm and 6 more at 20.95: 12 within the mm from right before the first to the second."""
    stairs = curve(raw=RawTable((0, 120, 240), (0, 120, 240), (0, 200_000, 209_500)), interpolation=Interpolation.STEP)
    with pytest.raises(CorrectionBoundError, match=r"changes by 12 µm between 20 and 20\.95 mm"):
        check_curve(stairs, DriveLimits(0.0, 40.0, 200.0, 2000.0), CorrectionBound())


@pytest.mark.parametrize(("plus", "minus", "way"), [(20, 0, r"\+"), (0, 20, "−")])
def test_each_direction_is_held_against_the_bound(plus: int, minus: int, way: str) -> None:
    """20 steps of 0.05 µm are 1 µm, against 0.9."""
    one = curve(raw=RawTable((plus, plus), (minus, minus), (0, 400_000)))
    with pytest.raises(CorrectionBoundError, match=rf"\+1 µm at \S+ mm \({way}\)"):
        check_curve(one, DriveLimits(0.0, 40.0, 200.0, 2000.0), CorrectionBound(0.9))
