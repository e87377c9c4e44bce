"""A job's questions to the operator: asked in the axis's thread, answered from any thread.

The axis is watched while its job waits, so that a stop ends the wait. The wait has a time limit by the axis's clock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import Clock
from hil.desk.job import Question
from hil.machine.supervisor import SLICE_S


@dataclass(frozen=True)
class Pending:
    """A question without an answer. number: of the question at this axis."""

    number: int
    question: Question


class Asking:
    """One question at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pending: Pending | None = None
        self._asked = 0
        self._given: bool | None = None
        self._answered = threading.Event()

    @property
    def pending(self) -> Pending | None:
        """The present question, None for none."""
        with self._lock:
            return self._pending

    def answer(self, number: int, yes: bool) -> None:
        """Answer the question of this number; ignored when it is no longer asked. For any thread."""
        with self._lock:
            if self._pending is not None and self._pending.number == number and not self._answered.is_set():
                self._given = yes
                self._answered.set()

    def ask(self, question: Question, clock: Clock, watch: Callable[[float], object]) -> bool | None:
        """Ask, in the axis's thread; returns the answer, None when there was none in time.

        watch: lets so many seconds of the axis's time pass. What it raises, as at a stop, ends the question and is raised.
        """
        with self._lock:
            self._asked += 1
            self._pending, self._given = Pending(self._asked, question), None
            self._answered.clear()
        deadline = clock.deadline(question.within_s)
        try:
            while not deadline.expired:
                watch(SLICE_S)
                if self._answered.wait(SLICE_S / 2):  # where time is simulated, watching takes none
                    return self._given
            return None
        finally:
            with self._lock:
                self._pending = None
