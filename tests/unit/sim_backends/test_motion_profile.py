"""Set-points: they end on target, keep the limits, are continuous, and do not depend on how they are sampled."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_backends.motion_profile import plan_move, plan_stop, plan_velocity

finite = st.floats(-1e6, 1e6)
speeds = st.floats(-3e3, 3e3)
limits = st.floats(1.0, 1e4)


@given(position=finite, velocity=speeds, target=finite, vmax=limits, acc=limits, dec=limits)
def test_a_move_ends_at_rest_on_its_target(
    *, position: float, velocity: float, target: float, vmax: float, acc: float, dec: float
) -> None:
    profile = plan_move(position, velocity, target, max_velocity=vmax, acceleration=acc, deceleration=dec)
    assert profile.at(profile.duration_s) == (target, 0.0, 0.0)
    if profile.pieces:
        last = profile.pieces[-1]
        tau = last.end_s - last.start_s
        end = last.p0 + (last.v0 + 0.5 * last.a * tau) * tau
        assert end == pytest.approx(target, abs=1e-6 * (1 + abs(target) + abs(position) + velocity * velocity / dec))
        assert last.v0 + last.a * tau == pytest.approx(0.0, abs=1e-6 * (1 + vmax + abs(velocity)))


@given(position=finite, velocity=speeds, target=finite, vmax=limits, acc=limits, dec=limits)
def test_a_move_is_continuous_and_within_its_limits(
    *, position: float, velocity: float, target: float, vmax: float, acc: float, dec: float
) -> None:
    profile = plan_move(position, velocity, target, max_velocity=vmax, acceleration=acc, deceleration=dec)
    fastest = max(vmax, abs(velocity)) * (1 + 1e-9) + 1e-9
    p, v, t = position, velocity, 0.0
    for piece in profile.pieces:
        assert piece.start_s == t
        assert piece.p0 == pytest.approx(p, rel=1e-9, abs=1e-6)
        assert piece.v0 == pytest.approx(v, rel=1e-9, abs=1e-6)
        assert abs(piece.a) <= max(acc, dec) * (1 + 1e-12)
        assert abs(piece.v0) <= fastest
        tau = piece.end_s - piece.start_s
        p, v, t = piece.p0 + (piece.v0 + 0.5 * piece.a * tau) * tau, piece.v0 + piece.a * tau, piece.end_s


def test_worked_case() -> None:
    """100 mm at 50 mm/s and 100 mm/s²: 0.5 s up, 1.5 s along, 0.5 s down."""
    profile = plan_move(0.0, 0.0, 100.0, max_velocity=50.0, acceleration=100.0, deceleration=100.0)
    assert profile.duration_s == pytest.approx(2.5)
    assert profile.at(0.5)[0] == pytest.approx(12.5)
    assert profile.at(1.0) == pytest.approx((37.5, 50.0, 0.0))
    assert profile.at(2.25) == pytest.approx((100.0 - 0.5 * 100.0 * 0.25**2, 25.0, -100.0))


def test_short_move_is_a_triangle() -> None:
    profile = plan_move(0.0, 0.0, -1.0, max_velocity=50.0, acceleration=100.0, deceleration=50.0)
    assert len(profile.pieces) == 2
    peak = math.sqrt(2 * 1.0 * 100.0 * 50.0 / 150.0)
    assert profile.pieces[1].v0 == pytest.approx(-peak)


def test_velocity_goes_on_for_ever_and_stop_ends_it() -> None:
    profile = plan_velocity(5.0, 0.0, -10.0, 20.0)
    assert math.isinf(profile.duration_s)
    position, velocity, _ = profile.at(100.5)
    assert (position, velocity) == pytest.approx((5.0 - 2.5 - 1000.0, -10.0))
    stop = plan_stop(position, velocity, 5.0)
    assert stop.end == pytest.approx(position - 10.0)
    assert stop.duration_s == pytest.approx(2.0)
