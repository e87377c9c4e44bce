"""The table that a simulated drive applies itself: values between nodes, its own idea of direction, and when it comes into force."""

from __future__ import annotations

import pytest

from sim_backends.own_table import OwnTable, TableForm, TableStage

LINEAR = TableForm(points=10, explicit=True)


def table(form: TableForm = LINEAR, backlash: int = 0) -> OwnTable:
    return OwnTable(form, True, [0, 100, 300], [10, 20, -20], [0, 0, 40], backlash)


@pytest.mark.parametrize(
    ("form", "at", "rising"),
    [
        (LINEAR, 50.0, 15.0),
        (LINEAR, 200.0, 0.0),
        (LINEAR, -500.0, 10.0),
        (LINEAR, 300.0, -20.0),
        (LINEAR, 900.0, -20.0),
        (TableForm(10, explicit=True, zero_outside=True), -1.0, 0.0),
        (TableForm(10, explicit=True, zero_outside=True), 301.0, 0.0),
        (TableForm(10, explicit=True, zero_outside=True), 300.0, -20.0),
        (TableForm(10, explicit=True, stepped=True), 99.0, 10.0),
        (TableForm(10, explicit=True, stepped=True), 100.0, 20.0),
        (TableForm(10, explicit=True, negated=True), 50.0, -15.0),
        (TableForm(10, explicit=True, place_counts=2.0, value_counts=0.5), 100.0, 7.5),
    ],
)
def test_what_is_added(form: TableForm, at: float, rising: float) -> None:
    assert table(form).added(at, upwards=True) == pytest.approx(rising, abs=0.1 * form.value_counts)


def test_the_other_direction_and_a_backlash() -> None:
    assert table().added(200.0, upwards=False) == pytest.approx(20.0, abs=0.1)
    one = TableForm(10, explicit=True, curves=1)
    assert table(one, backlash=7).added(0.0, upwards=True) == 10.0
    assert table(one, backlash=7).added(0.0, upwards=False) == 3.0


def test_a_table_that_is_none() -> None:
    for places, rising in (([0], [1]), ([0, 0], [1, 2]), ([0, 1], [1]), (range(11), range(11))):
        assert not OwnTable(LINEAR, False, list(places), list(rising), list(rising)).usable()
    assert table().usable()


def test_it_comes_into_force_with_power_and_a_home_position_and_turns_with_the_demand() -> None:
    stage, own = TableStage(), table()
    stage.follow(own)

    def step(demand: float, *, powered: bool = True, homed: bool = True, dt_s: float = 1.0) -> float:
        return stage.step(lambda: demand, powered=powered, homed=homed, dt_s=dt_s)

    assert step(0.0, powered=False) == 0.0
    assert step(0.0, homed=False) == 0.0
    assert 0.0 < step(0.0, dt_s=0.001) < 10.0, "not with a jerk"
    assert step(0.0) == 10.0
    assert own.shown() == 10
    assert step(200.0) == pytest.approx(0.0, abs=0.1)
    assert step(199.0) == pytest.approx(0.2, abs=0.1), "a demand that trembles has not turned"
    assert step(198.0) == pytest.approx(19.6, abs=0.2)
    assert step(0.0, powered=False) == pytest.approx(19.6, abs=0.2), "nothing turns without power"
    own.enabled = False
    assert step(0.0) == 0.0


def test_a_servo_without_a_table_is_left_alone() -> None:
    assert TableStage().step(lambda: 1 / 0, powered=True, homed=True, dt_s=1.0) == 0.0
