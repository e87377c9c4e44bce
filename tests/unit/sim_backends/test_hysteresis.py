"""Reversal: independent of how motion is cut, right amounts, and the torque that shows the break-away."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_backends.plant.hysteresis import Backlash, LostMotion, Reversal

STROKES = st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=8)


def table_mm(reversal: Reversal) -> float:
    return reversal.state.nut_mm - reversal.loss_um / 1000.0


def run(reversal: Reversal, places: list[float], cuts: int) -> None:
    at = reversal.state.motor_mm
    for place in places:
        for i in range(1, cuts):
            reversal.step(at + (place - at) * i / cuts)
        reversal.step(place)
        at = place


@given(STROKES, st.integers(2, 40))
def test_a_stroke_may_be_cut_as_one_likes(places: list[float], cuts: int) -> None:
    lost = LostMotion.spread(4, 3.0, 0.5)
    whole, cut = Reversal(Backlash(8.0), lost), Reversal(Backlash(8.0), lost)
    run(whole, places, 1)
    run(cut, places, cuts)
    assert table_mm(cut) == pytest.approx(table_mm(whole), abs=1e-12)
    assert cut.wind_up_ratio == pytest.approx(whole.wind_up_ratio, abs=1e-9)


@given(STROKES)
def test_the_table_never_leaves_the_band_of_its_two_sides(places: list[float]) -> None:
    reversal = Reversal(Backlash(8.0), LostMotion.spread(1, 3.0, 0.5))
    for place in places:
        reversal.step(place)
        assert abs(table_mm(reversal) - place) <= 0.0055 + 1e-12


def test_two_sides_are_apart_by_backlash_and_lost_motion() -> None:
    reversal = Reversal(Backlash(8.0), LostMotion.spread(1, 3.0, 0.5))
    run(reversal, [-10.0, 100.0], 1)
    forward = table_mm(reversal)
    run(reversal, [200.0, 100.0], 1)
    assert (forward - table_mm(reversal)) * 1000.0 == pytest.approx(
        -11.0
    )  # error = actual − commanded: − on the + side


def test_backlash_varies_along_the_axis() -> None:
    backlash = Backlash(10.0, slope=0.2, curve=0.5, middle_mm=250.0, half_travel_mm=250.0)
    assert [backlash.half_width_mm(x) * 2000.0 for x in (0.0, 250.0, 500.0)] == pytest.approx([13.0, 10.0, 17.0])


def test_lost_motion_builds_up_over_distance_half_of_it_early() -> None:
    lost = LostMotion.spread(3, 4.0, 0.5)
    assert lost.amount_um == pytest.approx(4.0)
    reversal = Reversal(Backlash(), lost)
    run(reversal, [-10.0, 10.0], 1)
    full = reversal.loss_um
    built = []
    for s in (0.05, 0.5, 1.0, 3.2):
        reversal.step(10.0 - s)
        built.append(full - reversal.loss_um)
    assert built == sorted(built)
    assert 0.35 * 4.0 < built[1] < 0.7 * 4.0
    assert built[-1] == pytest.approx(4.0)


def test_partial_stroke_does_not_forget_the_one_before() -> None:
    lost = LostMotion.spread(3, 4.0, 0.5)
    reversal = Reversal(Backlash(), lost)
    run(reversal, [-10.0, 10.0, 9.9], 1)
    after_short = reversal.loss_um
    run(reversal, [10.0, 9.9], 1)  # closed minor loop
    assert reversal.loss_um == pytest.approx(after_short)


def test_wind_up_falls_to_zero_and_peaks_where_the_table_breaks_away() -> None:
    """What makes backlash measurable by torque: |force| down, through 0, up, and most at the full lost motion."""
    reversal = Reversal(Backlash(50.0), LostMotion())
    run(reversal, [-1.0, 1.0], 1)
    forces = []
    for um in range(1, 101):
        reversal.step(1.0 - um / 1000.0)
        ratio = reversal.wind_up_ratio
        forces.append(abs(ratio) + 0.18 * ratio**4 * reversal.breakaway(0.02))
    assert min(range(100), key=lambda i: forces[i]) + 1 == 25
    assert max(range(100), key=lambda i: forces[i]) + 1 == 50
    assert forces[99] < forces[49]


def test_same_seed_same_machine() -> None:
    assert LostMotion.spread(5, 2.0, 0.4) == LostMotion.spread(5, 2.0, 0.4)
    assert LostMotion.spread(5, 2.0, 0.4) != LostMotion.spread(6, 2.0, 0.4)


def test_stribeck_winds_up_further_and_springs_back() -> None:
    """The lag is largest at the break-away and gone some travel later; cutting the motion changes nothing."""
    backlash = Backlash(20.0, stribeck=0.2, breakaway_mm=0.05)
    lags = {}
    for cuts in (1, 10):
        reversal = Reversal(backlash, LostMotion())
        run(reversal, [-5.0, 5.0], cuts)
        for um in (0, 10, 20, 70, 1000):
            run(reversal, [5.0 - um / 1000.0], cuts)
            lags[cuts, um] = reversal.overshoot_um
    assert [lags[1, um] for um in (10, 20, 70)] == pytest.approx([0.0, -2.0, -1.0], abs=1e-9)
    assert abs(lags[1, 0]) < 0.01
    assert abs(lags[1, 1000]) < 0.01
    assert [lags[10, um] for um in (0, 10, 20, 70, 1000)] == pytest.approx(
        [lags[1, um] for um in (0, 10, 20, 70, 1000)]
    )
