"""The formulas of the run-out with literal values, and against a ball that is turned about an axis by rotating it."""

from __future__ import annotations

import cmath
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.probe.runout import (
    Centring,
    CorrectionCode,
    FourFeeds,
    MeasurementRefusedError,
    RunOut,
    check_radius,
    check_repeat,
    mean_feeds,
    run_out,
    run_out_std_um,
)

# l = 5, r = 2, Δx = 0.010, Δy = −0.020: N_0 = l − r − Δx, N_90 = l − r + Δy, N_180 = l − r + Δx, N_270 = l − r − Δy
PUBLISHED = FourFeeds(2.990, 2.980, 3.010, 3.020)


def test_the_published_form_with_literal_values() -> None:
    found = run_out(PUBLISHED, 5.0)
    assert (found.x_mm, found.y_mm, found.tip_radius_mm) == pytest.approx((0.010, -0.020, 2.0), abs=1e-12)
    assert found.closure_um == pytest.approx(0.0, abs=1e-9)
    assert found.size_um == pytest.approx(math.sqrt(500.0))


def test_a_face_on_the_other_side_turns_the_signs() -> None:
    found = run_out(PUBLISHED, 5.0, facing=-1)
    assert (found.x_mm, found.y_mm, found.tip_radius_mm) == pytest.approx((-0.010, 0.020, 2.0), abs=1e-12)
    with pytest.raises(InputError, match="facing is 0"):
        run_out(PUBLISHED, 5.0, facing=0)


def test_the_pretravel_lengthens_every_feed_and_is_given_back_to_the_radius() -> None:
    late = FourFeeds(3.002, 2.992, 3.022, 3.032)  # 12 µm more each
    assert run_out(late, 5.0).tip_radius_mm == pytest.approx(1.988)
    assert run_out(late, 5.0, pretravel_mm=0.012).tip_radius_mm == pytest.approx(2.0)
    assert run_out(late, 5.0).x_mm == pytest.approx(0.010)


@pytest.mark.parametrize("facing", [1, -1])
@settings(max_examples=25)
@given(st.complex_numbers(max_magnitude=0.2), st.floats(0.3, 4.0), st.floats(5.0, 9.0), st.floats(-0.002, 0.002))
def test_a_ball_turned_about_the_spindle_gives_its_place_back(
    facing: int, ball: complex, radius: float, distance: float, z: float
) -> None:
    """The ball's centre as a complex number turned by 90° each time; contact where its rim reaches the face."""
    feeds = [distance + z - radius - facing * (ball * 1j**quarter).real for quarter in range(4)]
    found = run_out(FourFeeds(*feeds), distance + z, facing=facing)
    assert complex(found.x_mm, found.y_mm) == pytest.approx(ball, abs=1e-9)
    assert found.tip_radius_mm == pytest.approx(radius)
    assert abs(found.closure_um) < 1e-6
    turned = ball * cmath.exp(1j * math.radians(37.0))
    assert found.at(37.0) == pytest.approx((turned.real, turned.imag), abs=1e-9)


def test_sizes_in_um_and_what_goes_with_them() -> None:
    """√(10² + 20²) µm; closure 2.990 + 3.010 - 2.930 - 3.020 = 0.050 mm."""
    found = run_out(FourFeeds(2.990, 2.930, 3.010, 3.020), 5.0)
    assert found.closure_um == pytest.approx(50.0)
    assert RunOut(0.010, -0.020, 2.0).size_um == pytest.approx(22.36068)
    assert RunOut(0.010, -0.020, 2.0).closure_um == 0.0


def test_the_mean_of_turns_and_their_limits_to_the_um() -> None:
    other = FourFeeds(2.991, 2.984, 3.016, 3.023)
    assert vars(mean_feeds([PUBLISHED, other])) == pytest.approx(
        {"n_0_mm": 2.9905, "n_90_mm": 2.982, "n_180_mm": 3.013, "n_270_mm": 3.0215}
    )
    check_repeat([PUBLISHED, other], 6.001)
    with pytest.raises(MeasurementRefusedError, match="0° does not repeat"):
        check_repeat([PUBLISHED, FourFeeds(3.0, 2.98, 3.01, 3.02)], 5.0)
    for n_90, n_270, angle in ((2.990, 3.020, 90), (2.980, 3.030, 270)):
        with pytest.raises(MeasurementRefusedError, match=f"at {angle}° does not"):
            check_repeat([PUBLISHED, FourFeeds(2.990, n_90, 3.010, n_270)], 5.0)
    found = run_out(PUBLISHED, 5.0)  # 2.000 mm
    for nominal_mm in (1.9701, 2.0299):
        check_radius(found, nominal_mm, 30.0)
    for nominal_mm in (1.9699, 2.0301):
        with pytest.raises(MeasurementRefusedError):
            check_radius(found, nominal_mm, 30.0)
    with pytest.raises(MeasurementRefusedError):
        check_radius(RunOut(0.0, 0.0, math.nan), 2.0, 30.0)
    with pytest.raises(MeasurementRefusedError):
        FourFeeds(2.990, 2.9769, 3.010, 3.020).check_closure(3.0)  # +3.1 µm; the test below has -3.1


