"""Lost motion with figures that follow on paper: the load's place under a rise, weights, uncertainties, the choice, the circle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.wind_up import WindUp, moved_to

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh
from hil.correction.rise import DEAD_ZONE, EXPONENTIAL, STRAIGHT_PIECES, TANH, TWO_TANH, Rise
from hil.correction.running_lost_motion import share_of, wound_share, wound_um
from hil.effects.history import remembered
from hil.lost_motion import estimate as choosing
from hil.lost_motion.at_load import (
    LengthBounds,
    StrokePositions,
    _Coordinates,
    fit_at_load,
    load_mm,
    standard_uncertainties,
)
from hil.lost_motion.circle.figures import Circle, Trace, ring_of, trace_of
from hil.lost_motion.estimate import ReversalFit, Uncertain, determined, separately_determined, uncertain
from hil.lost_motion.fit import Contender, Fitted, MeasuredReversal, compete, fit, length_bounds
from hil.lost_motion.published import beside_published

HALF = Rise(DEAD_ZONE, (1000.0,), (1.0,))
"""1000 µm over the load's first mm: until then the motor goes twice as far as the load."""


def test_the_load_under_a_rise_as_long_as_it_is_high() -> None:
    motor = np.array([0.0, 0.5, 1.0, 2.0, 3.0])
    assert load_mm(HALF, motor) == pytest.approx([0.0, 0.25, 0.5, 1.0, 2.0], abs=1e-9)
    places = StrokePositions(motor, np.array([0.0, 0.26, 0.5, 0.99, 2.0]), np.zeros(5, dtype=np.int64))
    assert places.residual_um(HALF) == pytest.approx([0.0, 10.0, 0.0, -10.0, 0.0], abs=1e-5)


@pytest.mark.parametrize(
    "rise",
    [
        Rise(TWO_TANH, (9.0, 5.0), (0.02, 0.3, 0.1)),
        Rise(EXPONENTIAL, (400.0,), (0.5,)),
        Rise(STRAIGHT_PIECES, tuple(float(1 + k % 3) for k in range(16)), tuple(0.15 * k for k in range(1, 17))),
    ],
    ids=lambda rise: rise.shape.name,
)
def test_slopes_are_those_of_the_loads_lag(rise: Rise) -> None:
    """Against differences of the load's place itself: a µm more of lag is a µm less of load."""
    reach = LengthBounds(0.002, 2.0, 1.5)
    coordinates = _Coordinates(rise, reach, 500.0)
    motor = np.array([0.011, 0.057, 0.19, 0.43, 1.13, 2.7])
    slopes = coordinates.slopes(coordinates.start, motor)
    for k in range(len(coordinates.start)):
        step = np.zeros(len(coordinates.start))
        step[k] = 1e-3
        ahead, behind = (load_mm(coordinates.rise(coordinates.start + way * step), motor) for way in (1, -1))
        assert slopes[:, k] == pytest.approx(-1000.0 * (ahead - behind) / 2e-3, rel=2e-2, abs=2e-4), k


def test_bounds_of_what_is_searched() -> None:
    reach = LengthBounds(0.002, 2.0, 1.5)
    searched = _Coordinates(Rise(TWO_TANH, (9.0, 5.0), (0.02, 0.3, 0.1)), reach, 500.0)
    assert searched.low == pytest.approx([0.0, 0.0, math.log(0.002), math.log(0.002), 0.0])
    assert searched.high == pytest.approx([500.0, 500.0, math.log(2.0), math.log(2.0), 1.5])
    assert searched.start == pytest.approx([9.0, 5.0, math.log(0.02), math.log(0.3), 0.1])
    assert searched.rise(searched.start).lengths_mm == pytest.approx((0.02, 0.3, 0.1))
    assert searched.free(searched.start).tolist() == [True] * 5
    at_low, at_high = searched.free(searched.low), searched.free(searched.high)
    assert not at_low.any()
    assert not at_high.any()
    for share, is_free in ((0.5e-4, False), (2e-4, True)):
        for near in (
            searched.low + share * (searched.high - searched.low),
            searched.high - share * (searched.high - searched.low),
        ):
            assert searched.free(near).tolist() == [is_free] * 5
    pieces = Rise(STRAIGHT_PIECES, (1.0,) * 16, tuple(0.1 * k for k in range(1, 17)))
    fixed = _Coordinates(pieces, reach, 500.0)
    assert len(fixed.start) == 16
    assert fixed.rise(fixed.start).lengths_mm == pieces.lengths_mm


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_a_search_begins_just_inside_its_bounds_however_narrow_they_are(scale: float) -> None:
    """A millionth of the range from the bound that a rise lies on or beyond."""
    beyond = Rise(TWO_TANH, (0.0, 1e6), (1e-9, 1e3, 0.0))
    searched = _Coordinates(beyond, LengthBounds(0.01 * scale, scale, 0.5 * scale), 50.0 * scale)
    share = (searched.start - searched.low) / (searched.high - searched.low)
    assert share == pytest.approx([1e-6, 1 - 1e-6, 1e-6, 1 - 1e-6, 1e-6], abs=1e-9)


