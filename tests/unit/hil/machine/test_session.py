"""The watched session: whatever goes wrong stops the axis, the error arrives, and nothing is left powered that was not."""

# ruff: noqa: PT012 - leaving the session is part of what raises, so whole sessions stand under raises()
from __future__ import annotations

import math
import random
from collections.abc import Callable

import numpy as np
import pytest
from support.toy_axis import LIMITS, ToyDrive, ToyInstrument, ToyMachine, Trouble, toy_session

from drivers.clock import NS_PER_S
from drivers.drive import Capability, DriveState
from drivers.errors import (
    BridgeError,
    CapabilityError,
    DriveFaultError,
    FollowingErrorError,
    LimitError,
    LinkLostError,
    MeasurementLostError,
    MotionTimeoutError,
    NoAnswerError,
    StateError,
)
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.machine.session import AxisSession

AT = np.array([0.0, 50.0, 100.0])
TABLES = TableSet(
    TableMode.BIDIRECTIONAL, DirectionalTable(AT, np.array([1.0, 2.0, 3.0]), np.array([-21.0, -22.0, -23.0]))
)


def drive_of(session: AxisSession) -> ToyDrive:
    assert isinstance(session.drive, ToyDrive)
    return session.drive


# -- coming and going ------------------------------------------------------------------------------------------------------


def test_entering_connects_and_enables_nothing_and_leaving_lets_go() -> None:
    machine = ToyMachine()
    session = toy_session(machine)
    with session:
        assert machine.state is DriveState.SWITCH_ON_DISABLED
        assert drive_of(session).is_open
    assert machine.told("enable") == []
    assert machine.told("move") == []
    assert not drive_of(session).is_open
    assert not session.instrument.is_open  # type: ignore[attr-defined]


def test_an_axis_found_disabled_is_disabled_again_and_one_found_enabled_stays_so() -> None:
    for found in (DriveState.SWITCH_ON_DISABLED, DriveState.ENABLED):
        machine = ToyMachine(state=found)
        with toy_session(machine) as session:
            session.prepare()
            session.move_to(30.0)
            assert machine.state is DriveState.ENABLED
        assert machine.state is found
        assert bool(machine.told("disable")) is (found is not DriveState.ENABLED)
        assert machine.told("quick stop") == []


def test_an_instrument_that_does_not_open_leaves_no_drive_behind() -> None:
    machine = ToyMachine()
    session = toy_session(machine)
    instrument = session.instrument
    assert isinstance(instrument, ToyInstrument)
    instrument.open_error = LinkLostError("port is gone")
    with pytest.raises(LinkLostError, match="port is gone"), session:
        pytest.fail("entered")
    assert not drive_of(session).is_open


def test_an_error_of_disabling_is_heard_when_nothing_else_was_wrong() -> None:
    machine = ToyMachine()
    session = toy_session(machine)
    with pytest.raises(LinkLostError), session:
        session.prepare()
        machine.trouble.link_lost_at_s = 0.0
    assert not drive_of(session).is_open


def test_a_stop_that_fails_in_an_unforeseen_way_still_disables_and_disconnects() -> None:
    machine = ToyMachine(trouble=Trouble(stop_error=lambda: OSError("unforeseen")))
    session = toy_session(machine)
    with pytest.raises(OSError, match="unforeseen"), session:
        session.prepare()
        raise ValueError("of the procedure")
    assert machine.state is DriveState.SWITCH_ON_DISABLED
    assert not drive_of(session).is_open


# -- getting ready -----------------------------------------------------------------------------------------------------------


def test_prepare_homes_then_takes_the_datum_from_below() -> None:
    machine = ToyMachine()
    with toy_session(machine, reference_mm=30.0) as session:
        session.prepare()
        assert [name for name, _ in machine.calls] == ["enable", "home", "move", "move"]
        assert machine.told("move") == [29.0, 30.0]
        assert session.read_position().position_load_mm == pytest.approx(30.0, abs=1e-12)
        assert session.history is not None
        assert (session.history.position_mm, session.history.direction) == (30.0, 1)


def test_a_later_job_of_a_connection_keeps_the_home_until_there_was_a_fault() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        for _ in range(2):
            with session.one_job():
                session.prepare()
        assert len(machine.told("home")) == 1
        assert len(machine.told("enable")) == 2
        machine.trouble = Trouble(fault_at_s=machine.clock.now_ns() / NS_PER_S)
        with pytest.raises(DriveFaultError), session.one_job():
            session.watch(1.0)
        machine.trouble, machine.state = Trouble(), DriveState.SWITCH_ON_DISABLED
        with session.one_job():
            session.prepare()
    assert len(machine.told("home")) == 2


