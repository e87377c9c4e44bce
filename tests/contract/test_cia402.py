"""What CiA 402 asks of a master, seen by what arrives at the drive's objects: one suite for each wire of `support.cia402_wires`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.cia402_wires import WIRES, WatchedDrive

from drivers.cia402.settings import Cia402Settings
from drivers.drive import DriveState
from drivers.errors import BridgeError, CapabilityError, DriveFaultError, LimitError, StateError
from sim_backends.faults import CanFaultKind

OVER_VOLTAGE = 0x3210
BIT_4, BIT_7, BIT_12 = 1 << 4, 1 << 7, 1 << 12
ENABLE_OPERATION = 0x0F
TRINAMIC = 0x286
"""A vendor whose drives differ in their unit of velocity."""


SHOW_ALL = ("dictionary", "canopen, virtual bus")
"""Wires by which a drive shows every object that it has."""


@pytest.fixture(params=[pytest.param(name, id=name.replace(" ", "-").replace(",", "")) for name in WIRES])
def rig(request: pytest.FixtureRequest) -> Iterator[WatchedDrive]:
    with WIRES[request.param](Cia402Settings(handshake_timeout_s=0.2, mode_timeout_s=0.2)) as rig:
        rig.dictionary.set_number(0x6098, 0, 37)
        rig.dictionary.set_number(0x6085, 0, 20_000_000)
        yield rig


def enables(word: int) -> bool:
    """Whether a controlword leads to operation enabled."""
    return word & (BIT_7 | ENABLE_OPERATION) == ENABLE_OPERATION


def test_the_target_is_the_actual_position_before_power_comes_on(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        drive.start_move(20.0, 100.0)
        drive.wait_for(lambda sample: sample.target_reached, 30.0, "arrived")
        drive.disable()
        rig.dictionary.set_number(0x607A, 0, -1_000_000)
        rig.words.clear()
        rig.targets.clear()
        drive.enable()
        assert rig.targets
        assert abs(rig.targets[-1][0] - rig.targets[-1][1]) <= 2
        assert abs(rig.targets[-1][0] - 200_000) <= 2
        rig.clock.sleep_s(0.5)
        assert abs(rig.servo.position_actual_counts - 200_000) <= 2


def test_enabling_takes_every_step_of_the_state_machine(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        rig.words.clear()
        drive.enable()
        steps = [(word & ENABLE_OPERATION, status & 0x6F) for word, status in rig.words]
        assert steps.index((0x06, 0x40)) < steps.index((0x07, 0x21)) < steps.index((0x0F, 0x23))
        assert drive.sample().state is DriveState.ENABLED


def test_a_set_point_is_handed_over_with_its_acknowledge(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.words.clear()
        drive.start_move(50.0, 100.0)
        given = [(word & BIT_4, status & BIT_12) for word, status in rig.words if enables(word)]
        rise = given.index((BIT_4, 0))
        assert (0, BIT_12) in given[rise:]  # taken back once the drive had acknowledged it
        assert not given[-1][0]
        assert rig.targets[-1][0] == 500_000
        assert rig.dictionary.number(0x6081) == 1_000_000
        assert rig.dictionary.number(0x6083) == 20_000_000
        sample = drive.wait_for(lambda sample: sample.target_reached, 30.0, "arrived")
        assert sample.position_load_mm == pytest.approx(50.0, abs=1e-3)


@pytest.mark.parametrize("defect", [CanFaultKind.SETPOINT_NOT_TAKEN, CanFaultKind.ACKNOWLEDGE_STUCK])
def test_a_set_point_that_is_not_acknowledged_leaves_no_enabled_axis(rig: WatchedDrive, defect: CanFaultKind) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.profile.defects.add(defect)
        with pytest.raises(BridgeError, match=r"acknowledge|set-point|target"):
            drive.start_move(50.0, 100.0)
        rig.profile.defects.clear()
        assert not rig.servo.powered
        assert drive.sample().state is not DriveState.ENABLED


def test_a_mode_that_is_not_shown_is_not_enabled_in(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        rig.profile.defects.add(CanFaultKind.MODE_STUCK)
        rig.dictionary.on_read(0x6061, 0, lambda: 3)
        with pytest.raises(BridgeError, match="mode"):
            drive.enable()
        assert not any(enables(word) for word, _ in rig.words)
        rig.dictionary.on_read(0x6061, 0, lambda: 1)
        rig.profile.defects.clear()


def test_homing_counts_from_its_own_end_only(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        for _ in range(2):
            drive.start_homing()
            assert drive.sample().homed is not True
            drive.wait_for(lambda sample: sample.homed is True, 30.0, "homed")
        assert rig.dictionary.number(0x6061) == 6
        assert any(word & BIT_4 for word, _ in rig.words)


def test_a_homing_that_fails_is_told_and_homes_nothing(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.dictionary.set_number(0x6098, 0, 8)  # the simulated drive has no such method
        drive.start_homing()
        with pytest.raises(DriveFaultError, match=r"^drive X: homing failed"):
            drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")
        assert drive.sample().homed is not True


def test_no_word_enables_after_a_stop(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        drive.start_move(150.0, 100.0)
        rig.clock.sleep_s(0.3)
        rig.words.clear()
        drive.send_stop()
        rig.clock.sleep_s(0.01)
        assert rig.words[0][0] & 0x06 == 0x02
        drive.quick_stop()
        with pytest.raises(StateError):
            drive.start_move(0.0, 100.0)
        rig.clock.sleep_s(1.0)
        drive.sample()
        assert not any(enables(word) for word, _ in rig.words)
        assert rig.servo.velocity_actual_counts_s == 0


def test_an_order_that_a_stop_falls_into_ends_without_another_enabling_word(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.words.clear()
        presses = [drive.send_stop]
        rig.dictionary.on_write(0x6081, 0, lambda _: presses.pop()() if presses else None)
        with pytest.raises(StateError, match="stop"):
            drive.start_move(50.0, 100.0)
        rig.clock.sleep_s(0.01)  # the stop was sent without waiting
        assert rig.words
        assert not any(enables(word) for word, _ in rig.words)


def test_a_fault_is_left_by_its_reset_alone(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.words.clear()
        rig.servo.raise_fault(OVER_VOLTAGE)
        rig.clock.sleep_s(0.5)
        for refused in (drive.enable, lambda: drive.start_move(1.0, 1.0), drive.start_homing):
            with pytest.raises(DriveFaultError):
                refused()
        assert not any(word & BIT_7 or enables(word) for word, _ in rig.words)
        drive.reset_fault()
        rig.clock.sleep_s(0.5)
        words = [word for word, _ in rig.words]
        rise = next(at for at, word in enumerate(words) if word & BIT_7)
        assert not words[rise - 1] & BIT_7
        assert not any(enables(word) for word in words)
        assert not words[-1] & BIT_7
        assert not rig.servo.powered


def test_a_fault_whose_cause_stays_is_told(rig: WatchedDrive) -> None:
    with rig.drive as drive:
        drive.enable()
        rig.profile.defects.add(CanFaultKind.FAULT_STAYS)
        rig.servo.raise_fault(OVER_VOLTAGE)
        rig.clock.sleep_s(0.5)
        with pytest.raises(DriveFaultError, match="stays"):
            drive.reset_fault()
        assert not rig.servo.powered


def test_settings_are_found_again_after_closing(rig: WatchedDrive) -> None:
    before = {index: rig.dictionary.number(index) for index in (0x6060, 0x6081, 0x6083, 0x6084)}
    with rig.drive as drive:
        drive.enable()
        drive.start_move(5.0, 10.0)
        assert rig.dictionary.number(0x6081) != before[0x6081]
    assert {index: rig.dictionary.number(index) for index in before} == before


# -- what only a drive that shows the objects can be asked ----------------------------------------------------------------
shown = pytest.mark.parametrize("rig", SHOW_ALL, indirect=True)


@shown
def test_a_move_faster_than_the_drive_allows_is_refused(rig: WatchedDrive) -> None:
    rig.dictionary.set_number(0x607F, 0, 500_000)
    with rig.drive as drive:
        drive.enable()
        rig.words.clear()
        with pytest.raises(LimitError, match="607Fh"):
            drive.start_move(50.0, 100.0)
        assert not rig.words
        drive.start_move(50.0, 50.0)


@shown
def test_a_ramp_is_lowered_to_what_the_drive_allows_and_that_is_noted(rig: WatchedDrive) -> None:
    rig.dictionary.set_number(0x60C5, 0, 5_000_000)
    with rig.drive as drive:
        assert any("mm/s²" in note for note in drive.notes)
        drive.enable()
        drive.start_move(50.0, 50.0)
        assert rig.dictionary.number(0x6083) == 5_000_000


@shown
def test_nothing_moves_while_a_unit_is_not_known(rig: WatchedDrive) -> None:
    rig.dictionary.set_number(0x1018, 1, TRINAMIC)
    with rig.drive as drive:
        with pytest.raises(CapabilityError, match="velocity_unit"):
            drive.enable()
        assert not rig.words
