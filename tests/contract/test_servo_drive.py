"""What every ServoDrive must do, whatever wire it is on: one suite, run unchanged against each backend of `support.drive_rigs`."""

from __future__ import annotations

import pytest
from support.drive_rigs import COUNTS_PER_REV, Backend, Rig, arrive, home

from drivers.drive import Capability, DriveSample, DriveState
from drivers.errors import DriveFaultError, LimitError, StateError
from drivers.scaling import AxisScaling

OVER_VOLTAGE = 0x3210


def test_opening_enables_and_moves_nothing(rig: Rig) -> None:
    with rig.drive as drive:
        rig.run(0.1)
        sample = drive.sample()
        assert sample.state is not DriveState.ENABLED
        assert sample.position_load_mm == 0.0
        assert not rig.servo.powered


def test_a_sample_is_fresh_and_says_so(rig: Rig) -> None:
    with rig.drive as drive:
        rig.run(0.5)
        asked_ns = rig.clock.now_ns()
        sample = drive.sample()
        assert asked_ns <= sample.earliest_ns <= sample.time_ns
        assert sample.age_ns(rig.clock.now_ns()) < 2_000_000
        assert sample.torque_percent is not None


def test_it_states_what_it_can_do(rig: Rig) -> None:
    with rig.drive as drive:
        drive.require(Capability.PROFILE_POSITION, Capability.HOMING, Capability.TORQUE_ACTUAL)