@pytest.mark.parametrize(
    ("strokes_um", "std_um", "told"), [([1.0, -1.0, 0.0], 1 / math.sqrt(3), "20 ± 1.2"), ([1.0, -1.0], 1.0, "20 ± 2")]
)
def test_the_uncertainty_of_an_amount_is_that_of_the_mean_of_strokes(
    strokes_um: list[float], std_um: float, told: str
) -> None:
    """Beyond its length a dead zone of 20 µm shows its amount alone; strokes off by 1, -1 and 0 µm: s = 1, of the mean 1/√3; two that
    are off by 1 and -1 µm: s = √2, of the mean 1."""
    count = len(strokes_um)
    motor = np.tile([2.0, 3.0], count)
    off_um = np.repeat(strokes_um, 2)
    places = StrokePositions(motor, motor - (20.0 + off_um) / 1000.0, np.repeat(np.arange(count), 2))
    rise = Rise(DEAD_ZONE, (20.0,), (0.5,))
    whole, amounts, lengths = standard_uncertainties(rise, places, LengthBounds(0.01, 1.0, 1.0))
    assert whole == pytest.approx(std_um, rel=1e-4)
    assert amounts == pytest.approx([std_um], rel=1e-4)
    assert lengths == pytest.approx([0.0], abs=1e-6)
    fitted = fit_at_load(replace(rise, amounts_um=(15.0,)), places, LengthBounds(0.01, 1.0, 1.0))
    assert fitted.amount_um == pytest.approx(20.0, abs=1e-3)
    assert str(Uncertain(20.0, whole)) == told


def test_the_uncertainty_of_a_length() -> None:
    """Half of a dead zone of 20 µm over 0.5 mm: at the load's 0.25 mm the lag is 10 µm and falls by 20·0.25/0.5² = 20 µm per mm of
    length; the load gives way by 40 µm per mm, so its place is off by 20/1.04. Strokes ±0.1 mm and 0 in length: of the mean 0.1/√3.
    """
    motor = np.array([0.26, 2.0] * 3)
    off_um = np.array([-2.0 / 1.04, 0.0, 2.0 / 1.04, 0.0, 0.0, 0.0])  # a longer rise lags less there
    lag_um = np.array([10.0, 20.0] * 3) + off_um
    places = StrokePositions(motor, motor - lag_um / 1000.0, np.repeat([0, 1, 2], 2).astype(np.int64))
    whole, amounts, lengths = standard_uncertainties(
        Rise(DEAD_ZONE, (20.0,), (0.5,)), places, LengthBounds(0.01, 1.0, 1.0)
    )
    assert lengths == pytest.approx([0.1 / math.sqrt(3)], rel=1e-2)
    assert (whole, amounts[0]) == pytest.approx((0.0, 0.0), abs=1e-3)


TRAVEL = np.array([0.0, 0.010, 0.020, 0.040, 0.060, 0.080, 0.100, 0.120, 0.140, 0.160, 0.180, 0.200])


def stroke(direction: int = 1, lost_um: float = 10.0) -> MeasuredReversal:
    """The load stands for the first 10 µm and then follows: error -10 µm in the direction of motion, about 3 µm at the start."""
    risen = np.minimum(1000.0 * TRAVEL, lost_um)
    return MeasuredReversal(direction, TRAVEL, 3.0 - direction * risen)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_stroke_over_the_loads_own_travel(direction: int) -> None:
    one = stroke(direction)
    travel, risen = one.rise
    assert travel.tolist() == TRAVEL.tolist()
    assert risen == pytest.approx([0.0] + [10.0] * 11)
    load = one.by_load()
    assert load.travel_mm == pytest.approx(np.r_[0.0, TRAVEL[1:] - 0.010])
    assert load.over_load
    assert not one.over_load
    assert one.start_weights.tolist() == [1.0] * 12
    # the load stood over the first step and went one for one over every other: the smaller of both sides
    assert load.start_weights == pytest.approx([0.002, 0.002] + [1.0] * 10)
    half = replace(load, travel_mm=TRAVEL / 2.0, error_um=3.0 - direction * 500.0 * TRAVEL)
    assert half.start_weights == pytest.approx([0.5] * 12)


