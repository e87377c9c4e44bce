"""Every step on the way out is tried; what failed is told in one line, in the order of danger."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.errors import LinkLostError, NoAnswerError, ProtocolError, UndoError
from drivers.undo import Step, one_line, undo_all


def _fails(error: BaseException) -> Callable[[], None]:
    def step() -> None:
        raise error

    return step


def _steps(done: list[str], *failures: BaseException | None) -> list[Step]:
    steps: list[Step] = []
    for number, error in enumerate(failures):
        name = f"step {number}"
        steps.append((name, (lambda name=name: done.append(name)) if error is None else _fails(error)))  # type: ignore[misc]
    return steps


def test_one_failure_is_raised_as_it_is() -> None:
    done: list[str] = []
    error = NoAnswerError("silent")
    with pytest.raises(NoAnswerError) as caught:
        undo_all(_steps(done, None, error, None))
    assert caught.value is error
    assert done == ["step 0", "step 2"]


def test_several_failures_are_one_line_in_the_order_of_the_steps() -> None:
    done: list[str] = []
    first, second = NoAnswerError("not disabled"), LinkLostError("not put back")
    with pytest.raises(UndoError, match=r"^step 0: not disabled; step 2: not put back$") as caught:
        undo_all(_steps(done, first, None, second))
    assert caught.value.errors == (first, second)
    assert done == ["step 1"]


def test_what_several_steps_of_a_step_report_counts_one_by_one() -> None:
    inner = [("a", _fails(NoAnswerError("silent"))), ("b", _fails(ProtocolError("odd")))]
    with pytest.raises(UndoError, match=r"^PDOs: a: silent; b: odd; lost$") as caught:
        undo_all([("PDOs", lambda: undo_all(inner)), ("", _fails(LinkLostError("lost")))])
    assert [type(error) for error in caught.value.errors] == [NoAnswerError, ProtocolError, LinkLostError]


@pytest.mark.parametrize("interrupt", [KeyboardInterrupt(), ZeroDivisionError()])
def test_an_interrupt_ends_its_step_only(interrupt: BaseException) -> None:
    done: list[str] = []
    with pytest.raises(type(interrupt)) as caught:
        undo_all(_steps(done, None, interrupt, NoAnswerError("silent"), None))
    assert done == ["step 0", "step 3"]
    assert one_line(caught.value) == "step 2: silent"


def test_the_error_that_led_here_is_the_one_to_raise() -> None:
    led_here = ProtocolError("no acknowledge")
    undo_all([("", _fails(NoAnswerError("silent"))), ("mode", _fails(NoAnswerError("lost")))], during=led_here)
    assert one_line(led_here) == "no acknowledge; silent; mode: lost"


def test_nothing_is_raised_when_nothing_fails() -> None:
    done: list[str] = []
    undo_all(_steps(done, None, None))
    assert done == ["step 0", "step 1"]
