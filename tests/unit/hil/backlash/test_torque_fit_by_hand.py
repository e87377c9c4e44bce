"""The fitted wind-up on straight lines and parabolas without noise, where every figure follows on paper.

A 6077h reading is rounded to 0.1 %: variance 0.01/12 = 8.33333e-4, called r below. Straight flank -8 + 0.4 x: 0 at 20 µm, 8 at 40 µm.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from hil.backlash.result import Reversal, fitted_lost_motion, mean_um, reversal_json
from hil.backlash.torque_fit import FittedWindUp, Polynomial, explains_more, fit_polynomial, fit_wind_up
from hil.backlash.trace import ReversalTrace, crept_trace, read_trace

R = 8.33333e-4
LOST_UM = 40.0


def straight(x: float) -> float:
    return -8.0 + 0.4 * x


def made(
    spacing_um: float = 4.0,
    end_um: float = 120.0,
    flank: Callable[[float], float] = straight,
    *,
    sliding: Callable[[float], float] = lambda x: 8.0,
    turn_um: float = LOST_UM,
    slides: Sequence[float] = (),
) -> ReversalTrace:
    travel = np.arange(0.0, end_um + 1e-9, spacing_um)
    torque = np.array([flank(x) if x < turn_um else sliding(x) for x in travel])
    return ReversalTrace(1, travel / 1000.0, torque[:, None], np.array(slides).reshape(-1, 1))


def found(trace: ReversalTrace) -> FittedWindUp:
    fit = fit_wind_up(trace)
    assert fit is not None
    return fit


def test_a_straight_flank_and_a_level_way() -> None:
    """Places 20 24 28 32 36, up to 20 + 0.88·20 = 37.6; mean 28, Σ 160: at 40 the line is known to (1/5 + 144/160) r = 1.1 r.

    The level is rounded the same way everywhere: r. √(2.1 r) = 0.0418330 %, over 0.4 %/µm 0.1045825 µm; with 0.006·40 = 0.24 and
    0.3 µm √(0.0109375 + 0.0576 + 0.09) = 0.3981677 µm; after a creep with 0.45 µm √(0.0109375 + 0.0576 + 0.2025) = 0.5206126.
    """
    fit = found(made())
    assert (fit.lost_motion_um, fit.level_percent) == pytest.approx((40.0, 8.0))
    assert fit.chance_um == pytest.approx(0.1045825, rel=1e-5)
    assert fit.u_um == pytest.approx(0.3981677, rel=1e-5)
    assert found(replace(made(), creep_um_s=20.0)).u_um == pytest.approx(0.5206126, rel=1e-5)
    assert fit.flank_um == pytest.approx((20.0, 36.0))
    assert fit.centre_um == pytest.approx(28.0)
    assert fit.coefficients == pytest.approx((3.2, 0.4))
    assert fit.flank_percent(np.array([20.0, 30.0])) == pytest.approx([0.0, 4.0])
    assert (fit.peak_um, fit.peak_percent) == pytest.approx((40.0, 8.0))


def test_longer_ways_tell_the_level_where_there_are_four() -> None:
    """7 9 7 9: mean 8, variance 4/3; t(3) = 3.18245 against 1.95996: 1.62373² · 1.33333/4 = 0.878834, and r/4.

    With 1.1 r of the flank √0.879959 / 0.4 = 2.345156 µm.
    """
    assert found(made(slides=(7.0, 9.0, 7.0, 9.0))).chance_um == pytest.approx(2.345156, rel=2e-5)
    lower = found(made(slides=(6.0, 6.0, 6.0, 6.0)))
    assert (lower.lost_motion_um, lower.level_percent) == pytest.approx((35.0, 6.0))
    three = found(made(slides=(6.0, 6.0, 6.0)))
    assert three.lost_motion_um == pytest.approx(40.0)


def test_a_level_that_drifts_is_known_less_well() -> None:
    """0.01 %/µm beyond 40: over 64 … 120 µm on average 8 + 0.01·52 = 8.52 %, met at 41.3 µm; flank (1/5 + 13.3²/160) r = 1.087969e-3.

    Fifteen values 0.04 apart, variance 0.032, t(14): 1.094299² · 0.032/15 = 2.554650e-3, and r/15; the drift 0.01·56/4 = 0.14 to
    either side, 0.14²/3 = 6.533333e-3. √0.01023151 / 0.4 = 0.2528775 µm.
    """
    fit = found(made(sliding=lambda x: 8.0 + 0.01 * (x - 40.0)))
    assert (fit.lost_motion_um, fit.level_percent) == pytest.approx((41.3, 8.52))
    assert fit.chance_um == pytest.approx(0.2528775, rel=1e-4)
    slides = found(made(sliding=lambda x: 8.0 + 0.01 * (x - 40.0), slides=(8.0,) * 4))
    # what longer ways leave behind does not drift; without noise they are all rounded the same way
    assert slides.chance_um == pytest.approx(0.1045825, rel=1e-5)


@pytest.mark.parametrize(("drift", "broken_away"), [(0.148, True), (0.152, False), (-0.05, True)])
def test_what_rises_by_more_than_12_percent_of_the_flank_is_not_sliding(drift: float, broken_away: bool) -> None:
    """-30 + 1.25 x meets 20 % at 40 µm; 0.12 · 1.25 = 0.15 %/µm."""
    trace = made(0.5, 60.0, lambda x: -30.0 + 1.25 * x, sliding=lambda x: 20.0 + drift * (x - 40.0), slides=(20.0,) * 4)
    assert (fit_wind_up(trace) is not None) is broken_away


def test_how_sliding_drifts_is_told_by_a_straight_line_over_all_of_it() -> None:
    """20 + 0.2 u - 0.005 u² % beyond 40 µm: at u = 0 it rises by 0.2 %/µm, over u = 5 … 20 on average by 0.2 - 0.01·12.5 = 0.075."""
    bent = made(
        0.5,
        60.0,
        lambda x: -30.0 + 1.25 * x,
        sliding=lambda x: 20.0 + 0.2 * (x - 40.0) - 0.005 * (x - 40.0) ** 2,
        slides=(20.0,) * 4,
    )
    assert fit_wind_up(bent) is not None  # below 0.15


def test_noise_in_the_flank_counts_as_far_as_it_goes() -> None:
    """±0.2 % on five places: 0.2 -0.2 0 -0.2 0.2 off the line, which they leave as it is; Σ 0.16 over 3 degrees of freedom.

    t(3): 1.62373² · 0.16/3 = 0.140613 for r; 1.1 · 0.140613 + r = 0.155508; √ / 0.4 = 0.985862 µm.
    """
    off = dict(zip((20.0, 24.0, 28.0, 32.0, 36.0), (0.2, -0.2, 0.0, -0.2, 0.2), strict=True))
    # as in the table of residuals above, but the place at 20 must not be above 0, or the flank would begin at 16
    off = {x: -value for x, value in off.items()}
    fit = found(made(flank=lambda x: straight(x) + off.get(x, 0.0)))
    assert fit.lost_motion_um == pytest.approx(40.0)
    assert fit.chance_um == pytest.approx(0.985862, rel=1e-4)


def test_the_break_away_is_looked_for_around_the_meeting_point() -> None:
    """From 0.9·40 = 36 µm to 1.2·40 + 5 = 53 µm, both not included; a spike elsewhere is none."""
    # 38 µm is above what the flank is fitted over, 37.6; at 2 µm torque is far below 0 otherwise
    for at_um, more, peak_um in (
        (44.0, 0.5, 44.0),
        (52.0, 0.5, 52.0),
        (54.0, 0.5, 40.0),
        (38.0, 5.0, 38.0),
        (2.0, 20.0, 40.0),
    ):
        trace = made(2.0)
        trace.torque_percent[int(at_um / 2.0), 0] += more
        fit = found(trace)
        assert fit.peak_um == pytest.approx(peak_um), at_um
    assert found(made(sliding=lambda x: 8.5 if x == 44.0 else 8.0)).peak_percent == pytest.approx(8.5)


def parabola(x: float) -> float:
    return -8.0 + 0.6 * x - 0.005 * x * x


def test_a_bent_flank() -> None:
    """At 41 µm 8.195 %, 0 at 15.28: places 15 … 37 (15 + 0.88·26 = 37.88), mean 26: 4.22 + 0.34 u - 0.005 u²."""
    rng = np.random.default_rng(3)
    trace = made(1.0, 90.0, parabola, sliding=lambda x: 8.195, turn_um=41.0)
    trace.torque_percent[:, 0] += rng.normal(0.0, 1e-6, 91)
    fit = found(trace)
    assert fit.lost_motion_um == pytest.approx(41.0, abs=1e-4)
    assert fit.flank_um == pytest.approx((15.0, 37.0))
    assert fit.centre_um == pytest.approx(26.0)
    assert fit.coefficients == pytest.approx((4.22, 0.34, -0.005), rel=1e-4)
    assert fit.flank_percent(np.array([36.0])) == pytest.approx([4.22 + 3.4 - 0.5], rel=1e-5)


@pytest.mark.parametrize(("kink", "first_um"), [(0.0, 20.0), (0.15, 28.0), (0.30, 34.0), (0.40, 40.0)])
def test_a_flank_that_begins_otherwise_is_taken_from_further_up(kink: float, first_um: float) -> None:
    """0 at 20 µm, 8 at 60: up to the kink at 0.05 %/µm, then straight to 8. Taken from 0, 20, 35 or 50 % of the way on."""
    bend_um = 20.0 + kink * 40.0
    low = 0.05 * (bend_um - 20.0)

    def flank(x: float) -> float:
        if x < 20.0:
            return 0.4 * (x - 20.0)
        return 0.05 * (x - 20.0) if x < bend_um else low + (8.0 - low) / (60.0 - bend_um) * (x - bend_um)

    trace = made(0.5, 120.0, flank, turn_um=60.0)
    trace.torque_percent[:, 0] += np.random.default_rng(1).normal(0.0, 1e-4, 241)
    trace.torque_percent[:40, 0] = -np.abs(trace.torque_percent[:40, 0])
    trace.torque_percent[40, 0] = 0.0
    fit = found(trace)
    assert fit.lost_motion_um == pytest.approx(60.0, abs=0.01)
    assert fit.flank_um[0] == pytest.approx(first_um, abs=0.51)  # a place, every 0.5 µm


@pytest.mark.parametrize(("spacing_um", "coefficients"), [(2.5, 2), (2.0, 3)])
def test_nine_places_make_a_parabola(spacing_um: float, coefficients: int) -> None:
    """Between 20 and 37.6 µm: 20, 22.5 … 37.5 are eight, 20, 22 … 36 nine."""
    trace = made(spacing_um)
    trace.torque_percent[:, 0] -= np.random.default_rng(2).uniform(0.0, 1e-6, len(trace.torque_percent))
    assert len(found(trace).coefficients) == coefficients


def test_how_few_places_will_do() -> None:
    """Four on the flank: every 5 µm 20 25 30 35. Three will not: every 6 µm, 8 % at 36, 18 24 30. Ten of sliding, beyond 44.8 µm."""
    assert found(made(5.0, 140.0)).lost_motion_um == pytest.approx(40.0)
    assert fit_wind_up(made(6.0, 140.0, lambda x: -8.0 + x * 16.0 / 36.0, turn_um=36.0)) is None
    assert fit_wind_up(made(0.5, 49.5)) is not None  # 45.0 … 49.5
    assert fit_wind_up(made(0.5, 49.0)) is None
    assert fit_wind_up(made(2.0, 70.0)) is not None  # five places and not 4.8 µm are left out: 52 … 70
    assert fit_wind_up(made(2.0, 68.0)) is None


def test_a_clearance_is_no_level_of_sliding() -> None:
    """Less than half of what the torque was before the reversal."""
    for level, there in ((4.1, True), (3.9, False)):
        trace = made(flank=lambda x: -8.0 + 0.3 * x, sliding=lambda x, level=level: level, turn_um=(8.0 + level) / 0.3)
        assert (fit_wind_up(trace) is not None) is there, level


def polynomial(rss: float, freedom: int) -> Polynomial:
    return Polynomial(0.0, np.zeros(1), np.zeros((1, 1)), rss, freedom)


def test_further_coefficients_must_explain_more_than_luck_would() -> None:
    """1 % points of F as they are printed: F(1, 10) = 10.04, F(2, 20) = 5.85. Gain per coefficient over what is left per freedom."""
    for more, added, f in ((10, 1, 10.04), (20, 2, 5.85)):
        for factor, better in ((1.01, True), (0.99, False)):
            fewer = polynomial(1.0 * more + added * f * factor, more + added)
            assert explains_more(polynomial(1.0 * more, more), fewer) is better, (more, factor)
    assert not explains_more(polynomial(0.0, 5), polynomial(1.0, 6))


def test_a_line_through_four_places() -> None:
    """0 1 2 3 with 0 2 1 3: about 1.5 and 1.5 the slope is 4/5 = 0.8; Σr² = 1.8 over 2; t(2) = 4.30265 against 1.95996.

    Covariance: 2.19527² · 0.9 = 4.33731 by 1/4 and by 1/5; at 5 it is 4.33731·(1/4 + 3.5²/5) = 11.71073.
    """
    line = fit_polynomial(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 2.0, 1.0, 3.0]), 1)
    assert (line.centre, line.rss, line.freedom) == (1.5, pytest.approx(1.8), 2)
    assert line.coefficients == pytest.approx([1.5, 0.8])
    assert line.covariance == pytest.approx(np.diag([4.33731 / 4, 4.33731 / 5]), rel=1e-4)
    assert line.variance(5.0) == pytest.approx(11.71073, rel=1e-4)
    assert line.slope(9.0) == pytest.approx(0.8)
    assert line.meets(4.0, 0.0) == pytest.approx(1.5 + 2.5 / 0.8)
    exact = fit_polynomial(np.array([0.0, 1.0]), np.array([0.0, 1.0]), 1)
    assert exact.freedom == 1
    assert exact.covariance == pytest.approx(np.diag([R / 2, R / 0.5]), rel=1e-5)


def test_where_a_parabola_is_met_and_that_it_may_never_be() -> None:
    """2 + 3 u - u² about 10: slope 3 - 2 u; 4 at u = 1; 4.25 is its top at 1.5; beyond that it falls, and 5 is never reached."""
    curve = Polynomial(10.0, np.array([2.0, 3.0, -1.0]), np.zeros((3, 3)), 0.0, 1)
    assert curve.slope(11.0) == pytest.approx(1.0)
    assert curve.meets(4.0, 10.0) == pytest.approx(11.0)
    assert curve.meets(4.0, 11.3) == pytest.approx(11.0)  # from beyond: the first step leads back
    assert np.isnan(curve.meets(4.0, 11.5))
    assert np.isnan(curve.meets(5.0, 11.0))


def reversal(run: int, direction: int, lost_um: float, chance_um: float) -> Reversal:
    trace = ReversalTrace(direction, np.zeros(3), np.zeros((3, 1)))
    fit = FittedWindUp(lost_um, 0.5, chance_um, 8.0, lost_um + 2.0, 8.6, 0.0, (0.0, 1.0), (0.0, 1.0))
    return Reversal(run, trace, lost_um + 1.0, fit)


def test_the_mean_and_its_uncertainty_by_hand() -> None:
    """50 and 40: 45; chance √((0.04 + 0.16)/4); with 0.006·45 = 0.27 and 0.3: √(0.05 + 0.0729 + 0.09) = 0.461411,
    · 1.959964 = 0.904349.
    """
    both = [reversal(1, 1, 50.0, 0.2), reversal(1, -1, 40.0, 0.4)]
    assert (mean_um(both, "fitted"), mean_um(both, "four-sample")) == (45.0, 46.0)
    assert mean_um(both, "fitted", [-1]) == 40.0
    one = fitted_lost_motion(both)
    assert one is not None
    assert (one.mean_um, one.u95_um) == (45.0, pytest.approx(0.904349, rel=1e-5))
    assert fitted_lost_motion(both[:1]) is None


def test_runs_that_agree_or_do_not() -> None:
    """+: 49 and 51, variance 2, t(1) = 12.7062/1.959964 = 6.482874: 42.02766·2/2 = 42.02766 rather than (0.04 + 0.04)/4 = 0.02.

    -: 40 twice, 0.16/2 = 0.08. √((42.02766 + 0.08)/4 + 0.27² + 0.3²) · 1.959964 = 6.408160.
    """
    runs = [
        reversal(1, 1, 49.0, 0.2),
        reversal(2, 1, 51.0, 0.2),
        reversal(1, -1, 40.0, 0.4),
        reversal(2, -1, 40.0, 0.4),
    ]
    found_um = fitted_lost_motion(runs)
    assert found_um is not None
    assert found_um.u95_um == pytest.approx(6.408160, rel=1e-5)


def test_a_reversal_in_plain_values() -> None:
    assert reversal_json(reversal(3, -1, 40.0, 0.4)) == {
        "run": 3,
        "reversal": "+ → −",
        "direction": -1,
        "steps": 2,
        "four_sample_um": 41.0,
        "fitted_um": 40.0,
        "fitted_u95_um": pytest.approx(0.979982),
        "break_away_um": 42.0,
        "break_away_percent": 8.6,
        "sliding_percent": 8.0,
    }
    nothing = reversal_json(Reversal(1, ReversalTrace(1, np.zeros(2), np.zeros((2, 1))), None, None))
    assert nothing["reversal"] == "− → +"
    assert [nothing[name] for name in ("fitted_um", "fitted_u95_um", "break_away_um", "break_away_percent")] == [
        None
    ] * 4
    assert nothing["sliding_percent"] is None


def test_travel_and_torque_in_the_new_directions_sense() -> None:
    """Backwards from 10 mm: 9.998 is 2 µm on; torque -3 and -5 with a weight of 2 %: mean -4 - 2 = -6, turned +6."""
    trace = ReversalTrace(
        -1, np.array([10.0, 9.998]), np.array([[1.0, 3.0], [-3.0, -5.0]]), np.array([[-7.0, -9.0]]), weight_percent=2.0
    )
    assert trace.travel_um == pytest.approx([0.0, 2.0])
    assert trace.rising_percent == pytest.approx([0.0, 6.0])
    assert trace.slides_rising_percent == pytest.approx([10.0])
    assert str(trace.travel_um[0]) == "0.0"
    assert trace.to_json() == {
        "direction": -1,
        "position_load_mm": [10.0, 9.998],
        "torque_percent": [[1.0, 3.0], [-3.0, -5.0]],
        "slides_percent": [[-7.0, -9.0]],
        "weight_percent": 2.0,
        "creep_um_s": 0.0,
    }


def test_a_creep_is_averaged_over_each_step_of_motion() -> None:
    """Downwards from 10 mm: 0.2 0.6 | 1.2 1.2 1.8 | 2.4 µm with 1 3 | 5 99 7 | 9 %: neither standing readings nor the last count."""
    places = 10.0 - np.array([0.0, 0.0, 0.2, 0.6, 1.2, 1.2, 1.8, 2.4]) / 1000.0
    torques = np.array([-4.0, 50.0, 1.0, 3.0, 5.0, 99.0, 7.0, 9.0])
    trace = crept_trace(-1, places, torques, step_um=1.0, creep_um_s=20.0, weight_percent=0.5)
    assert trace.travel_um == pytest.approx([0.0, 0.4, 1.5])
    assert trace.torque_percent[:, 0].tolist() == [-4.0, 2.0, 6.0]
    assert trace.rising_percent == pytest.approx([4.5, -1.5, -5.5])
    assert (trace.creep_um_s, trace.weight_percent) == (20.0, 0.5)
    stood = crept_trace(1, np.full(5, 3.0), np.zeros(5), step_um=1.0, creep_um_s=20.0)
    assert len(stood.position_load_mm) == 1


def test_a_creep_is_averaged_over_every_step_but_the_last() -> None:
    """A reading each 0.5 µm from 0 to 20 µm: 20 whole steps of 1 µm, the first without the reading at rest."""
    places = np.arange(0.0, 20.25, 0.5) / 1000.0
    trace = crept_trace(1, places, np.arange(41.0), step_um=1.0, creep_um_s=20.0)
    assert trace.travel_um.tolist() == pytest.approx([0.0, 0.5, *(number + 0.25 for number in range(1, 20))])
    assert trace.torque_percent[-1, 0] == 38.5


@pytest.mark.parametrize("slides", [(), (7.9, 8.1)])
def test_a_trace_read_again_is_the_one_written(slides: tuple[float, ...]) -> None:
    trace = made(slides=slides)
    again = read_trace(json.loads(json.dumps(trace.to_json())))
    assert again.slides_percent.tolist() == [[one] for one in slides]
    assert again.position_load_mm.tolist() == trace.position_load_mm.tolist()