def test_what_is_a_stroke() -> None:
    with pytest.raises(InputError, match="9 rows within the stroke"):
        MeasuredReversal(1, TRAVEL, TRAVEL, stroke_mm=0.15)
    assert len(MeasuredReversal(1, TRAVEL, TRAVEL, stroke_mm=0.16).rise[0]) == 10
    for spoilt in (np.nan, np.inf):
        bad = TRAVEL.copy()
        bad[3] = spoilt
        for travel, error in ((bad, TRAVEL), (TRAVEL, bad)):
            with pytest.raises(InputError, match="finite"):
                MeasuredReversal(1, travel, error)
    standing = np.zeros(12)
    with pytest.raises(InputError, match="some travel"):
        MeasuredReversal(1, standing, standing)


def test_how_far_lengths_may_go() -> None:
    """A quarter of the travel and half of it; a two-hundredth at the least, or what is given, but half the longest at most."""
    assert length_bounds(12.0) == LengthBounds(0.06, 3.0, 6.0)
    assert length_bounds(12.0, 0.3) == LengthBounds(0.3, 3.0, 6.0)
    assert length_bounds(12.0, 2.0) == LengthBounds(1.5, 3.0, 6.0)


def test_a_fit_shows_what_a_stroke_is_expected_to_show() -> None:
    """20 µm over 0.5 mm and 2 µm per mm of a table that is off: at 0.25 mm 10.5, at 1 mm 22 µm."""
    fitted = Fitted(Rise(DEAD_ZONE, (20.0,), (0.5,)), 2.0)
    assert fitted.rise_um(np.array([0.25, 1.0])) == pytest.approx([10.5, 22.0])
    assert Fitted(fitted.rise).rise_um(np.array([0.25, 1.0])) == pytest.approx([10.0, 20.0])  # with no table's part
    travel = np.linspace(0.0, 4.0, 81)
    risen = fitted.rise_um(travel)
    for sign in (1.0, -1.0):
        error = -np.asarray(Fitted(fitted.rise, sign * 2.0).rise_um(travel))
        found = fit(DEAD_ZONE, [MeasuredReversal(1, travel, error)])
        assert found.table_um_per_mm == pytest.approx(sign * 2.0, abs=1e-4)
        assert found.rise.amounts_um == pytest.approx((20.0,), abs=1e-3)
        assert found.rise.lengths_mm == pytest.approx((0.5,), abs=1e-4)
    contenders = compete([MeasuredReversal(1, travel, -risen + np.r_[0.0, np.tile([0.1, -0.1], 40)])], 0.2, [DEAD_ZONE])
    assert contenders[0].rms_um == pytest.approx(0.1, rel=0.05)
    assert contenders[0].held_out_rms_um == pytest.approx(0.1, rel=0.1)


def test_blocks_of_a_single_stroke_are_held_out_by_fives() -> None:
    """Blocks of 0.2 mm over 4 mm: what a stroke shows in one block alone is seen by no fit that it is held against."""
    travel = np.linspace(0.0, 3.999, 400)
    bump = np.where((travel >= 2.0) & (travel < 2.2), 5.0, 0.0)
    flat = compete([MeasuredReversal(1, travel, -20.0 * np.minimum(travel / 0.5, 1.0) - bump)], 0.2, [STRAIGHT_PIECES])
    assert flat[0].held_out_rms_um > 5.0 * math.sqrt(20 / 400) * 0.9


