"""A rise fitted by where the load is: known machines come back, also one that sticks; and the stated uncertainty is the scatter's."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import InputError
from hil.correction.rise import DEAD_ZONE, EXPONENTIAL, STRAIGHT_PIECES, TANH, TWO_TANH, Floats, Rise
from hil.lost_motion.at_load import LengthBounds, StrokePositions, fit_at_load, load_mm
from hil.lost_motion.estimate import ReversalFit, determined, estimate, separately_determined, uncertain
from hil.lost_motion.fit import Contender, Fitted, MeasuredReversal, fit, uncertainties

MOTOR_MM = np.concatenate([[0.0], np.geomspace(0.002, 3.0, 24)])
STICKS_UM = 40.0


def reversal_of(load: Floats, seed: int, direction: int = 1, noise_um: float = 0.05) -> MeasuredReversal:
    """A stroke in which the load was there after `MOTOR_MM` of the motor, and noise."""
    noise = np.random.default_rng(seed).normal(0.0, noise_um, len(load))
    noise[0] = 0.0
    return MeasuredReversal(direction, MOTOR_MM, direction * 1000.0 * (load - MOTOR_MM) + noise)


def test_the_load_stands_still_while_a_steep_rise_is_used_up() -> None:
    rise = Rise(DEAD_ZONE, (STICKS_UM,), (1e-4,))
    found = load_mm(rise, np.array([0.0, 0.020, 0.0402, 0.140]))
    # 1/401 of the motor's travel until 0.1 µm of its own; then one for one
    assert found == pytest.approx([0.0, 0.020 / 401.0, 0.0002, 0.100], abs=2e-6)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_load_that_sticks_and_then_follows(direction: int) -> None:
    """No form of ours: the table stands until the motor has gone 40 µm."""
    stuck = np.maximum(MOTOR_MM - STICKS_UM / 1000.0, 0.0)
    by_load = [reversal_of(stuck, seed, direction).by_load() for seed in (1, 2, 3)]
    rise = fit(TWO_TANH, by_load, 0.00025, table=False).rise
    assert rise.amount_um == pytest.approx(STICKS_UM, abs=0.05)
    assert rise.risen_um(0.001) > 0.99 * STICKS_UM  # in full at once, as far as the shortest rise lets it
    left_um = 1000.0 * (load_mm(rise, MOTOR_MM) - stuck)
    assert np.max(np.abs(left_um)) < 0.5


def test_a_smooth_rise_over_the_loads_travel_comes_back() -> None:
    truth = Rise(TWO_TANH, (9.0, 5.0), (0.02, 0.3, 0.1))
    by_load = [reversal_of(load_mm(truth, MOTOR_MM), seed, noise_um=0.01).by_load() for seed in (1, 2, 3)]
    rise = fit(TWO_TANH, by_load, 0.00025, table=False).rise
    assert rise.amounts_um == pytest.approx(truth.amounts_um, abs=0.1)
    assert rise.lengths_mm == pytest.approx(truth.lengths_mm, rel=0.06)


@pytest.mark.outside
def test_the_stated_uncertainty_is_that_of_measuring_again() -> None:
    """Strokes that differ as wholes, as a machine's do: the amount of each is off by a micrometre. 40 measurements of 8 strokes."""
    amounts, stated = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        strokes = []
        for number in range(8):
            load = load_mm(Rise(TANH, (20.0 + rng.normal(0.0, 1.0),), (0.05,)), MOTOR_MM)
            strokes.append(reversal_of(load, 100 * seed + number).by_load())
        rise = fit(TANH, strokes, 0.001, table=False).rise
        amounts.append(rise.amount_um)
        stated.append(uncertainties(rise, strokes, 0.001)[0])
    assert np.mean(amounts) == pytest.approx(20.0, abs=0.2)
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(np.std(amounts, ddof=1), rel=0.35)


