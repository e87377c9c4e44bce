"""The in-process drive keeps every promise of ServoDrive."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import pytest

from drivers.drive import Capability, DriveState
from drivers.errors import (
    CapabilityError,
    DriveFaultError,
    InputError,
    LimitError,
    LinkLostError,
    MotionTimeoutError,
    StateError,
)
from drivers.scaling import AxisScaling
from sim_backends.bench import Bench, BenchParameters
from sim_backends.faults import Fault, FaultKind
from sim_backends.servo import ServoParameters
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench(BenchParameters(servo=ServoParameters(start_counts=10_000_000.0))) as made:
        yield made


def drive_on(bench: Bench, **settings: object) -> VirtualDrive:
    p = bench.parameters
    return VirtualDrive(
        bench.servo,
        p.scaling,
        p.limits,
        bench.clock,
        settings=VirtualDriveSettings(**settings),  # type: ignore[arg-type]
    )


def test_open_moves_and_enables_nothing(bench: Bench) -> None:
    with drive_on(bench) as drive:
        bench.clock.sleep_s(1.0)
        sample = drive.sample()
        assert sample.state is DriveState.SWITCH_ON_DISABLED
        assert sample.position_load_mm == 100.0
        assert sample.homed is False
        assert sample.fault_code is None
        assert sample.age_ns(bench.clock.now_ns()) == 0


def test_a_move(bench: Bench) -> None:
    with drive_on(bench) as drive:
        drive.enable()
        drive.start_move(150.0, 50.0)
        assert not drive.sample().target_reached
        bench.clock.sleep_s(0.5)
        assert drive.sample().velocity_mm_s == pytest.approx(50.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrival")
        assert drive.sample().position_load_mm == pytest.approx(150.0, abs=5e-5)
        assert bench.plant.motor_mm == pytest.approx(150.0, abs=5e-5)


def test_direction_turns_everything_round(bench: Bench) -> None:
    scaling = AxisScaling(1_000_000, 10.0, direction=-1)
    limits = replace(bench.parameters.limits, travel_min_mm=-500.0, travel_max_mm=0.0)
    with VirtualDrive(bench.servo, scaling, limits, bench.clock) as drive:
        assert drive.sample().position_load_mm == -100.0
        drive.enable()
        drive.start_move(-120.0, 50.0)
        bench.clock.sleep_s(0.3)
        assert drive.sample().velocity_mm_s == pytest.approx(-50.0, rel=1e-6)
        assert drive.sample().torque_percent is not None
        assert drive.sample().torque_percent < 0.0
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrival")
        assert bench.plant.motor_mm == pytest.approx(120.0, abs=5e-5)


def test_what_is_not_allowed_moves_nothing(bench: Bench) -> None:
    with drive_on(bench) as drive:
        with pytest.raises(StateError, match="cannot move"):
            drive.start_move(150.0, 50.0)
        drive.enable()
        with pytest.raises(LimitError, match="target 600"):
            drive.start_move(600.0, 50.0)
        with pytest.raises(LimitError, match="velocity 0"):
            drive.start_move(150.0, 0.0)
        bench.clock.sleep_s(1.0)
        assert drive.sample().position_load_mm == 100.0


def test_quick_stop_holds_until_disabled(bench: Bench) -> None:
    with drive_on(bench) as drive:
        drive.enable()
        drive.start_move(400.0, 100.0)
        bench.clock.sleep_s(1.0)
        at = drive.sample().position_load_mm
        drive.quick_stop()
        assert drive.sample().state is DriveState.QUICK_STOP
        bench.clock.sleep_s(1.0)
        assert drive.sample().velocity_mm_s == 0.0
        assert drive.sample().position_load_mm - at == pytest.approx(100.0**2 / 2 / 2000.0, abs=0.5)
        with pytest.raises(StateError):
            drive.start_move(100.0, 50.0)
        with pytest.raises(StateError, match="held by a quick stop"):
            drive.enable()
        drive.disable()
        drive.enable()
        assert drive.sample().state is DriveState.ENABLED


def test_disable_stops_first(bench: Bench) -> None:
    with drive_on(bench) as drive:
        drive.enable()
        drive.start_move(400.0, 100.0)
        bench.clock.sleep_s(1.0)
        drive.disable()
        at = drive.sample().position_load_mm
        bench.clock.sleep_s(1.0)
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
        assert drive.sample().position_load_mm == pytest.approx(at, abs=1e-4)


def test_closing_while_moving_leaves_the_axis_off(bench: Bench) -> None:
    with drive_on(bench) as drive:
        drive.enable()
        drive.start_move(400.0, 100.0)
        bench.clock.sleep_s(0.5)
    assert not bench.servo.powered
    with pytest.raises(LinkLostError, match="not open"):
        drive.sample()
    drive.close()


def test_homing(bench: Bench) -> None:
    with drive_on(bench) as drive:
        drive.enable()
        drive.start_homing()
        drive.wait_for(lambda sample: bool(sample.homed), 60.0, "homing")
        assert drive.sample().position_load_mm == pytest.approx(bench.plant.motor_mm, abs=2e-5)
        assert drive.sample().state is DriveState.ENABLED


def test_homing_method_it_does_not_know(bench: Bench) -> None:
    with drive_on(bench, homing_method=11) as drive:
        drive.enable()
        with pytest.raises(CapabilityError, match="no homing method 11"):
            drive.start_homing()


def test_a_capability_may_be_missing(bench: Bench) -> None:
    with drive_on(bench, missing=frozenset({Capability.HOMING})) as drive:
        drive.enable()
        with pytest.raises(CapabilityError, match="homing"):
            drive.start_homing()


def test_a_fault_is_reset_by_its_own_call_only() -> None:
    faults = (Fault(FaultKind.DRIVE_FAULT, at_s=1.0, size=0x3210),)
    with Bench(BenchParameters(servo_faults=faults)) as bench, drive_on(bench) as drive:
        drive.enable()
        bench.clock.sleep_s(1.5)
        assert drive.sample().state is DriveState.FAULT
        assert drive.sample().fault_code == 0x3210
        with pytest.raises(DriveFaultError) as caught:
            drive.enable()
        assert caught.value.code == 0x3210
        with pytest.raises(DriveFaultError):
            drive.start_move(10.0, 10.0)
        drive.reset_fault()
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
        drive.enable()


def test_waiting_has_an_end(bench: Bench) -> None:
    with drive_on(bench) as drive, pytest.raises(MotionTimeoutError, match="never not within 2 s"):
        drive.wait_for(lambda sample: False, 2.0, "never")


def test_a_gear_is_refused(bench: Bench) -> None:
    with pytest.raises(InputError, match="gear ratio"):
        VirtualDrive(
            bench.servo, AxisScaling(1_000_000, 10.0, Fraction(2)), bench.parameters.limits, bench.clock, name="geared"
        )