def test_every_fifth_block_is_held_out_with_its_like() -> None:
    """One row in each block from the 11th to the 20th, beyond any length, so that a fit is the mean of what it sees: 30 µm in the 13th
    and 18th, else 20. Both held out: off by 10 µm; any other two: 22.5 µm is seen, off by 2.5 µm; the row at the start by nothing.
    """
    travel = np.r_[0.0, np.arange(2.1, 4.0, 0.2)]
    risen = np.r_[0.0, np.tile([20.0, 20.0, 30.0, 20.0, 20.0], 2)]
    (found,) = compete([MeasuredReversal(1, travel, -risen)], 0.2, [DEAD_ZONE], table=False)
    assert found.held_out_rms_um == pytest.approx(math.sqrt((2 * 10.0**2 + 8 * 2.5**2) / 11))
    assert found.rms_um == pytest.approx(math.sqrt((2 * 8.0**2 + 8 * 2.0**2) / 11))


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-5])
def test_a_rise_is_found_on_any_scale(scale: float) -> None:
    """A length of 0.5 and an onset of 1 in 4 of travel: mm, or µm of a short stroke."""
    travel = np.linspace(0.0, 4.0, 81)
    for truth in (Rise(DEAD_ZONE, (20.0,), (0.5,)), Rise(TWO_TANH, (8.0, 4.0), (0.3, 0.4, 1.0))):
        found = fit(truth.shape, [MeasuredReversal(1, travel * scale, -truth.along_um(travel))], table=False).rise
        assert found.amounts_um == pytest.approx(truth.amounts_um, rel=1e-3)
        assert np.array(found.lengths_mm) / scale == pytest.approx(truth.lengths_mm, rel=1e-3)


def test_single_amounts_stand_for_themselves_from_two_of_their_uncertainties_on() -> None:
    whole = {"amount_um": Uncertain(10.0, 0.1)}
    lengths = {"rise_1_mm": Uncertain(0.5, 0.2), "rise_2_mm": Uncertain(0.5, 0.3), "onset_2_mm": Uncertain(0.0, 0.0)}
    for std, sure in ((2.4, True), (2.6, False)):
        both = whole | {"amount_1_um": Uncertain(5.0, 0.1), "amount_2_um": Uncertain(5.0, std)} | lengths
        assert separately_determined(both) is sure
        assert set(determined(both)) == (set(both) if sure else {"amount_um", "rise_1_mm"})
    for value, there in ((0.011, True), (0.009, False)):  # a thousandth of 10 µm
        both = whole | {"amount_1_um": Uncertain(5.0, 0.1), "amount_2_um": Uncertain(value, 1e-6)}
        assert separately_determined(both) is there
    assert separately_determined(whole)
    at_a_bound = whole | {"amount_1_um": Uncertain(0.0, 1.0), "rise_1_mm": Uncertain(0.5, 0.0)}
    assert set(determined(at_a_bound)) == {"amount_um"}  # a length at a bound has an uncertainty of 0: of none


def made_estimate(late_um: float) -> ReversalFit:
    parameters = {"amount_um": Uncertain(10.0, 0.1), "rise_1_mm": Uncertain(0.5, 0.2)}
    return ReversalFit(Rise(TANH, (10.0,), (0.5,)), parameters, parameters, (), (), late_um)


def test_strokes_were_too_short_where_more_than_3_percent_came_late() -> None:
    assert not made_estimate(0.29).still_rising
    assert made_estimate(0.31).still_rising
    nothing = replace(made_estimate(0.0), rise=Rise(TANH, (0.0,), (0.5,)))
    assert not nothing.still_rising
    plain = made_estimate(0.0).to_json()
    assert plain["asked_for"] is False
    assert plain["amount_um"] == 10.0
    assert plain["parameters"]["rise_1_mm"] == {"value": 0.5, "std": 0.2}
    assert plain["determined"] == ["amount_um", "rise_1_mm"]


def test_each_parameter_has_its_own_uncertainty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choosing, "uncertainties", lambda *_: (0.1, [0.2, 0.3], [0.4, 0.5, 0.6]))
    assert uncertain(Rise(TWO_TANH, (6.0, 4.0), (1.0, 2.0, 3.0)), [], 0.001) == {
        "amount_um": Uncertain(10.0, 0.1),
        "amount_1_um": Uncertain(6.0, 0.2),
        "amount_2_um": Uncertain(4.0, 0.3),
        "rise_1_mm": Uncertain(1.0, 0.4),
        "rise_2_mm": Uncertain(2.0, 0.5),
        "onset_2_mm": Uncertain(3.0, 0.6),
    }


TEN = TwoTanh(10.0, 0.0, 1.0, 1.0)


