"""Drives on several lines, each in a thread of its own: what Ctrl-C does while their ends are waited for."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import WallClock
from drivers.raw_parameters import Pause, Steps
from hil.parameters.tasks import run_together


def together(clock: WallClock, *lines: Callable[[Steps[None]], None], ended: list[int] | None = None) -> None:
    """Endless steps of one drive on each of these lines, which take them as they like; ended: whose steps were ended."""

    def endless(number: int) -> Steps[None]:
        try:
            while True:
                yield Pause(0.001)
        finally:
            if ended is not None:
                ended.append(number)

    def line(take: Callable[[Steps[None]], None]) -> Any:
        def run(works: Sequence[Steps[None]]) -> list[None]:
            for work in works:
                take(work)
            return [None] * len(works)

        return SimpleNamespace(run=run)

    drives: list[Any] = [SimpleNamespace(line=line(take), clock=clock) for take in lines]
    run_together(range(len(lines)), lambda number: drives[number], endless)


def test_ctrl_c_ends_every_line_and_is_raised_when_all_have_ended() -> None:
    ended, both = list[int](), threading.Barrier(2)

    def line(interrupts: bool) -> Callable[[Steps[None]], None]:
        def take(steps: Steps[None]) -> None:
            both.wait()
            for number, _ in enumerate(steps):
                if interrupts and number == 3:
                    os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.002)

        return take

    with pytest.raises(KeyboardInterrupt):
        together(WallClock(), line(True), line(False), ended=ended)
    assert sorted(ended) == [0, 1]


def fails(_steps: Steps[None]) -> None:
    raise ZeroDivisionError


def test_an_error_of_one_line_ends_the_others_and_is_raised() -> None:
    ended = list[int]()

    def runs(steps: Steps[None]) -> None:
        for _ in steps:
            time.sleep(0.002)

    with pytest.raises(ZeroDivisionError):
        together(WallClock(), fails, runs, ended=ended)
    assert ended in ([1], [])  # it may have been ended before its first step


def test_ctrl_c_is_raised_even_where_another_line_has_failed_before() -> None:
    failed = threading.Event()

    def fails_first(steps: Steps[None]) -> None:
        failed.set()
        fails(steps)

    def interrupted(_steps: Steps[None]) -> None:
        failed.wait(10.0)
        time.sleep(0.05)  # the failure has been taken by then
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)

    with pytest.raises(KeyboardInterrupt):
        together(WallClock(), fails_first, interrupted)


def test_a_line_that_hangs_does_not_keep_the_program_from_ending() -> None:
    """Python waits at its end for every thread that is no daemon."""
    daemons = list[bool]()
    together(WallClock(), *[lambda _: daemons.append(threading.current_thread().daemon)] * 2)
    assert daemons == [True, True]
