"""What is computed in the middle of a procedure: the axis is looked at meanwhile, and a stop does not wait for it."""

import threading

import pytest
from support.toy_axis import ToyMachine, Trouble, toy_session

from drivers.errors import DriveFaultError
from hil.machine.computing import at_once, watched


def test_the_axis_is_watched_while_something_is_computed() -> None:
    machine, looked = ToyMachine(), threading.Event()
    with toy_session(machine) as session:
        session.prepare()
        before_s = session.elapsed_s()
        session.drive.on_look = lambda _sample: looked.set()
        # the work cannot end before the axis was looked at: computed at once, it would never be
        assert watched(session, lambda: looked.wait(30.0) and threading.current_thread().name) != "MainThread"
        assert looked.is_set()
        assert session.elapsed_s() > before_s


def test_time_stands_still_for_what_is_computed_at_once() -> None:
    with toy_session(ToyMachine()) as session:
        session.prepare()
        before_s = session.elapsed_s()
        assert at_once(session, lambda: 7) == 7
        assert session.elapsed_s() == before_s


def test_its_errors_are_those_of_the_work() -> None:
    def fails() -> None:
        raise ValueError("too few rows")

    with toy_session(ToyMachine()) as session:
        session.prepare()
        with pytest.raises(ValueError, match="too few rows"):
            watched(session, fails)


def test_a_fault_meanwhile_stops_the_axis_and_does_not_wait() -> None:
    machine, end = ToyMachine(), threading.Event()
    with toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(fault_at_s=session.clock.now_ns() / 1e9 + 1.0)
        with pytest.raises(DriveFaultError):
            watched(session, end.wait)  # ends only below
        end.set()
    assert "quick stop" in [name for name, _ in machine.calls]