def test_shares_of_the_wind_up() -> None:
    """10·tanh: after a full stroke in + 10 µm, a mm back 10 - 7.61594; half a mm up again + 4.62117."""
    assert wound_um(TEN, 5.0, 1, ()) == 10.0
    assert wound_um(TEN, 5.0, -1, ()) == 0.0
    assert wound_um(TEN, 4.0, -1, (5.0,)) == pytest.approx(2.3840584)
    assert wound_um(TEN, 4.5, 1, (5.0, 4.0)) == pytest.approx(7.0052300)
    assert wound_share(TEN, 4.5, 1, (5.0, 4.0)) == pytest.approx(0.70052300)
    assert (share_of(10.5, 10.0), share_of(-0.5, 10.0)) == (1.0, 0.0)
    nothing = TwoTanh(0.0, 0.0, 1.0, 1.0)
    assert (wound_share(nothing, 4.5, 1, ()), wound_share(nothing, 4.5, -1, ())) == (1.0, 0.0)
    tiny = TwoTanh(1e-8, 0.0, 1.0, 1.0)
    assert wound_share(tiny, 4.0, -1, (5.0,)) == pytest.approx(0.23840584)


def test_which_turns_are_remembered() -> None:
    assert remembered((), 5.0, 1, 7.0) == ()
    assert remembered((), 5.0, 1, 4.0) == (5.0,)
    assert remembered((5.0,), 4.0, -1, 4.5) == (5.0, 4.0)
    assert remembered((5.0, 4.0), 4.5, 1, 5.0) == ()  # back at the place of the turn before last: the loop is closed
    assert remembered((5.0, 4.0), 4.5, 1, 4.999) == (5.0, 4.0)
    assert remembered((5.0, 4.0, 4.5), 4.2, -1, 3.9) == (5.0,)
    state = WindUp(4.0, -1, (5.0,))
    assert moved_to(TEN, state, 4.0) == (state, pytest.approx(2.3840584))


def test_places_on_the_circle() -> None:
    """It begins 30° before -60°, at the lowest point (clockwise at the highest), and has been a quarter round after r·π/2."""
    for centre, sense, start, quarter, setting_off in (
        ((100.0, 50.0), 1, (100.0, 40.0), (110.0, 50.0), (1, 1)),
        ((100.0, 50.0), -1, (100.0, 60.0), (110.0, 50.0), (1, -1)),
        ((-80.0, 50.0), 1, (-80.0, 40.0), (-70.0, 50.0), (1, 1)),
    ):
        circle = Circle(centre, sense=sense)
        assert circle.at(0.0) == pytest.approx(start)
        assert circle.at(5.0 * math.pi) == pytest.approx(quarter)
        assert circle.starting() == setting_off
    plain = Circle((0.0, 0.0))
    assert (plain.radius_mm, plain.feed_mm_s, plain.sense, plain.ramp_mm_s2) == (
        10.0,
        pytest.approx(1.6666667),
        1,
        20.0,
    )


def test_the_time_of_the_circle() -> None:
    """420° of r 10: 73.3038 mm at 10 mm/s, 7.33038 s and 10/20 s for both ramps; after 0.1 s 0.1 mm at 2 mm/s."""
    circle = Circle((0.0, 0.0), feed_mm_s=10.0)
    assert circle.length_mm == pytest.approx(73.303829)
    assert circle.duration_s == pytest.approx(7.8303829)
    course = list(circle.path(0.1))
    assert len(course) == 79
    way = [0.1, 0.4, 0.9, 1.6, 2.5, 3.5]  # ½·20·t² up to 10 mm/s at 0.5 s, then 1 mm in each 0.1 s
    for (place, feed), at_mm, speed in zip(course, way, (2.0, 4.0, 6.0, 8.0, 10.0, 10.0), strict=False):
        assert place == pytest.approx(circle.at(at_mm))
        assert feed == pytest.approx(speed)
    left_s = 7.8303829 - 7.8
    place, feed = course[77]
    assert place == pytest.approx(circle.at(73.303829 - 10.0 * left_s**2), abs=1e-6)
    assert feed == pytest.approx(20.0 * left_s, abs=1e-5)
    assert course[78] == (pytest.approx(circle.at(73.303829)), pytest.approx(0.0, abs=1e-6))
    # the feed may be reached over half of the 30° before the turn: ½ f²/20 ≤ 5.23599/2, f ≤ 10.2333 mm/s
    Circle((0.0, 0.0), feed_mm_s=10.23)
    with pytest.raises(InputError, match="to be reached"):
        Circle((0.0, 0.0), feed_mm_s=10.24)
    with pytest.raises(InputError, match="circle of"):
        Circle((0.0, 0.0), ramp_mm_s2=0.0)