def test_the_uncertainty_by_hand() -> None:
    """Two turns 2 µm apart at 0° and equal elsewhere: squares 2 µm², pooled /(4·1), of the mean /2: 0.25; with a step of 1 µm
    √((0.25 + 1/12)/2) = 0.408248 µm."""
    turns = [FourFeeds(2.990, 2.980, 3.010, 3.020), FourFeeds(2.992, 2.980, 3.010, 3.020)]
    assert run_out_std_um(turns, 0.0) == pytest.approx(math.sqrt(0.125))
    assert run_out_std_um(turns, 0.001) == pytest.approx(0.4082483)


def test_the_spindle_turned_and_the_pretravel_in_a_bore() -> None:
    """At 90° the ball that lay at (10, -20) µm lies at (20, 10); the pretravel is pushed off the radius on both sides."""
    ball = RunOut(0.010, -0.020, 2.0)
    assert ball.at(90.0) == pytest.approx((0.020, 0.010))
    assert ball.correction_mm(CorrectionCode.M93, 90.0) == pytest.approx((0.020, 0.010))
    centring = Centring((42.0, 58.0), (52.0, 68.0), ball, spindle_deg=90.0, pretravel_mm=0.012)
    assert centring.centre_mm == pytest.approx((50.020, 60.010))
    assert centring.diameter_mm == pytest.approx(16.0 + 2 * 1.988)
    assert Centring((42.0, 58.0), (52.0, 68.0), ball).pretravel_mm == 0.0


def test_contacts_that_do_not_close_are_refused_naming_both_sums() -> None:
    with pytest.raises(MeasurementRefusedError, match=r"N0 \+ N180 = 6\.0000 mm, N90 \+ N270 = 5\.9500 mm, \+50\.0 µm"):
        FourFeeds(2.990, 2.930, 3.010, 3.020).check_closure(3.0)
    PUBLISHED.check_closure(1e-6)
    FourFeeds(2.990, 2.9829, 3.010, 3.020).check_closure(3.0)
    with pytest.raises(MeasurementRefusedError):
        FourFeeds(2.990, 2.9831, 3.010, 3.020).check_closure(3.0)
    with pytest.raises(MeasurementRefusedError):
        FourFeeds(math.nan, 2.98, 3.01, 3.02).check_closure(3.0)


def test_turns_that_do_not_repeat_are_refused_naming_the_angle() -> None:
    other = FourFeeds(2.991, 2.981, 3.016, 3.021)
    with pytest.raises(MeasurementRefusedError, match=r"180° does not repeat: 3\.0100 and 3\.0160 mm, 6\.0 µm apart"):
        check_repeat([PUBLISHED, other], 3.0)
    check_repeat([PUBLISHED], 0.001)
    assert mean_feeds([PUBLISHED, other]).n_180_mm == pytest.approx(3.013)


def test_a_radius_that_is_not_the_balls_is_refused_naming_both() -> None:
    with pytest.raises(MeasurementRefusedError, match=r"comes out as 2\.0000 mm, \+40\.0 µm off its 1\.9600 mm"):
        check_radius(run_out(PUBLISHED, 5.0), 1.960, 30.0)
    check_radius(run_out(PUBLISHED, 5.0), 1.975, 30.0)


@pytest.mark.parametrize(
    ("code", "driven"),
    [(CorrectionCode.M91, (0.01, 0.0)), (CorrectionCode.M92, (0.0, -0.02)), (CorrectionCode.M93, (0.01, -0.02))],
)
def test_each_code_drives_its_axes(code: CorrectionCode, driven: tuple[float, float]) -> None:
    assert RunOut(0.010, -0.020, 2.0).correction_mm(code) == pytest.approx(driven)


def test_a_bores_centre_is_half_the_travel_plus_the_run_out() -> None:
    """A bore of radius 10 about (50, 60), ball radius 2, ball 0.01 to the right of and 0.02 below the spindle axis."""
    x_mm = (50.0 - 8.0 - 0.010, 50.0 + 8.0 - 0.010)
    y_mm = (60.0 - 8.0 + 0.020, 60.0 + 8.0 + 0.020)
    centring = Centring(x_mm, y_mm, RunOut(0.010, -0.020, 2.0))
    assert centring.middle_mm == pytest.approx((49.990, 60.020))
    assert centring.centre_mm == pytest.approx((50.0, 60.0))
    assert centring.diameter_mm == pytest.approx(20.0)


def test_the_uncertainty_is_what_repeating_it_all_would_show() -> None:
    """2000 times three turns, each contact off by 0.5 µm at random: the spread of what comes out, and what each says of itself."""
    rng, sigma_mm = random.Random(7), 0.0005
    means_um, stated_um2 = [], []
    for _ in range(2000):
        turns = [FourFeeds(*(feed + rng.gauss(0.0, sigma_mm) for feed in vars(PUBLISHED).values())) for _ in range(3)]
        means_um.append(1000.0 * run_out(mean_feeds(turns), 5.0).x_mm)
        stated_um2.append((run_out_std_um(turns, 0.0) or 0.0) ** 2)
    spread_um = math.sqrt(sum((x_um - 10.0) ** 2 for x_um in means_um) / len(means_um))
    assert math.sqrt(sum(stated_um2) / len(stated_um2)) == pytest.approx(spread_um, rel=0.06)


def test_the_uncertainty_of_one_turn_is_not_known_and_of_equal_turns_is_that_of_the_step() -> None:
    assert run_out_std_um([PUBLISHED], 0.001) is None
    assert run_out_std_um([PUBLISHED] * 3, 0.001) == pytest.approx(1.0 / math.sqrt(12.0) / math.sqrt(2.0))
