"""Drives on several lines, each in a thread of its own: what Ctrl-C does while their ends are waited for."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable

import pytest

from drivers.clock import WallClock
from drivers.raw_parameters import Pause, Steps
from hil.parameters.tasks import _in_threads

Guard = Callable[[Steps[None]], Steps[None]]


def endless(ended: list[str], name: str) -> Steps[None]:
    try:
        while True:
            yield Pause(0.001)
    finally:
        ended.append(name)


def test_ctrl_c_ends_every_line_and_is_raised_when_all_have_ended() -> None:
    clock, ended, both = WallClock(), list[str](), threading.Barrier(2)

    def line(name: str) -> Callable[[Guard], None]:
        def run(guard: Guard) -> None:
            both.wait()
            for number, _ in enumerate(guard(endless(ended, name))):
                if name == "X" and number == 3:
                    os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.002)

        return run

    with pytest.raises(KeyboardInterrupt):
        _in_threads([(clock, line("X")), (clock, line("Y"))])
    assert sorted(ended) == ["X", "Y"]


def test_an_error_of_one_line_ends_the_others_and_is_raised() -> None:
    clock, ended = WallClock(), list[str]()

    def fails(_guard: Guard) -> None:
        raise ZeroDivisionError

    def runs(guard: Guard) -> None:
        for _ in guard(endless(ended, "Y")):
            time.sleep(0.002)

    with pytest.raises(ZeroDivisionError):
        _in_threads([(clock, fails), (clock, runs)])
    assert ended in (["Y"], [])  # it may have been ended before its first step


def test_ctrl_c_is_raised_even_where_another_line_has_failed_before() -> None:
    clock, failed = WallClock(), threading.Event()

    def fails(_guard: Guard) -> None:
        failed.set()
        raise ZeroDivisionError

    def interrupted(guard: Guard) -> None:
        failed.wait(10.0)
        time.sleep(0.05)  # the failure has been taken by then
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)

    with pytest.raises(KeyboardInterrupt):
        _in_threads([(clock, fails), (clock, interrupted)])


def test_a_line_that_hangs_does_not_keep_the_program_from_ending() -> None:
    """Python waits at its end for every thread that is no daemon."""
    clock, daemons = WallClock(), list[bool]()
    _in_threads([(clock, lambda _guard: daemons.append(threading.current_thread().daemon))] * 2)
    assert daemons == [True, True]