def test_enable_holds_the_axis_where_it_is(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(20.0, 100.0)
        arrive(rig)
        drive.disable()
        rig.run(0.2)
        before = drive.sample().position_load_mm
        drive.enable()
        rig.run(0.5)
        sample = drive.sample()
        assert sample.state is DriveState.ENABLED
        assert sample.position_load_mm == pytest.approx(before, abs=1e-4)


@pytest.mark.parametrize("target_mm", [-2.0, 250.0])
def test_a_move_arrives_from_either_side(rig: Rig, target_mm: float) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(100.0, 150.0)
        arrive(rig)
        drive.start_move(target_mm, 80.0)
        assert drive.sample().target_reached is False
        assert arrive(rig) == pytest.approx(target_mm, abs=1e-3)


def test_a_move_keeps_its_velocity_and_shows_it_in_the_load_frame(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(100.0, 50.0)
        rig.run(1.0)
        sample = drive.sample()
        assert sample.velocity_mm_s == pytest.approx(50.0, rel=0.02)
        assert sample.torque_percent is not None
        assert sample.torque_percent > 0.0
        assert sample.following_error_mm is not None
        assert sample.following_error_mm > 0.0  # demand - actual: the axis lags behind


def test_a_new_target_replaces_the_one_under_way(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(200.0, 100.0)
        rig.run(0.5)
        drive.start_move(10.0, 100.0)
        assert arrive(rig) == pytest.approx(10.0, abs=1e-3)


def test_a_move_to_where_it_is_ends(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(5.0, 50.0)
        place = arrive(rig)
        drive.start_move(place, 50.0)
        assert arrive(rig, 1.0) == pytest.approx(5.0, abs=1e-3)


@pytest.mark.parametrize("target_mm", [-3.001, 300.5, float("nan"), float("inf")])
def test_targets_outside_the_travel_are_refused(rig: Rig, target_mm: float) -> None:
    with rig.drive as drive:
        drive.enable()
        with pytest.raises(LimitError):
            drive.start_move(target_mm, 10.0)
        rig.run(0.2)
        assert drive.sample().velocity_mm_s == 0.0


@pytest.mark.parametrize("velocity_mm_s", [0.0, -5.0, 200.1, float("nan")])
def test_velocities_outside_the_limits_are_refused(rig: Rig, velocity_mm_s: float) -> None:
    with rig.drive as drive:
        drive.enable()
        with pytest.raises(LimitError):
            drive.start_move(1.0, velocity_mm_s)


def test_nothing_moves_while_not_enabled(rig: Rig) -> None:
    with rig.drive as drive:
        with pytest.raises(StateError):
            drive.start_move(10.0, 10.0)
        with pytest.raises(StateError):
            drive.start_homing()
        rig.run(0.5)
        assert drive.sample().position_load_mm == 0.0


def test_homing_says_when_it_is_done(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        assert drive.sample().homed is not True
        drive.start_homing()
        sample = drive.wait_for(lambda sample: sample.homed is True, 30.0, "homed")
        assert sample.state is DriveState.ENABLED
        assert sample.position_load_mm == pytest.approx(0.0, abs=0.01)


def test_quick_stop_brings_a_moving_axis_to_rest(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(250.0, 150.0)
        rig.run(0.6)
        drive.quick_stop()
        rig.run(1.0)
        sample = drive.sample()
        assert sample.velocity_mm_s == 0.0
        assert sample.state in (DriveState.QUICK_STOP, DriveState.SWITCH_ON_DISABLED)
        assert not sample.target_reached
        rig.run(1.0)
        assert drive.sample().position_load_mm == sample.position_load_mm


def test_quick_stop_does_no_harm_when_disabled(rig: Rig) -> None:
    with rig.drive as drive:
        drive.quick_stop()
        rig.run(0.1)
        assert drive.sample().state is not DriveState.ENABLED


def test_it_can_be_enabled_again_after_a_quick_stop(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(100.0, 100.0)
        rig.run(0.3)
        drive.quick_stop()
        rig.run(1.0)
        drive.disable()
        place = drive.sample().position_load_mm
        drive.enable()
        rig.run(0.2)
        assert drive.sample().position_load_mm == pytest.approx(place, abs=1e-3)
        drive.start_move(1.0, 100.0)
        assert arrive(rig) == pytest.approx(1.0, abs=1e-3)


def test_a_fault_is_shown_and_never_followed_by_an_enable(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.servo.raise_fault(OVER_VOLTAGE)
        rig.run(0.5)
        sample = drive.sample()
        assert sample.state is DriveState.FAULT
        assert sample.fault_code == OVER_VOLTAGE
        for refused in (drive.enable, lambda: drive.start_move(1.0, 1.0), drive.start_homing):
            with pytest.raises(DriveFaultError) as caught:
                refused()
            assert caught.value.code == OVER_VOLTAGE
        drive.reset_fault()
        rig.run(0.5)
        after = drive.sample()
        assert after.state not in (DriveState.ENABLED, DriveState.FAULT)
        assert after.fault_code is None
        assert not rig.servo.powered
        drive.enable()
        assert drive.sample().state is DriveState.ENABLED


def test_a_fault_during_a_move_stops_it(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(250.0, 100.0)
        rig.run(0.5)
        rig.servo.raise_fault(OVER_VOLTAGE)
        rig.run(2.0)
        sample = drive.sample()
        assert sample.state is DriveState.FAULT
        assert not sample.target_reached
        assert sample.velocity_mm_s == 0.0


def test_resetting_without_a_fault_leaves_it_disabled(rig: Rig) -> None:
    with rig.drive as drive:
        drive.reset_fault()
        rig.run(0.1)
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED


def test_disabling_a_moving_axis_stops_it_first(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(250.0, 150.0)
        rig.run(0.7)
        drive.disable()
        sample = drive.sample()
        assert sample.state is not DriveState.ENABLED
        assert sample.velocity_mm_s == 0.0
        assert not rig.servo.powered


def test_an_interrupt_while_it_is_disabled_leaves_no_moving_axis(rig: Rig) -> None:
    def interrupt(_sample: DriveSample) -> None:
        raise KeyboardInterrupt

    with rig.drive as drive:
        drive.enable()
        home(rig)
        drive.start_move(250.0, 150.0)
        rig.run(0.7)
        drive.on_look = interrupt
        with pytest.raises(KeyboardInterrupt):
            drive.disable()
        drive.on_look = None
        assert drive.sample().state in (DriveState.QUICK_STOP, DriveState.SWITCH_ON_DISABLED)
        rig.run(0.5)
        assert rig.servo.velocity_actual_counts_s == 0


def test_closing_disables_first_and_can_be_repeated(rig: Rig) -> None:
    drive = rig.drive
    drive.open()
    drive.enable()
    drive.start_move(100.0, 50.0)
    drive.close()
    assert not rig.servo.powered
    drive.close()
    rig.run(0.5)
    assert rig.servo.velocity_actual_counts_s == 0


def test_it_can_be_opened_again(rig: Rig) -> None:
    for _ in range(3):
        with rig.drive as drive:
            drive.enable()
            assert drive.sample().state is DriveState.ENABLED


def test_the_same_calls_give_the_same_run_every_time(backend: Backend) -> None:
    """Simulated time: samples of two runs are equal to the last bit."""

    def run() -> list[tuple[int, float, float | None]]:
        seen: list[tuple[int, float, float | None]] = []
        with backend(AxisScaling(COUNTS_PER_REV, 10.0)) as rig, rig.drive as drive:
            drive.enable()
            drive.start_move(40.0, 60.0)
            for _ in range(120):
                rig.run(0.01)
                sample = drive.sample()
                seen.append((sample.time_ns, sample.position_load_mm, sample.torque_percent))
        return seen

    assert run() == run()
