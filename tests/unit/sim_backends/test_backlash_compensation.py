"""What a simulated drive adds at a reversal, seen at the shaft."""

from __future__ import annotations

import pytest

from sim_backends.backlash_compensation import QUICK_S, SLOW_S, BacklashCompensation

COUNTS_PER_REV = 1000


class Shaft:
    def __init__(self) -> None:
        self.at_counts = 0.0
        self.friction_permille = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None:
        del dt_s
        self.at_counts = motor_rev * COUNTS_PER_REV


class Drive:
    """A shaft behind a compensation whose parameters may change."""

    def __init__(self, amount: float = 0.0, *, accelerated: bool = False) -> None:
        self.shaft = Shaft()
        self.amount, self.accelerated = amount, accelerated
        self.compensation = BacklashCompensation(self.shaft, COUNTS_PER_REV)
        self.compensation.follow(lambda: self.amount, lambda: self.accelerated)
        self.shown = 0.0

    def go(self, to: float, *, seconds: float = 1.0, steps: int = 100) -> float:
        """What is added once the drive shows `to`."""
        start = self.shown
        for index in range(1, steps + 1):
            self.shown = start + (to - start) * index / steps
            self.compensation.step(self.shown, seconds / steps)
        return self.shaft.at_counts - self.shown


def test_without_an_amount_the_shaft_is_where_the_drive_says() -> None:
    drive = Drive()
    assert [drive.go(place) for place in (500.0, -300.0, 20.0)] == pytest.approx([0.0, 0.0, 0.0])


def test_the_amount_lies_between_the_two_directions() -> None:
    drive = Drive(53.0)
    assert [drive.go(place) for place in (500.0, 0.0, 500.0, 0.0)] == pytest.approx([53.0, 0.0, 53.0, 0.0])


@pytest.mark.parametrize(("accelerated", "duration_s"), [(False, SLOW_S), (True, QUICK_S)])
def test_acceleration_hides_it_sooner(accelerated: bool, duration_s: float) -> None:
    drive = Drive(53.0, accelerated=accelerated)
    drive.go(500.0)
    early = drive.go(400.0, seconds=0.5 * duration_s)
    assert early == pytest.approx(0.5 * 53.0, abs=1.0)
    assert drive.go(300.0, seconds=duration_s) == pytest.approx(0.0)


def test_a_change_comes_into_force_with_the_next_motion() -> None:
    drive = Drive(53.0)
    drive.go(500.0)
    drive.amount = 0.0
    assert drive.go(500.0) == pytest.approx(53.0), "at rest nothing moves"
    assert drive.go(600.0) == pytest.approx(0.0)


def test_trembling_is_no_reversal() -> None:
    drive = Drive(53.0)
    drive.go(500.0)
    for place in (499.4, 500.0, 499.3):
        assert drive.go(place) == pytest.approx(53.0)
