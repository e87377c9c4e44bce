"""Every branch of the published form, against values worked out by hand from tanh(0.5), tanh(1) and tanh(2)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.wind_up import steepest_um_per_mm

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh, published_moves, published_um

FORM = TwoTanh(amount_1_um=8.0, amount_2_um=4.0, rise_1_mm=0.5, rise_2_mm=2.0, onset_2_mm=1.0)
AT_ONCE = TwoTanh(amount_1_um=8.0, amount_2_um=4.0, rise_1_mm=0.5, rise_2_mm=2.0)
LATE = TwoTanh(amount_1_um=1.0, amount_2_um=900.0, rise_1_mm=0.001, rise_2_mm=0.5, onset_2_mm=5.0)
"""The second term begins 5000 lengths of the first after it."""
# tanh 0.5 = 0.46211715726, tanh 1 = 0.76159415596, tanh 2 = 0.96402758008, tanh 4 = 0.99932929974


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(
    ("form", "before", "expected_um"),  # before: travel since the reversal, stroke, mm, last correction, µm
    [
        # |Pbm| > Pc2, before the second term: (12 - 4)·tanh(0.5/0.5)
        (FORM, (0.5, 5.0, 12.0), 6.09275324765),
        # on its onset, x't = b2: it has not begun, 8·tanh(2)
        (FORM, (1.0, 5.0, 12.0), 7.71222064062),
        # beyond it: 8·tanh(4) + 4·tanh(1/2)
        (FORM, (2.0, 5.0, 12.0), 9.84310302698),
        # a last correction between Pc2 and Pc1 + Pc2: (10 - 4)·tanh(4) + 4·tanh(1/2)
        (FORM, (2.0, 5.0, 10.0), 7.84444442750),
        # stroke as long as b2: not scaled, 8·tanh(1)
        (FORM, (0.5, 1.0, 12.0), 6.09275324765),
        # stroke of half b2: x't = 2·0.5 = 1, 8·tanh(2)
        (FORM, (0.5, 0.5, 12.0), 7.71222064062),
        # the same, beyond the onset: x't = 2·1 = 2, 8·tanh(4) + 4·tanh(1/2)
        (FORM, (1.0, 0.5, 12.0), 9.84310302698),
        # |Pbm| < Pc2: (8 + 4 - 3) + 3·tanh(2/2)
        (FORM, (2.0, 5.0, 3.0), 11.28478246788),
        # the same, scaled: x't = 2·0.5 = 1, 9 + 3·tanh(1/2)
        (FORM, (0.5, 0.5, 3.0), 10.38635147178),
        # b2 = 0 never scales, whatever the stroke: 9 + 3·tanh(1), 8·tanh(1) + 4·tanh(0.5/2)
        (AT_ONCE, (2.0, 0.01, 3.0), 11.28478246788),
        (AT_ONCE, (1.0, 0.01, 12.0), 7.71222064062 + 1.84846862904),
        # |Pbm| = Pc2 is of the second branch: 0 + 4·tanh(1/2)
        (FORM, (2.0, 5.0, 4.0), 1.84846862904),
        # nothing wound up before: all at once
        (FORM, (0.0, 5.0, 0.0), 12.0),
        (FORM, (0.0, 5.0, 12.0), 0.0),
    ],
)
def test_literal_values(form: TwoTanh, direction: int, before: tuple[float, float, float], expected_um: float) -> None:
    travel_mm, stroke_mm, last_um = before
    found = published_um(form, direction, travel_mm, stroke_mm, last_um)
    assert found == pytest.approx(direction * expected_um, abs=2e-10)
    # of the last correction only the magnitude counts
    assert published_um(form, direction, travel_mm, stroke_mm, -last_um) == found


def test_the_ends_of_the_two_branches_differ_as_the_source_has_it() -> None:
    assert published_um(FORM, 1, 1e3, 5.0, 3.999) == pytest.approx(12.0)
    assert published_um(FORM, 1, 1e3, 5.0, 10.0) == pytest.approx(10.0)


def test_after_one_partial_stroke_full_strokes_stay_short_for_good() -> None:
    """Why nothing runs by it: the second branch ends at |Pbm|, so what a partial stroke lacks never comes back."""
    partial, *full = published_moves(FORM, 0.0, -1, [0.8, -50.0, 50.0, -50.0, 50.0])
    assert FORM.amount_2_um < partial.published_um < 0.9 * FORM.amount_um
    assert [abs(move.published_um) for move in full] == pytest.approx([partial.published_um] * 4)


def test_moves_carry_the_last_correction_and_the_last_stroke_by_hand() -> None:
    """6 mm up: 8·tanh 12 + 4·tanh 2.5 = 11.946457; back 0.5: (11.946457 - 4)·tanh 1 = 6.051975; up after 0.5 mm, half of b2,
    x't = 0.2: 2.051975·tanh 0.4 = 0.779646; that is below Pc2, and x't = 0.05·10: 12 - 0.779646 + 0.779646·tanh 0.25 = 11.411304.
    """
    moves = published_moves(FORM, 0.0, -1, [-1.0, 5.0, 5.0, 4.5, 4.6, 4.55])
    expected = [-12.0, 11.946457, -6.051975, 0.779646, -11.411304]
    assert [move.published_um for move in moves] == pytest.approx(expected, abs=2e-6)
    assert [move.branch for move in moves] == [2, 2, 2, 2, 1]
    assert [move.stroke_mm for move in moves] == pytest.approx([math.inf, math.inf, 6.0, 0.5, 0.1])
    assert [move.start_um for move in moves[1:]] == pytest.approx([0.0, 0.0, 0.0, -11.220354], abs=2e-6)


def test_moves_of_a_form_whose_first_amount_is_0() -> None:
    """After a full stroke |Pbm| = Pc2, which is of the second branch: 4·tanh(1/2) a mm beyond the onset, and nothing at once."""
    (move,) = published_moves(TwoTanh(0.0, 4.0, 0.5, 2.0, 1.0), 0.0, 1, [-2.0])
    assert (move.branch, move.start_um) == (2, 0.0)
    assert move.published_um == pytest.approx(-1.84846862904, abs=2e-10)


def test_after_a_full_stroke_it_is_the_whole_rise() -> None:
    for travel_mm in np.linspace(0.0, 9.0, 31).tolist():
        assert published_um(FORM, 1, travel_mm, 50.0, 12.0) == pytest.approx(FORM.risen_um(travel_mm), abs=1e-12)


@pytest.mark.parametrize("form", [FORM, AT_ONCE, TwoTanh(1.0, 9.0, 3.0, 0.5, 2.0), TwoTanh(9.0, 0.0, 0.5, 1.0), LATE])
def test_the_steepest_slope_is_reached_and_not_exceeded(form: TwoTanh) -> None:
    travels = np.arange(0.0, 6.0, 1e-4)
    slopes = np.diff([form.risen_um(float(s)) for s in travels]) / 1e-4
    assert 0.995 * steepest_um_per_mm(form) < slopes.max() <= steepest_um_per_mm(form) * (1 + 1e-9)


@pytest.mark.parametrize(
    ("direction", "travel_mm", "stroke_mm", "last_um", "message"),
    [
        (0, 1.0, 5.0, 12.0, "direction is 0"),
        (1, -0.1, 5.0, 12.0, "travel -0.1 mm"),
        (1, math.nan, 5.0, 12.0, "travel nan mm"),
        (1, 1.0, -5.0, 12.0, "stroke -5.0 mm"),
        (1, 1.0, 5.0, math.inf, "last correction inf"),
        (1, 1.0, 0.0, 12.0, "no reversal"),
    ],
)
def test_refusals(direction: int, travel_mm: float, stroke_mm: float, last_um: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        published_um(FORM, direction, travel_mm, stroke_mm, last_um)


@pytest.mark.parametrize(
    "values", [(-1.0, 4.0, 1.0, 1.0, 0.0), (8.0, 4.0, 0.0, 1.0, 0.0), (8.0, 4.0, 1.0, 1.0, math.nan)]
)
def test_parameters_that_mean_nothing_are_refused(values: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="expected a finite number"):
        TwoTanh(*values)


def test_what_a_parameter_may_be_is_said() -> None:
    with pytest.raises(InputError, match=r"rise_2_mm is 0, expected a finite number > 0"):
        TwoTanh(1.0, 1.0, 0.1, 0.0)
    with pytest.raises(InputError, match=r"amount_2_um is -1, expected a finite number ≥ 0"):
        TwoTanh(1.0, -1.0, 0.1, 0.1)
