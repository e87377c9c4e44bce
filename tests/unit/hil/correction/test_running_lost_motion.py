"""The running form over any sequence of strokes: continuous, bounded, and the published form after full strokes."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.wind_up import WindUp, moved_to, steepest_um_per_mm

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh, published_um

FORM = TwoTanh(amount_1_um=8.0, amount_2_um=4.0, rise_1_mm=0.5, rise_2_mm=2.0, onset_2_mm=1.0)

amounts = st.floats(0.0, 50.0)
rises = st.floats(0.01, 5.0)
forms = st.builds(TwoTanh, amounts, amounts, rises, rises, st.one_of(st.just(0.0), st.floats(0.0, 5.0)))
# on a grid, so that loops close exactly as well as being passed, and off it
steps = st.one_of(st.integers(-12, 12).map(lambda n: n / 4), st.floats(-8.0, 8.0))
paths = st.lists(steps, min_size=1, max_size=40)
directions = st.sampled_from([1, -1])


def run(form: TwoTanh, state: WindUp, travels: list[float]) -> tuple[WindUp, list[tuple[float, float]]]:
    """The state at the end and, at every set-point from the start on, (position, correction)."""
    course = [(state.position_mm, state.correction_um(form))]
    for travel in travels:
        state, correction = moved_to(form, state, state.position_mm + travel)
        course.append((state.position_mm, correction))
    return state, course


@settings(max_examples=50)
@given(forms, directions, paths)
def test_no_step_larger_than_slope_times_travel_and_never_beyond_its_ends(
    form: TwoTanh, direction: int, path: list[float]
) -> None:
    _, course = run(form, WindUp(0.0, direction), path)
    for (x0, c0), (x1, c1) in pairwise(course):
        assert abs(c1 - c0) <= steepest_um_per_mm(form) * abs(x1 - x0) + 1e-9
        assert (c1 - c0) * (x1 - x0) >= -1e-9  # it never runs against the motion
        assert -1e-9 <= c1 <= form.amount_um + 1e-9


@settings(max_examples=20)
@given(forms, directions, paths, st.integers(2, 7))
def test_how_a_motion_is_cut_into_set_points_makes_no_difference(
    form: TwoTanh, direction: int, path: list[float], parts: int
) -> None:
    state = cut = WindUp(0.0, direction)
    for travel in path:
        start = state.position_mm
        state, whole = moved_to(form, state, start + travel)
        for i in range(1, parts):
            cut, _ = moved_to(form, cut, start + travel * i / parts)
        cut, fine = moved_to(form, cut, state.position_mm)
        assert fine == pytest.approx(whole, abs=1e-9)


@settings(max_examples=20)
@given(forms, paths, directions, st.floats(0.0, 1.0))
def test_after_a_full_stroke_it_is_the_published_form_whatever_was_before(
    form: TwoTanh, path: list[float], direction: int, share: float
) -> None:
    full_mm = 25.0 * max(form.rise_1_mm, form.rise_2_mm) + form.onset_2_mm  # 1 - tanh 25 is below the last digit
    state, _ = run(form, WindUp(0.0, 1), path)
    state, _ = run(form, state, [400.0, -400.0 - full_mm] if direction > 0 else [-400.0, 400.0 + full_mm])
    at_turn = state.correction_um(form)
    travel_mm = share * 4.0 * max(form.rise_1_mm, form.rise_2_mm)
    _, running = moved_to(form, state, state.position_mm + direction * travel_mm)
    published = published_um(form, direction, travel_mm, 400.0 + full_mm, form.amount_um)
    assert running - at_turn == pytest.approx(published, abs=1e-8 + 1e-9 * form.amount_um)
    assert at_turn == pytest.approx(0.0 if direction > 0 else form.amount_um, abs=1e-8)


@settings(max_examples=20)
@given(forms, directions, paths, st.floats(0.01, 1.0), st.integers(1, 5))
def test_a_short_stroke_and_back_leaves_no_trace_however_often(
    form: TwoTanh, direction: int, path: list[float], share: float, times: int
) -> None:
    state, _ = run(form, WindUp(0.0, direction), path)
    there = state.position_mm
    open_mm = abs(there - state.turns_mm[-1]) if state.turns_mm else 8.0  # a longer one closes the loop it is in
    dip_mm = share * open_mm * 0.99
    back = state
    for _ in range(times):
        back, _ = moved_to(form, back, there - state.direction * dip_mm)
        back, _ = moved_to(form, back, there)
    assert back == state


def test_literal_course_with_a_partial_stroke_inside_a_partial_stroke() -> None:
    form = TwoTanh(10.0, 0.0, 1.0, 1.0)  # 10·tanh(travel)
    _, course = run(form, WindUp(0.0, -1), [2.0, -1.0, 0.5, -0.25, 0.25, 0.5, 1.0, -50.0])
    t = math.tanh
    assert [c for _, c in course] == pytest.approx(
        [
            0.0,
            10 * t(2),
            10 * t(2) - 10 * t(1),
            10 * t(2) - 10 * t(1) + 10 * t(0.5),
            10 * t(2) - 10 * t(1) + 10 * t(0.5) - 10 * t(0.25),
            10 * t(2) - 10 * t(1) + 10 * t(0.5),  # the inner loop closed
            10 * t(2),  # the outer one too
            10 * t(3),  # on along the first branch
            0.0,  # past the start: fully wound the other way
        ],
        abs=1e-12,
    )


def test_memory_is_of_open_loops_only() -> None:
    state, _ = run(FORM, WindUp(0.0, 1), [-1.0, 0.5, -0.25])
    assert len(state.turns_mm) == 3
    state, _ = moved_to(FORM, state, 7.0)
    assert state == WindUp(7.0, 1)
    state, _ = run(FORM, state, [-0.5, 0.5] * 1000)
    assert state == WindUp(7.0, 1)


def test_a_state_is_a_value() -> None:
    state = WindUp(0.0, 1)
    once, again = moved_to(FORM, state, -0.3), moved_to(FORM, state, -0.3)
    assert once == again
    assert moved_to(FORM, state, 0.0) == (state, 12.0)
    with pytest.raises(FrozenInstanceError):
        state.position_mm = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("direction", [0, 2])
def test_an_unknown_direction_of_arrival_is_refused(direction: int) -> None:
    with pytest.raises(InputError, match="direction of arrival"):
        WindUp(0.0, direction)


@pytest.mark.parametrize("position_mm", [math.nan, math.inf])
def test_a_set_point_that_is_no_place_is_refused(position_mm: float) -> None:
    with pytest.raises(InputError, match="finite position"):
        moved_to(FORM, WindUp(0.0, 1), position_mm)
