"""Streams that the host paces, on in-process drives: how they are left when something goes wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.drive import DriveSample, DriveState
from drivers.errors import BridgeError, LimitError, NoAnswerError, SafetyError, StateError, UndoError
from drivers.limits import DriveLimits
from drivers.paced_stream import PacedStream
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.servo import ServoParameters, SimulatedServo
from sim_backends.virtual_drive import VirtualDrive

LIMITS = DriveLimits(-3.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
SETTINGS = SetPointSettings(0.01, following_error_mm=5.0)


class Drive(VirtualDrive):
    """Notes what it is told to do; fails where asked to."""

    log: list[str]
    fails: BridgeError | None = None

    def send_stop(self) -> None:
        self.log.append(f"{self.name} stop")
        super().send_stop()

    def quick_stop(self) -> None:
        self.log.append(f"{self.name} stop awaited")
        super().quick_stop()
        if self.fails is not None:
            raise self.fails


@pytest.fixture
def axes() -> tuple[Drive, Drive]:
    x, y = _enabled("XY")
    return x, y


def _enabled(names: str) -> list[Drive]:
    """On one clock, each told to stop in one log."""
    clock, log = SimClock(), list[str]()
    made = []
    for name in names:
        servo = SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=100_000))
        clock.attach(servo.advance, bearable=servo.bearable)
        drive = Drive(servo, AxisScaling(100_000, 10.0), LIMITS, clock, name=name)
        drive.log = log
        drive.open()
        drive.enable()
        made.append(drive)
    return made


def state(drive: Drive) -> DriveState:
    return drive.sample().state


def test_a_group_is_told_to_stop_before_any_of_it_is_waited_for(axes: tuple[Drive, Drive]) -> None:
    x, y = axes
    x.fails = NoAnswerError("X does not answer")
    with pytest.raises(LimitError) as caught, PacedStream([x, y], SETTINGS) as group:
        group.cycle([0.1, 301.0])
    assert x.log == ["X stop", "Y stop", "X stop awaited", "X stop", "Y stop awaited", "Y stop"]
    assert caught.value.__notes__ == ["X does not answer"]
    assert (state(x), state(y)) == (DriveState.SWITCH_ON_DISABLED, DriveState.QUICK_STOP)  # X did not confirm it


def test_a_group_of_which_one_cannot_be_entered_stops_the_others(axes: tuple[Drive, Drive]) -> None:
    x, y = axes
    y.disable()
    with pytest.raises(StateError, match="drive Y cannot stream"), PacedStream([x, y], SETTINGS):
        pytest.fail("entered")
    assert (state(x), state(y)) == (DriveState.QUICK_STOP, DriveState.SWITCH_ON_DISABLED)
    assert not any("Y" in line for line in x.log)


def test_all_axes_of_a_group_are_put_back_although_one_cannot_be(
    axes: tuple[Drive, Drive], monkeypatch: pytest.MonkeyPatch
) -> None:
    x, y = axes
    ended: list[str] = []

    def end(drive: Drive) -> None:
        ended.append(drive.name)
        if drive is x:
            raise NoAnswerError("mode not changed")

    monkeypatch.setattr(Drive, "end_stream", end)
    with pytest.raises(NoAnswerError, match="mode not changed"), PacedStream([x, y], SETTINGS) as group:
        group.cycle([0.1, 0.1])
    assert ended == ["X", "Y"]
    assert (state(x), state(y)) == (DriveState.QUICK_STOP, DriveState.ENABLED)


def test_what_fails_of_a_group_is_told_together(axes: tuple[Drive, Drive], monkeypatch: pytest.MonkeyPatch) -> None:
    def end(drive: Drive) -> None:
        raise NoAnswerError(f"{drive.name} not put back")

    monkeypatch.setattr(Drive, "end_stream", end)
    with pytest.raises(UndoError, match="X not put back; Y not put back"), PacedStream(axes, SETTINGS) as group:
        group.cycle([0.1, 0.1])
    assert {state(drive) for drive in axes} == {DriveState.QUICK_STOP}


def test_a_stream_left_by_the_operator_is_stopped(axes: tuple[Drive, Drive]) -> None:
    x, _ = axes
    with pytest.raises(KeyboardInterrupt), x.stream(SETTINGS):
        raise KeyboardInterrupt
    assert state(x) is DriveState.QUICK_STOP


def test_a_stream_that_was_stopped_is_not_put_back_under_power(axes: tuple[Drive, Drive]) -> None:
    x, _ = axes
    with x.stream(SETTINGS) as stream:
        with pytest.raises(LimitError):
            stream.cycle([301.0])
        with pytest.raises(StateError, match="is not running"):
            stream.cycle([0.1])
    assert state(x) is DriveState.QUICK_STOP
    assert x.log == ["X stop", "X stop awaited", "X stop"]


def test_a_clean_end_holds_the_axis(axes: tuple[Drive, Drive]) -> None:
    x, _ = axes
    with x.stream(SETTINGS) as stream:
        stream.cycle([0.1])
    assert state(x) is DriveState.ENABLED
    assert x.log == []


@pytest.mark.parametrize("names", ["X", "XY", "XYZ"])
def test_a_host_is_late_for_all_axes_at_once(names: str) -> None:
    """Each further axis leaves as many periods as one alone."""
    drives, here = _enabled(names), [0.0] * len(names)
    with PacedStream(drives, SETTINGS) as stream:
        for late_s, missed in ((0.0099, 0), (0.0399, 3), (0.0, 3), (0.0399, 6)):
            stream.cycle(here)
            drives[0].clock.sleep_s(late_s)
            stream.cycle(here)
            assert stream.missed_cycles == missed
        stream.cycle(here)
        drives[0].clock.sleep_s(0.04)
        with pytest.raises(SafetyError, match="4 cycles of 10 ms missed in a row"):
            stream.cycle(here)
    assert {state(drive) for drive in drives} == {DriveState.QUICK_STOP}


def seen_moving(sample: DriveSample) -> DriveSample:
    return replace(sample, velocity_mm_s=1.0)


@pytest.mark.parametrize("falls", [False, True])
def test_an_axis_not_seen_at_rest_is_disabled_unless_it_would_fall(axes: tuple[Drive, Drive], falls: bool) -> None:
    x, _ = axes
    x.falls_without_power = falls
    look = x.sample
    x.sample = lambda: seen_moving(look())  # type: ignore[method-assign]
    if falls:
        with pytest.raises(BridgeError, match="gravity can move the axis and no brake is stated"):
            x.close()
        assert x._servo.powered
        assert x._servo.stopping
    else:
        x.close()
        assert not x._servo.powered
    assert x.log == ["X stop"]


def test_a_homing_that_the_drive_does_not_know_leaves_nothing_moving(axes: tuple[Drive, Drive]) -> None:
    x, _ = axes
    x.settings = replace(x.settings, homing_method=11)
    x.start_move(100.0, 50.0)
    x.clock.sleep_s(0.2)
    with pytest.raises(BridgeError, match="no homing method 11"):
        x.start_homing()
    x.clock.sleep_s(0.5)
    assert x.sample().velocity_mm_s == 0.0
