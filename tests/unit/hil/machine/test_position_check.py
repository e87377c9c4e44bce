"""Where an axis may be found: where it was told to go, and inside its travel, whoever else moves it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.toy_axis import LIMITS, ToyMachine, toy_session

from drivers.errors import LimitError
from drivers.limits import DriveLimits
from hil.machine.motion_checks import AT_REST_MM, OUTSIDE_MM, PositionCheck

TRAVEL = DriveLimits(0.0, 100.0, 50.0, 500.0)


@given(st.lists(st.floats(0.0, 100.0), min_size=1))
def test_an_axis_that_is_told_to_move_may_be_anywhere_in_its_travel(path_mm: list[float]) -> None:
    place = PositionCheck(TRAVEL)
    assert not any(place.look(position_mm, moving=True) for position_mm in path_mm)


@pytest.mark.parametrize("end", [lambda beyond: 100.0 + beyond, lambda beyond: -beyond])
def test_beyond_the_travel_only_as_far_as_a_move_overshoots(end: Callable[[float], float]) -> None:
    place = PositionCheck(TRAVEL)
    assert place.look(50.0, moving=True) is None
    assert place.look(end(OUTSIDE_MM), moving=True) is None
    wrong = place.look(end(OUTSIDE_MM + 0.01), moving=True)
    assert wrong is not None
    assert "outside its travel 0 to 100 mm" in wrong


def test_an_axis_at_a_homing_switch_may_come_back_and_not_get_further_out() -> None:
    place = PositionCheck(TRAVEL)
    assert [place.look(at, moving=True) for at in (-6.3, -6.0, -2.0, -2.9)] == [None] * 4
    assert place.look(-3.1, moving=True) is not None, "it had come back to -2 mm"
    assert PositionCheck(TRAVEL).look(-6.3, moving=False) is None


def test_an_axis_that_was_told_nothing_stays() -> None:
    place = PositionCheck(TRAVEL)
    assert [place.look(at, moving=False) for at in (40.0, 40.0 + AT_REST_MM, 40.0 - AT_REST_MM)] == [None] * 3
    wrong = place.look(38.9, moving=False)
    assert wrong == (
        "moved from 40.000 to 38.900 mm without a command: another master moves it, or its drive does not hold it"
    )
    place.forget()
    assert place.look(38.9, moving=False) is None
    assert place.look(70.0, moving=True) is None
    assert place.look(70.0, moving=False) is None


def test_an_axis_that_another_master_moves_is_stopped() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        rests_mm = machine.motor_mm
        machine.target_mm = LIMITS.travel_max_mm
        with pytest.raises(LimitError, match="without a command"):
            session.watch(5.0)
        assert machine.told("quick stop")
        assert AT_REST_MM < machine.motor_mm - rests_mm < 15.0, "50 mm/s, and a look at rest every 0.2 s"


def test_after_a_new_zero_an_axis_may_stand_outside_its_travel() -> None:
    place = PositionCheck(TRAVEL)
    assert place.look(50.0, moving=False) is None
    place.forget()
    assert place.look(-6.3, moving=False) is None


def test_an_axis_without_power_may_be_moved_by_hand() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.watch(0.2)
        with session.without_power():
            session.watch(0.2)
            machine.motor_mm = machine.target_mm = machine.nut_mm = 7.0
            session.watch(0.4)


def test_where_a_stream_ends_the_axis_may_rest() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.watch(0.2)
        with session.axis.following() as found:
            machine.target_mm += 5.0
            session.clock.sleep_s(1.0)
            found(session.clock.now_ns(), machine.motor_mm, 50.0)
        session.watch(0.4)