ANGLES = np.arange(-60.0, 300.01, 0.5)


def bumped(at_deg: float, deviation: dict[float, float], slope: float = 0.25) -> Trace:
    """Deviation 1 + slope·past, and more at some angles past `at_deg`."""
    past = ANGLES - at_deg
    return Trace(ANGLES, 1.0 + slope * past + np.array([deviation.get(float(p), 0.0) for p in past]))


def test_a_bump_is_over_the_straight_line_before_it() -> None:
    """12 to 1° before the quadrant make the line, up to 10° after it the bump is looked for, whichever way it goes."""
    assert bumped(90.0, {}).bump_um(90.0) == pytest.approx(0.0, abs=1e-9)
    for past, height in ((0.0, 7.0), (4.0, 7.0), (10.0, 7.0), (4.0, -7.0)):
        assert bumped(90.0, {past: height}).bump_um(90.0) == pytest.approx(7.0), past
    for past in (-12.5, -0.5, 10.5):
        assert bumped(90.0, {past: 7.0}).bump_um(90.0) == pytest.approx(0.0, abs=1e-9), past
    for past in (-12.0, -1.0):
        assert bumped(90.0, {past: 7.0}).bump_um(90.0) > 0.5, past
    # of 315° there are no 10° behind it on this turn, but on the one before
    assert bumped(-45.0, {3.0: 5.0}).bump_um(315.0) == pytest.approx(5.0)
    both = bumped(0.0, {2.0: 8.0}).bumps_um
    assert both == pytest.approx((8.0, 0.0, 0.0, 0.0), abs=1e-9)
    assert bumped(0.0, {2.0: 8.0}).bump_mean_um == pytest.approx(2.0)
    assert bumped(135.0, {2.0: 8.0}).floor_um == pytest.approx(2.0)
    assert bumped(0.0, {2.0: 8.0}, 0.0).roundness_um == pytest.approx(8.0)


@pytest.mark.parametrize("quadrant", range(4))
def test_the_bumps_are_those_from_the_quadrants_on(quadrant: int) -> None:
    """A sample at 0, 90, 180 or 270° itself is the first after the reversal, and none of those before it."""
    bumps = bumped(90.0 * quadrant, {0.0: 8.0}).bumps_um
    assert bumps[quadrant] == pytest.approx(8.0)
    assert sum(bumps) == pytest.approx(8.0, abs=1e-9)


@pytest.mark.parametrize("between_deg", [45.0, 135.0, 225.0, -45.0])
def test_the_floor_is_from_half_way_between_the_quadrants_on(between_deg: float) -> None:
    """8 µm in one of the four places: 2 µm in the mean. 315° is looked for 45° before 0."""
    assert bumped(between_deg, {0.0: 8.0}).floor_um == pytest.approx(2.0)
    assert bumped(between_deg, {10.0: 8.0}).floor_um == pytest.approx(2.0)


def test_the_line_before_a_quadrant_is_straight() -> None:
    """Deviation 0.01·p² of p degrees past 90. Through p² at -12, -11.5 … -1 the line of least squares is -13·p - 31.25 (mean -6.5, of
    the squares 53.25): at 10° it is -161.25, and 261.25 below the parabola.
    """
    trace = Trace(ANGLES, 0.01 * (ANGLES - 90.0) ** 2)
    assert trace.bump_um(90.0) == pytest.approx(2.6125)


def test_five_samples_on_either_side_will_do() -> None:
    for first, last, good in ((-5.0, 4.0, True), (-4.0, 4.0, False), (-5.0, 3.0, False)):
        angles = np.arange(first, last + 0.1)
        trace = Trace(angles, np.zeros(len(angles)))
        if good:
            assert trace.bump_um(0.0) == 0.0
        else:
            with pytest.raises(InputError, match="no samples around 0"):
                trace.bump_um(0.0)