def test_prepare_without_homing_and_on_an_enabled_axis_does_neither() -> None:
    machine = ToyMachine(state=DriveState.ENABLED)
    with toy_session(machine, home=False) as session:
        session.prepare()
    assert {name for name, _ in machine.calls} == {"move"}


@pytest.mark.parametrize(
    ("trouble", "error"),
    [
        (Trouble(silent_at_s=0.0), MeasurementLostError),
        (Trouble(beam_lost_at_s=0.0), MeasurementLostError),
        (Trouble(fault_at_s=0.0), DriveFaultError),
        (Trouble(link_lost_at_s=0.05), LinkLostError),
    ],
)
def test_nothing_is_enabled_or_moved_while_something_is_wrong(trouble: Trouble, error: type[BridgeError]) -> None:
    machine = ToyMachine(trouble=trouble)
    with pytest.raises(error), toy_session(machine) as session:
        session.prepare()
    assert machine.told("enable") == []
    assert machine.told("move") == machine.told("home") == []


@pytest.mark.parametrize("missing", [Capability.PROFILE_POSITION, Capability.HOMING])
def test_what_the_drive_cannot_do_is_said_before_it_is_enabled(missing: Capability) -> None:
    machine = ToyMachine()
    session = toy_session(machine)
    drive_of(session).missing = frozenset({missing})
    with pytest.raises(CapabilityError, match=missing.value), session:
        session.prepare()
    assert machine.told("enable") == []


def test_a_fault_is_never_reset_and_never_enabled_over() -> None:
    machine = ToyMachine(state=DriveState.FAULT)
    with toy_session(machine) as session:
        for _ in range(3):
            with pytest.raises(DriveFaultError, match="7305h"):
                session.prepare()
    assert machine.told("enable") == machine.told("reset fault") == []


def test_positions_before_a_datum_are_refused() -> None:
    with toy_session(ToyMachine()) as session:
        with pytest.raises(StateError, match=r"prepare\(\)"):
            session.move_to(10.0)
        with pytest.raises(StateError, match=r"prepare\(\)"):
            session.approach(10.0)
        with pytest.raises(StateError, match=r"prepare\(\)"):
            session.read_position()
    with pytest.raises(StateError, match="entered"):
        toy_session(ToyMachine()).prepare()


# -- moving --------------------------------------------------------------------------------------------------------------------


def test_a_target_or_a_corrected_command_outside_the_travel_is_refused_before_anything_moves() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.compensation = Compensation(TABLES)
        session.move_to(90.0)
        moves, history = machine.told("move"), session.history
        with pytest.raises(LimitError, match="200"):
            session.move_to(200.0)
        with pytest.raises(LimitError, match=r"102\.003"):
            session.move_to(102.0)  # the correction of 3 µm leads out of the travel
        with pytest.raises(LimitError, match="velocity"):
            session.move_to(50.0, 1e6)
        with pytest.raises(LimitError):
            session.approach(-3.0)
        assert machine.told("move") == moves
        assert machine.told("quick stop") == []
        assert session.history == history
        session.move_to(50.0)  # and the axis is as usable as before
        assert machine.told("move")[-1] == pytest.approx(50.0 - 0.022)
        session.approach(102.0)  # nothing is measured there: without its correction it lies inside
        assert machine.told("move")[-1] == 102.0
        session.approach(50.0)
        assert machine.told("move")[-1] == pytest.approx(50.0 - 0.022)
    assert LIMITS.travel_min_mm <= machine.lowest_mm
    assert machine.highest_mm <= LIMITS.travel_max_mm


def test_a_correction_that_turns_the_motion_around_is_refused() -> None:
    """3 µm upwards between two targets whose corrections differ by -10 µm: the axis would arrive from the other side."""
    steep = TableSet(
        TableMode.BIDIRECTIONAL,
        DirectionalTable(np.array([50.0, 50.003]), np.array([0.0, -10.0]), np.array([0.0, -10.0])),
    )
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.compensation = Compensation(steep)
        session.move_to(50.0)
        moves = machine.told("move")
        with pytest.raises(StateError, match=r"turns a motion of 3\.0 µm around"):
            session.move_to(50.003)
        assert machine.told("move") == moves
        assert machine.told("quick stop") == []
        session.move_to(50.0)  # where it is: nothing to turn around
        session.move_to(60.0)
        assert machine.told("move")[-1] == pytest.approx(59.99)


