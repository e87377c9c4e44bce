"""What must be done on the way out is done, whatever interrupts it, and what failed is told beside the error under way."""

# ruff: noqa: PT012 - leaving the session is part of what raises, so whole sessions stand under raises()
from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from support.toy_axis import ToyDrive, ToyMachine, Trouble, toy_session

from drivers.drive import DriveState
from drivers.errors import LinkLostError, NoAnswerError
from drivers.undo import one_line
from hil.machine.supervisor import Supervisor, finish_despite_interrupt
from hil.machine.watched_axis import WatchedAxis


@dataclass
class Undo:
    """Raises these, one at each call, then does it."""

    errors: list[BaseException]
    done: list[int] = field(default_factory=list)

    def __call__(self) -> None:
        if self.errors:
            raise self.errors.pop(0)
        self.done.append(1)


def test_an_interrupt_is_heard_once_it_is_done() -> None:
    undo = Undo([KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        finish_despite_interrupt(undo)
    assert undo.done == [1]


def test_a_second_interrupt_is_obeyed() -> None:
    undo = Undo([KeyboardInterrupt(), KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        finish_despite_interrupt(undo)
    assert undo.done == []


def test_what_failed_when_it_was_done_anew_is_told_with_the_interrupt() -> None:
    with pytest.raises(KeyboardInterrupt) as caught:
        finish_despite_interrupt(Undo([KeyboardInterrupt(), LinkLostError("gone")]))
    assert one_line(caught.value) == "gone"
    with pytest.raises(LinkLostError):
        finish_despite_interrupt(Undo([LinkLostError("gone")]))


def test_what_could_not_be_undone_is_told_with_the_error_the_most_dangerous_first() -> None:
    machine = ToyMachine()
    with pytest.raises(LinkLostError) as caught, toy_session(machine) as session:
        session.prepare()
        machine.trouble.link_lost_at_s = machine.now_s + 0.5
        session.move_to(100.0)
    told = one_line(caught.value)
    assert told == (
        "drive toy: nobody there; drive toy may still move: drive toy: nobody there;"
        " drive toy may still be under power: drive toy: nobody there"
    )
    assert len(machine.told("quick stop")) == 2, "it was tried again on leaving, for the first was not confirmed"


def test_an_interrupt_while_it_is_disabled_leaves_it_disabled() -> None:
    machine = ToyMachine()
    with pytest.raises(KeyboardInterrupt), toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(at_call=machine.counted + 1)
    assert machine.state is DriveState.SWITCH_ON_DISABLED


def test_several_axes_are_all_told_before_any_is_waited_for_and_all_are_disabled() -> None:
    one, other = ToyMachine(), ToyMachine()
    other.clock = one.clock
    drives = [ToyDrive(one), ToyDrive(other)]
    for drive in drives:
        drive.open()
    order: list[str] = []
    for name, machine in (("one", one), ("other", other)):
        machine.calls = _Told(order, name)
    one.trouble.stop_error = lambda: NoAnswerError("late")
    with (
        pytest.raises(ValueError, match="of the procedure") as caught,
        Supervisor([WatchedAxis(d) for d in drives]) as both,
    ):
        both.enable()
        order.clear()
        raise ValueError("of the procedure")
    assert order[:4] == ["one stop frame", "other stop frame", "one quick stop", "other quick stop"]
    assert {one.state, other.state} == {DriveState.SWITCH_ON_DISABLED}
    assert one_line(caught.value) == "of the procedure; drive toy may still move: late"


class _Told(list[tuple[str, float]]):
    """What a machine was told, in one order with the other machine."""

    def __init__(self, order: list[str], name: str) -> None:
        super().__init__()
        self.order, self.name = order, name

    def append(self, call: tuple[str, float]) -> None:
        super().append(call)
        self.order.append(f"{self.name} {call[0]}")


def test_a_move_that_a_script_started_is_stopped_and_disabled_when_its_block_is_left() -> None:
    for error in (ValueError, KeyboardInterrupt):
        machine = ToyMachine()
        with pytest.raises(error), toy_session(machine) as session:
            session.prepare()
            session.drive.start_move(100.0, 10.0)
            assert machine.moving
            raise error
        assert machine.told("quick stop")
        assert (machine.moving, machine.state) == (False, DriveState.SWITCH_ON_DISABLED)


def test_what_is_told_of_a_begun_move_and_fails_stops_it() -> None:
    machine = ToyMachine()
    drive = ToyDrive(machine)

    def fails() -> None:
        raise LinkLostError("whoever was told")

    with drive, Supervisor([WatchedAxis(drive)]) as supervisor:
        supervisor.enable()
        with pytest.raises(LinkLostError, match="whoever was told"):
            supervisor.move(90.0, 20.0, started=fails)
        assert machine.told("quick stop")