def test_the_turn_is_taken_from_minus_60_degrees() -> None:
    """A circle 5 µm too large about a centre that is (30, -20) µm off, driven over all 420°."""
    for sense in (1, -1):
        circle = Circle((100.0, 50.0), sense=sense)
        along = np.radians(-90.0 + np.linspace(0.0, 420.0, 4201))
        trace = trace_of(100.03 + 10.005 * np.cos(along), 49.98 + sense * 10.005 * np.sin(along), circle)
        assert trace.deviation_um == pytest.approx(5.0, abs=0.1)
        assert (trace.angle_deg[0], trace.angle_deg[-1]) == (
            pytest.approx(-60.0, abs=0.4),
            pytest.approx(300.0, abs=0.4),
        )
        assert len(trace.angle_deg) == pytest.approx(3601, abs=2)


@pytest.mark.parametrize(
    ("largest_um", "ring_um"),
    [
        (4.0, 1.0),
        (7.0, 2.0),
        (8.0, 2.0),
        (8.1, 5.0),
        (-20.0, 5.0),
        (30.0, 10.0),
        (0.9, 0.5),
        (0.0, 0.005),
        (400.0, 100.0),
    ],
)
def test_some_four_rings_to_the_largest_deviation(largest_um: float, ring_um: float) -> None:
    assert ring_of([Trace(ANGLES[:2], np.array([0.0, largest_um]))]) == pytest.approx(ring_um)


def test_a_ring_without_any_trace() -> None:
    assert ring_of([]) == pytest.approx(0.5)


def chosen(rise: Rise, *others: Contender, asked_for: bool = False) -> ReversalFit:
    parameters = {"amount_um": Uncertain(10.0, 0.1)}
    contenders = (Contender(Fitted(rise), 0.2, 0.2), *others)
    return ReversalFit(rise, parameters, parameters, contenders, (), 0.0, asked_for)


def test_both_forms_agree_after_full_strokes_and_part_after_partial_ones() -> None:
    found = chosen(Rise(TWO_TANH, (8.0, 4.0), (0.05, 0.2, 0.1)))
    full = beside_published(found, [0.0, 9.0, 0.0, 0.03, 9.0])
    assert full.apart_um == pytest.approx(0.0, abs=1e-9)
    assert full.step_um == 0.0
    # up 9, back 0.03: 8·tanh 0.6; up again 0.01: P of |Pbm| = 4.296 in branch 2, x't = 0.01·(0.1/0.03)
    part = beside_published(found, [0.0, 9.0, 8.97, 8.98])
    published = (8.0 * math.tanh(0.6) - 4.0) * math.tanh(0.01 * (0.1 / 0.03) / 0.05)
    assert part.moves[-1].published_um == pytest.approx(published)
    assert part.running_um[-1] == pytest.approx(8.0 * math.tanh(0.2))
    assert part.apart_um == pytest.approx(8.0 * math.tanh(0.2) - published)
    step = beside_published(found, [0.0, 9.0, 8.99, 9.0])  # 8·tanh 0.2 = 1.579 is below Pc2: 12 - 1.579 at once
    assert step.step_um == pytest.approx(12.0 - 8.0 * math.tanh(0.2))
    assert step.to_json()["parameters"] == {"Pc1_um": 8.0, "Pc2_um": 4.0, "a1_mm": 0.05, "a2_mm": 0.2, "b2_mm": 0.1}


def test_by_how_much_a_shape_wins_is_told() -> None:
    pieces = Rise(STRAIGHT_PIECES, (1.0,) * 16, tuple(0.01 * k for k in range(1, 17)))
    two = Contender(Fitted(Rise(TWO_TANH, (6.0, 4.0), (0.02, 0.04, 0.01))), 0.3, 0.3)
    other = Contender(Fitted(Rise(TANH, (10.0,), (0.02,))), 0.25, 0.25)
    told = "straight pieces taken: 0.200 µm RMS on strokes held out, two tanh 0.300 (+50 %)"
    assert chosen(pieces, other, two).choice == told
    exact = Contender(Fitted(pieces), 0.0, 0.0)
    told = "straight pieces taken: 0.000 µm RMS on strokes held out, two tanh 0.300"
    assert ReversalFit(pieces, {}, {}, (exact, two), (), 0.0).choice == told  # no share of nothing
    asked = ReversalFit(two.fitted.rise, {}, {}, (Contender(Fitted(pieces), 0.2, 0.2), other, two), (), 0.0, True)
    assert asked.choice == "two tanh asked for: 0.300 µm RMS on strokes held out, straight pieces 0.200 (-33 %)"