def test_at_rest_the_correction_is_the_tables_after_any_moves_stops_and_homing() -> None:
    """Through drive and session: the last command in the drive is target + table value of the direction it came from."""
    generator = random.Random(3)
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.compensation = Compensation(TABLES)
        here, direction = 0.0, 1
        for _ in range(60):
            event = generator.random()
            if event < 0.1:
                session.prepare()  # homing and datum anew
                here, direction = 0.0, 1
            elif event < 0.25:
                far = 100.0 if here < 50.0 else 0.0
                machine.trouble.at_call = machine.counted + 12  # in the middle of the way
                with pytest.raises(KeyboardInterrupt):
                    session.move_to(far)
                assert machine.state is DriveState.QUICK_STOP
                assert machine.motor_mm not in (0.0, 50.0, 100.0)
                with pytest.raises(StateError, match="unknown"):
                    session.move_to(50.0)
                session.drive.disable()
                session.drive.enable()
                with pytest.raises(StateError, match="unknown"):
                    session.move_to(50.0)
                session.take_datum()
                here, direction = 0.0, 1
            else:
                target = generator.choice([0.0, 50.0, 100.0])
                direction = direction if target == here else 1 if target > here else -1
                here = target
                session.move_to(target)
                index = AT.tolist().index(target)
                value = (TABLES.pitch.plus_um if direction > 0 else TABLES.pitch.minus_um)[index]
                assert machine.told("move")[-1] == pytest.approx(target + value / 1000.0, abs=1e-12)


def in_motion(machine: ToyMachine, trouble: Callable[[float], Trouble], error: type[BaseException]) -> AxisSession:
    """A long move during which it happens; the error must arrive, and by then the axis must be stopped."""
    with pytest.raises(error) as caught, toy_session(machine) as session:
        session.prepare()
        assert machine.told("quick stop") == []
        machine.trouble = trouble(machine.now_s + 0.5)
        try:
            session.move_to(100.0)
        except BaseException:
            assert machine.told("quick stop"), "the axis must be stopped before anybody hears of the error"
            assert not machine.moving
            assert session.history is None
            with pytest.raises(StateError, match="unknown"):
                session.move_to(0.0)
            raise
    assert len(str(caught.value).splitlines()) <= 1
    assert len(machine.told("enable")) == 1, "nothing may enable again"
    return session


@pytest.mark.parametrize(
    ("trouble", "error"),
    [
        (lambda at: Trouble(fault_at_s=at), DriveFaultError),
        (lambda at: Trouble(drop_out_at_s=at), StateError),
        (lambda at: Trouble(limit_switch_at_s=at), StateError),
        (lambda at: Trouble(beam_lost_at_s=at), MeasurementLostError),
        (lambda at: Trouble(silent_at_s=at), MeasurementLostError),
        (lambda at: Trouble(frozen_samples_at_s=at), LinkLostError),
        (lambda at: Trouble(stuck_at_s=at), MotionTimeoutError),
        (lambda at: Trouble(false_arrival=True), FollowingErrorError),
    ],
)
def test_trouble_during_a_motion(trouble: Callable[[float], Trouble], error: type[BridgeError]) -> None:
    machine = ToyMachine()
    session = in_motion(machine, trouble, error)
    assert machine.state in (DriveState.SWITCH_ON_DISABLED, DriveState.FAULT)
    assert not drive_of(session).is_open


def test_a_lost_link_is_reported_as_such_although_nothing_can_be_stopped_any_more() -> None:
    machine = ToyMachine()
    session = toy_session(machine)
    with pytest.raises(LinkLostError), session:
        session.prepare()
        machine.trouble.link_lost_at_s = machine.now_s + 0.5
        session.move_to(100.0)
    assert machine.told("quick stop"), "it must have been tried"
    assert not drive_of(session).is_open