@pytest.mark.outside
def test_the_shape_that_is_true_is_chosen_and_strokes_that_were_too_short_are_told() -> None:
    def strokes(truth: Rise) -> list[MeasuredReversal]:
        return [reversal_of(load_mm(truth, MOTOR_MM), seed, 1 - 2 * (seed % 2)) for seed in range(4)]

    smooth = estimate(strokes(Rise(TWO_TANH, (9.0, 5.0), (0.02, 0.3, 0.1))), 0.00025)
    assert smooth.rise.shape is TWO_TANH
    assert not smooth.still_rising
    assert smooth.parameters is smooth.published
    assert set(smooth.parameters) == {
        *("amount_um", "amount_1_um", "amount_2_um", "rise_1_mm", "rise_2_mm", "onset_2_mm")
    }
    assert estimate(strokes(Rise(TANH, (9.0,), (2.5,))), 0.00025).still_rising


def test_where_one_term_would_do_the_sum_is_told_and_not_the_amounts_that_share_it() -> None:
    """One tanh measured twice: how two terms share it changes from one time to the next, what they come to does not."""
    firsts, wholes = [], []
    load = load_mm(Rise(TANH, (53.0,), (0.02,)), MOTOR_MM)
    for seed in (0, 10):
        by_load = [reversal_of(load, seed + k).by_load() for k in range(3)]
        parameters = uncertain(fit(TWO_TANH, by_load, 0.00025, table=False).rise, by_load, 0.00025)
        assert not separately_determined(parameters)
        shown = determined(parameters)
        assert not {"amount_1_um", "amount_2_um"} & set(shown)
        assert shown["amount_um"].value == pytest.approx(53.0, abs=0.05)
        assert all(each.value > 2.0 * each.std for each in shown.values())
        firsts.append(parameters["amount_1_um"].value)
        wholes.append(shown["amount_um"].value)
    assert np.ptp(firsts) > 20.0 * np.ptp(wholes)


def test_two_terms_that_are_there_are_told_one_by_one() -> None:
    truth = Rise(TWO_TANH, (9.0, 5.0), (0.02, 0.3, 0.1))
    by_load = [reversal_of(load_mm(truth, MOTOR_MM), seed).by_load() for seed in range(4)]
    parameters = uncertain(fit(TWO_TANH, by_load, 0.00025, table=False).rise, by_load, 0.00025)
    assert separately_determined(parameters)
    assert determined(parameters) == parameters
    one = Rise(TANH, (9.0,), (0.02,))
    assert separately_determined(uncertain(one, by_load, 0.00025))


@pytest.mark.parametrize("amount_um", [0.0, 30.0, 1e6])
@pytest.mark.parametrize("length_mm", [0.0005, 0.001, 0.05, 3.0])
def test_a_search_may_begin_at_a_bound_of_it(amount_um: float, length_mm: float) -> None:
    bounds, stroke = LengthBounds(0.001, 3.0, 1.0), np.zeros(len(MOTOR_MM), dtype=np.int64)
    places = StrokePositions(MOTOR_MM, load_mm(Rise(TANH, (9.0,), (0.05,)), MOTOR_MM), stroke)
    found = fit_at_load(Rise(TANH, (amount_um,), (length_mm,)), places, bounds)
    assert (*found.amounts_um, *found.lengths_mm) == pytest.approx((9.0, 0.05), rel=1e-6)


def test_an_amount_is_searched_up_to_twice_the_largest_lag() -> None:
    """A lag in proportion to the travel, up to 40 µm, which any amount over a length to match explains: 80 µm at the most."""
    motor = np.linspace(0.0, 0.2, 30)
    places = StrokePositions(motor, 0.8 * motor, np.zeros(len(motor), dtype=np.int64))
    found = fit_at_load(Rise(TANH, (5.0,), (0.05,)), places, LengthBounds(0.001, 3.0, 1.0))
    assert found.amount_um == pytest.approx(80.0, abs=0.5)


def test_a_load_that_follows_at_once_has_no_rise() -> None:
    places = StrokePositions(MOTOR_MM, MOTOR_MM, np.zeros(len(MOTOR_MM), dtype=np.int64))
    found = fit_at_load(Rise(TANH, (5.0,), (0.05,)), places, LengthBounds(0.001, 3.0, 1.0))
    assert found.amount_um == pytest.approx(0.0, abs=1e-3)


TANH_RISE, TWO_RISE, EXP_RISE = (
    Rise(TANH, (9.0,), (0.1,)),
    Rise(TWO_TANH, (6.0, 3.0), (0.1, 0.4, 0.2)),
    Rise(EXPONENTIAL, (9.0,), (0.1,)),
)


