"""Counts and millimetres by hand: 10 000 counts a motor turn, 5 motor turns for 2 of the screw, 5 mm of lead: 5000 counts/mm."""

from __future__ import annotations

from fractions import Fraction

import pytest

from drivers.errors import InputError, LimitError
from drivers.scaling import AxisScaling, MotionScaling, ReportedScaling, motion_unit

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
    assert AxisScaling(1, 5.0, Fraction(1), -1).motor_counts(25.0) == -5


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


# -- units of velocity and acceleration, by hand ---------------------------------------------------------------------------
DIRECT = AxisScaling(4096, 10.0)  # 10 mm/s is one motor turn per second; 100 mm/s² are 10 turns/s²
SLOW_GEAR = AxisScaling(4096, 10.0, Fraction(5), direction=-1)  # 10 mm/s are five motor turns per second


@pytest.mark.parametrize(
    ("scaling", "unit", "units_of_10_mm_s"),
    [
        (DIRECT, "counts/s", 4096),
        (DIRECT, "rpm", 60),
        (DIRECT, "rev/min", 60),
        (DIRECT, "0.1 rpm", 600),
        (DIRECT, "1/1000 rpm", 60_000),
        (DIRECT, "rev/s", 1),
        (DIRECT, "rev/h", 3600),
        (DIRECT, "deg/s", 360),
        (DIRECT, "0.1 deg/s", 3600),
        (DIRECT, "0.001 rad/s", 6283),  # 2 pi thousand
        (DIRECT, "mm/s", 10),
        (DIRECT, "um/s", 10_000),
        (DIRECT, "mm/min", 600),
        (DIRECT, "1/1000 m/s", 10),
        (DIRECT, "1/10000000 m/s", 100_000),
        (DIRECT, "counts/ms", 4),  # 4.096
        (DIRECT, "1/65536 counts/ms", 268_435),  # 4.096 · 65536 = 268 435.456
        (SLOW_GEAR, "rpm", 300),
        (SLOW_GEAR, "counts/s", 20_480),
        (SLOW_GEAR, "mm/s", 10),
    ],
)
def test_velocities_in_every_unit(scaling: AxisScaling, unit: str, units_of_10_mm_s: int) -> None:
    usual = MotionScaling.in_counts(scaling)
    units = MotionScaling(scaling, motion_unit(unit, scaling, 1), usual.acceleration)
    assert units.velocity_units(10.0) == units.velocity_units(-10.0) == units_of_10_mm_s
    assert units.load_mm_s(units_of_10_mm_s) == pytest.approx(scaling.direction * 10.0, rel=0.03)


@pytest.mark.parametrize(
    ("scaling", "unit", "units_of_100_mm_s2"),
    [
        (DIRECT, "counts/s2", 40_960),
        (DIRECT, "counts/s/s", 40_960),
        (DIRECT, "rpm/s", 600),
        (DIRECT, "rev/min/s", 600),
        (DIRECT, "0.1 rpm/s", 6000),
        (DIRECT, "rev/s2", 10),
        (DIRECT, "deg/s2", 3600),
        (DIRECT, "mm/s2", 100),
        (DIRECT, "um/s2", 100_000),
        (DIRECT, "1/65536 counts/ms2", 2684),  # 0.04096 · 65536 = 2684.35
        (SLOW_GEAR, "rpm/s", 3000),
        (SLOW_GEAR, "rev/s2", 50),
    ],
)
def test_accelerations_in_every_unit(scaling: AxisScaling, unit: str, units_of_100_mm_s2: int) -> None:
    usual = MotionScaling.in_counts(scaling)
    units = MotionScaling(scaling, usual.velocity, motion_unit(unit, scaling, 2))
    assert units.acceleration_units(100.0) == units.acceleration_units(-100.0) == units_of_100_mm_s2
    assert units.acceleration_units(1e-9) == 1
    assert units.mm_s2(units_of_100_mm_s2) == pytest.approx(100.0, rel=1e-3)


def test_jerk_has_three_times() -> None:
    assert motion_unit("rpm/s2", DIRECT, 3).counts == Fraction(4096, 60)
    assert motion_unit("mm/s3", DIRECT, 3).counts == Fraction(DIRECT.counts_per_load_mm)


@pytest.mark.parametrize(
    ("text", "times"),
    [("rpm", 2), ("rpm/s", 1), ("furlong/s", 1), ("counts", 1), ("rpm/fortnight", 2), ("", 1), ("0 rpm", 1)],
)
def test_what_is_no_such_unit_is_refused(text: str, times: int) -> None:
    with pytest.raises(InputError, match=r"_unit .* expected such as"):
        motion_unit(text, DIRECT, times)


def test_coarse_units_never_go_faster_than_asked() -> None:
    """1 rpm is 1/6 mm/s: 0.25 mm/s are 1.5 rpm, of which one is taken; 7.3 mm/s are 43.8, where 44 are 0.5 % more."""
    usual = MotionScaling.in_counts(DIRECT)
    units = MotionScaling(DIRECT, motion_unit("rpm", DIRECT, 1), usual.acceleration)
    assert [units.velocity_units(speed) for speed in (0.25, 0.26, 7.3, 0.17)] == [1, 1, 44, 1]
    assert units.representable_mm_s(0.25) == pytest.approx(1 / 6)
    assert units.representable_mm_s(0.01) == pytest.approx(1 / 6)
    with pytest.raises(LimitError, match=r"0.1 mm/s is below one unit of the drive's velocity, 0.1667 mm/s \(rpm\)"):
        units.velocity_units(0.1)
