"""Each reason for a motion that is not over in its time, by what the drive shows."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from support.toy_axis import ToyMachine, toy_session

from drivers.drive import DriveSample, DriveState
from drivers.errors import MotionTimeoutError, SafetyError
from hil.machine.supervisor import UNSEEN_S
from hil.machine.time_out import Motion, drive_report, likely_reason
from hil.machine.watched_axis import STALLED_S

MOVE = Motion("the move", 100.0, 50.0)
STANDS = DriveSample(0, DriveState.ENABLED, 40.0, False, 0.0, 5.0, 0.001, True)


@pytest.mark.parametrize(
    ("sample", "speed_mm_s", "words"),
    [
        (replace(STANDS, torque_percent=-120.0, following_error_mm=3.0), 0.0, "end stop or a jam"),
        (replace(STANDS, following_error_mm=-3.0), 0.0, "a following error"),
        (replace(STANDS, limited=True, torque_percent=120.0), 0.0, "end stop or a jam"),
        (replace(STANDS, limited=True), 0.0, "an internal limit of the drive"),
        (replace(STANDS, position_load_mm=99.99), 0.01, "the drive does not say that it arrived"),
        (replace(STANDS, position_load_mm=99.99, limited=True), 0.01, "the drive does not say that it arrived"),
        (replace(STANDS, position_load_mm=99.99), 2.0, "does not come to rest"),
        (STANDS, 10.0, "slower than the 50 mm/s asked for"),
        (STANDS, -10.0, "moves away from its target"),
        (replace(STANDS, torque_percent=None, following_error_mm=None), 0.0, "an override of 0, a halt"),
    ],
)
def test_the_likeliest_reason(sample: DriveSample, speed_mm_s: float, words: str) -> None:
    assert words in likely_reason(MOVE, sample, speed_mm_s)


def test_a_homing_has_no_target_of_ours() -> None:
    assert likely_reason(Motion("homing"), STANDS, 3.0) == "it is still under way"
    assert "end stop" in likely_reason(Motion("homing"), replace(STANDS, torque_percent=90.0), 0.0)


def test_what_the_drive_says() -> None:
    sample = replace(STANDS, fault_code=0x8611, limited=True)
    assert drive_report(sample, 0.0, ["a warning"]) == (
        "operation enabled, at 40.0000 mm, 0.000 mm/s, torque 5 %, following error 0.0010 mm, internal limit active,"
        " error code 8611h, a warning"
    )


def test_an_axis_that_stands_is_not_waited_for_until_its_move_may_be_over() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        machine.trouble.stuck_at_s = machine.now_s + 0.5
        with pytest.raises(MotionTimeoutError, match="not over, and the axis has stood for 3 s; likely it stands"):
            session.move_to(100.0, 2.0)
        assert machine.now_s < machine.trouble.stuck_at_s + STALLED_S + 0.5
        assert machine.told("quick stop")


@pytest.mark.parametrize("swing_mm", [0.002, 0.8])
def test_a_homing_that_goes_to_and_fro_is_not_waited_for(swing_mm: float) -> None:
    """As where another master drives it back onto the switch it comes from; the time-out of this homing is 134 s."""
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.supervisor.enable()

        def pull(sample: DriveSample) -> None:
            machine.target_mm = 40.0 - math.copysign(swing_mm, sample.position_load_mm - 40.0)
            machine.homing = False

        began_s = machine.now_s
        with pytest.raises(MotionTimeoutError, match="homing not over, and the axis has gone to and fro for 3 s"):
            session.supervisor.home(look=pull)
        assert machine.now_s < began_s + STALLED_S + 1.0
        assert machine.told("quick stop")


@pytest.mark.parametrize("speed_mm_s", [0.02, 6.0])
def test_a_homing_may_creep_and_turn_around_twice(speed_mm_s: float) -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.supervisor.enable()
        ends_mm = [40.0 - 6.3 * speed_mm_s, 40.0 - 4.7 * speed_mm_s, 40.0 - 6.3 * speed_mm_s]

        def lead(_sample: DriveSample) -> None:
            machine.velocity_mm_s = speed_mm_s
            machine.target_mm = ends_mm[0]
            machine.homing = len(ends_mm) == 1
            if abs(machine.motor_mm - ends_mm[0]) < 1e-9 and len(ends_mm) > 1:
                del ends_mm[0]

        session.supervisor.home(look=lead)
        assert machine.homed


def test_a_rest_before_a_motion_is_none_of_it() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.move_to(50.0)
        session.watch(STALLED_S + 1.0)
        session.move_to(60.0)


@pytest.mark.parametrize(("slow_s", "in_a_row", "ends"), [(0.6, 99, True), (0.6, 4, False), (0.4, 99, False)])
def test_an_axis_that_is_seen_too_seldom_is_stopped(slow_s: float, in_a_row: int, ends: bool) -> None:
    """A line on which each request is answered at its second try works, at half a second a look."""
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        sample, looks = session.drive.sample, [0]

        def slow() -> object:
            looks[0] += 1
            if looks[0] % (in_a_row + 1):
                session.clock.sleep_s(slow_s)
            return sample()

        session.drive.sample = slow  # type: ignore[method-assign, assignment]
        began_s = machine.now_s
        if not ends:
            session.move_to(100.0, 5.0)
            return
        with pytest.raises(SafetyError, match="cannot be watched, 5 looks in a row took longer"):
            session.move_to(100.0, 5.0)
        assert machine.now_s - began_s < 5 * (slow_s + 0.1) + 1.0
        assert machine.told("quick stop")
    assert slow_s > UNSEEN_S
