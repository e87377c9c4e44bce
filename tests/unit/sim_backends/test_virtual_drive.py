"""The in-process drive keeps every promise of ServoDrive."""

from collections.abc import Iterator
from fractions import Fraction

import pytest

from drivers.drive import Capability, DriveState
from drivers.errors import (
    CapabilityError,
    InputError,
    MotionTimeoutError,
    StateError,
)
from drivers.scaling import AxisScaling
from sim_backends.bench import Bench, BenchParameters
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


def test_waiting_has_an_end(bench: Bench) -> None:
    with drive_on(bench) as drive, pytest.raises(MotionTimeoutError, match="never not within 2 s"):
        drive.wait_for(lambda sample: False, 2.0, "never")


def test_a_gear_is_refused(bench: Bench) -> None:
    with pytest.raises(InputError, match="gear ratio"):
        VirtualDrive(
            bench.servo, AxisScaling(1_000_000, 10.0, Fraction(2)), bench.parameters.limits, bench.clock, name="geared"
        )