def contender(rise: Rise, held_out_um: float) -> Contender:
    return Contender(Fitted(rise), 0.1, held_out_um)


@pytest.mark.parametrize(
    ("taken", "asked_for", "said"),
    [
        (TWO_RISE, False, "two tanh taken: 0.320 µm RMS on strokes held out, tanh 0.300 (-6 %)"),
        (TANH_RISE, False, "tanh taken: 0.300 µm RMS on strokes held out, two tanh 0.320 (+7 %)"),
        (EXP_RISE, True, "exponential asked for: 0.500 µm RMS on strokes held out, tanh 0.300 (-40 %)"),
        (TWO_RISE, True, "two tanh asked for: 0.320 µm RMS on strokes held out, tanh 0.300 (-6 %)"),
    ],
)
def test_a_choice_is_said_against_two_tanh_or_the_best_of_the_others(taken: Rise, asked_for: bool, said: str) -> None:
    contenders = (contender(TANH_RISE, 0.3), contender(TWO_RISE, 0.32), contender(EXP_RISE, 0.5))
    assert ReversalFit(taken, {}, {}, contenders, (), 0.0, asked_for).choice == said


def test_two_tanh_unless_another_is_better_by_more_than_the_noise_of_a_reading() -> None:
    """A machine that rises in three steps, which two terms cannot follow."""
    amounts_um = tuple(8.0 if k in (2, 8, 14) else 0.0 for k in range(16))
    load = load_mm(Rise(STRAIGHT_PIECES, amounts_um, tuple(np.geomspace(0.002, 2.0, 16).tolist())), MOTOR_MM)
    strokes = [reversal_of(load, seed, 1 - 2 * (seed % 2)) for seed in range(3)]
    held_out = {one.fitted.shape: one.held_out_rms_um for one in estimate(strokes, 0.00025).contenders}
    lead_um = held_out[TWO_TANH] - min(held_out.values())
    assert lead_um > 0.05
    assert estimate(strokes, 0.00025, noise_um=0.9 * lead_um).rise.shape is not TWO_TANH
    taken = estimate(strokes, 0.00025, noise_um=1.1 * lead_um)
    assert taken.rise.shape is TWO_TANH
    assert taken.parameters is taken.published
    assert not taken.asked_for


def test_typed_values_are_taken_as_they_are_and_told_beside_the_fit() -> None:
    truth, typed = Rise(TWO_TANH, (9.0, 5.0), (0.02, 0.3, 0.1)), Rise(TWO_TANH, (8.0, 5.0), (0.02, 0.3, 0.1))
    found = estimate([reversal_of(load_mm(truth, MOTOR_MM), seed) for seed in range(3)], 0.00025, typed)
    assert (found.rise, found.amount_um, found.typed, found.asked_for) == (typed, 13.0, True, True)
    assert {name: str(each) for name, each in found.parameters.items()} == {
        **{"amount_um": "13", "amount_1_um": "8", "amount_2_um": "5"},
        **{"rise_1_mm": "0.02", "rise_2_mm": "0.3", "onset_2_mm": "0.1"},
    }
    assert found.published["amount_um"].value == pytest.approx(14.0, abs=0.1)
    words = found.choice.split()
    assert (words[:3], words[-3:-1]) == (["two", "tanh", "typed:"], ["tanh", "fitted"])
    assert float(words[3]) > 0.5 > float(words[-1])  # a µm too little of 14, against the noise


def test_refusals() -> None:
    one = reversal_of(MOTOR_MM, 1)
    with pytest.raises(InputError, match="2 reversals, expected at least 3"):
        estimate([one, one], 0.001)
    with pytest.raises(InputError, match="none of which is below 0"):
        MeasuredReversal(1, np.append(-0.001, MOTOR_MM[1:]), np.zeros(len(MOTOR_MM)))
    with pytest.raises(InputError, match="has to grow from row to row"):
        MeasuredReversal(1, np.append(MOTOR_MM, 3.0), np.zeros(len(MOTOR_MM) + 1)).by_load()
    with pytest.raises(InputError, match="some reversals are over the load's travel"):
        fit(TANH, [one, one.by_load()])
