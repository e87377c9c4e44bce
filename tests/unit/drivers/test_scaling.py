"""Counts and millimetres by hand: 10 000 counts a motor turn, 5 motor turns for 2 of the screw, 5 mm of lead: 5000 counts/mm."""

from __future__ import annotations

from fractions import Fraction

import pytest

from drivers.errors import InputError
from drivers.scaling import AxisScaling, ReportedScaling

GEARED = AxisScaling(10_000, 5.0, Fraction(5, 2))
TURNED = AxisScaling(10_000, 5.0, Fraction(5, 2), direction=-1)


def test_a_gear_that_slows_down_makes_counts_finer() -> None:
    assert GEARED.counts_per_load_mm == 5000.0  # 25 000 a turn of the screw
    assert GEARED.resolution_load_mm == pytest.approx(0.0002)
    assert AxisScaling(10_000, 5.0).counts_per_load_mm == 2000.0
    assert AxisScaling(10_000, 0.5).counts_per_load_mm == 20_000.0
    assert AxisScaling(131_072, 10.0).counts_per_load_mm == pytest.approx(13_107.2)


def test_positions_both_ways_and_with_either_sign() -> None:
    assert (GEARED.motor_counts(1.5), TURNED.motor_counts(1.5)) == (7500, -7500)
    assert (GEARED.load_mm(7500), TURNED.load_mm(7500)) == (1.5, -1.5)
    assert GEARED.motor_counts(-0.00031) == -2  # -1.55 counts, to the nearest
    assert GEARED.load_mm(1) == pytest.approx(0.0002)


def test_speeds_have_no_sign_and_are_never_nothing() -> None:
    for axis in (GEARED, TURNED):
        assert (axis.motor_counts_per_s(2.0), axis.motor_counts_per_s(-2.0)) == (10_000, 10_000)
        assert axis.motor_counts_per_s(0.0) == 1
        assert axis.motor_counts_per_s(0.0005) == 2  # 2.5, to the even


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((0, 5.0), "encoder_counts_per_motor_rev is 0"),
        ((1, 0.0), "feed_mm_per_shaft_rev is 0"),
        ((1, -5.0), "feed_mm_per_shaft_rev is -5"),
        ((1, float("nan")), "feed_mm_per_shaft_rev is nan"),
        ((1, 5.0, Fraction(0)), "motor_revs_per_shaft_rev is 0"),
        ((1, 5.0, Fraction(1), 0), "direction is 0"),
        ((1, 5.0, Fraction(1), 2), "direction is 2"),
    ],
)
def test_what_scales_nothing_is_refused(values: tuple[object, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        AxisScaling(*values)  # type: ignore[arg-type]
    assert AxisScaling(1, 5.0).counts_per_load_mm == 0.2  # a count per turn is still a count


def test_what_a_drive_says_of_itself() -> None:
    """Encoder counts times motor turns per turn of the screw, over its lead; unless the wire counts otherwise."""
    counts, gear, feed = Fraction(10_000), Fraction(5, 2), Fraction(5)
    assert ReportedScaling(counts, gear, feed).counts_per_load_mm == 5000
    assert ReportedScaling(counts, gear).counts_per_shaft_rev == 25_000
    assert ReportedScaling(counts, gear, feed, Fraction(5000)).counts_per_load_mm == 1000  # µm
    assert ReportedScaling(None, None, feed, Fraction(5000)).counts_per_shaft_rev == 5000
    for silent in (ReportedScaling(counts), ReportedScaling(None, gear), ReportedScaling(counts, None, feed)):
        assert silent.counts_per_shaft_rev is None
        assert silent.counts_per_load_mm is None
    assert ReportedScaling(counts, gear).counts_per_load_mm is None