def test_trouble_while_reading_at_rest() -> None:
    """Between arrival and the end of the average: a drive that lets go, a beam that breaks, a gauge that falls silent."""
    for trouble, error in (
        (lambda at: Trouble(fault_at_s=at), DriveFaultError),
        (lambda at: Trouble(drop_out_at_s=at), StateError),
        (lambda at: Trouble(limit_switch_at_s=at), StateError),
        (lambda at: Trouble(beam_lost_at_s=at), MeasurementLostError),
        (lambda at: Trouble(silent_at_s=at - 0.3), MeasurementLostError),
    ):
        machine = ToyMachine()
        with pytest.raises(error), toy_session(machine, dwell_s=0.4, reading_s=0.4) as session:
            session.prepare()
            session.move_to(30.0)
            machine.trouble = trouble(machine.now_s + 0.5)
            session.read_position()
        assert machine.told("quick stop")


def test_an_instrument_may_take_longer_to_its_first_reading_than_between_readings() -> None:
    machine = ToyMachine(first_reading_s=1.3)
    with toy_session(machine, reading_s=0.1) as session:
        session.prepare()
        assert machine.now_s > 1.3
        assert machine.told("enable")


def test_an_instrument_that_gives_no_reading_leaves_the_drive_untouched() -> None:
    machine = ToyMachine(trouble=Trouble(silent_at_s=0.0))
    with (
        pytest.raises(MeasurementLostError, match="no reading within 2 s; nothing was enabled"),
        toy_session(machine) as session,
    ):
        session.prepare()
    assert not machine.told("enable")


def test_a_gauge_too_slow_for_the_reading_time_is_refused() -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match="no reading"), toy_session(machine, reading_s=0.1) as session:
        session.prepare()
        machine.trouble.silent_at_s = machine.now_s + 0.08  # within what stale_after_s allows
        session.read_position()


@pytest.mark.parametrize("error", [KeyboardInterrupt, lambda: NoAnswerError("late"), lambda: OSError("unforeseen")])
def test_an_interruption_at_any_call_stops_the_axis_and_leaves_it_disabled(error: Callable[[], BaseException]) -> None:
    """At every call of one preparation, move and reading; among them the moment between a move's order and its answer."""

    def work(machine: ToyMachine) -> AxisSession:
        with toy_session(machine) as session:
            session.prepare()
            session.move_to(30.0)
            session.read_position()
        return session

    whole = ToyMachine()
    work(whole)
    for at_call in random.Random(5).sample(range(1, whole.counted - 1), 60):  # the last call is that of disabling
        machine = ToyMachine(trouble=Trouble(at_call=at_call, error=error))
        with pytest.raises(type(error())):
            work(machine)
        assert not machine.moving
        assert machine.state is not DriveState.ENABLED
        assert LIMITS.travel_min_mm <= machine.lowest_mm
        assert machine.highest_mm <= LIMITS.travel_max_mm


def test_an_order_whose_answer_was_lost_is_stopped_at_once() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(at_call=machine.counted + 4, error=lambda: NoAnswerError("late"))
        with pytest.raises(NoAnswerError):
            session.move_to(100.0)
        assert machine.told("move")[-1] == 100.0, "the drive had taken the order"
        assert machine.told("quick stop")
        assert not machine.moving
        assert session.history is None


def test_the_axis_is_stopped_once_for_one_error() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(beam_lost_at_s=machine.now_s + 0.5)
        with pytest.raises(MeasurementLostError):
            session.move_to(100.0)
        assert len(machine.told("quick stop")) == 1


# -- reading ---------------------------------------------------------------------------------------------------------------------


def test_a_reading_is_the_mean_of_its_time_only() -> None:
    machine = ToyMachine(play_mm=0.0, wave_um=0.0)
    with toy_session(machine, dwell_s=0.3, reading_s=0.2) as session:
        session.prepare()
        session.move_to(50.0)
        reading = session.read_position()
        assert reading.count == 20
        assert reading.position_load_mm == pytest.approx(50.0, abs=1e-9)
        assert reading.std_um == pytest.approx(0.0, abs=1e-6)
        assert reading.sample.position_load_mm == 50.0
        assert not math.isnan(reading.std_um)


def test_what_is_known_when_a_set_point_is_issued() -> None:
    machine = ToyMachine(temperatures={"screw": 21.5})
    with toy_session(machine) as session:
        start_s = machine.now_s
        session.prepare()
        known = session.known(5.0)
        assert known == {
            "time_s": pytest.approx(machine.now_s - start_s),
            "velocity_mm_s": 5.0,
            "temp_screw_c": 21.5,
        }
