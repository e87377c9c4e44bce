"""SimClock: simulated time; a thread that sleeps on this clock advances the machine instead of waiting.

One thread owns simulated time: the procedure that sleeps. While it sleeps, everything attached is advanced in small steps, in the
order of attachment (the servo with its plant first, then the faces on a wire), so a run depends on its seeds alone and not
on the speed of the host. Calls given to `side_by_side` own it in turns: one of their threads runs, the others sleep.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial

from drivers.clock import NS_PER_S, Clock, Waiting

Advance = Callable[[int, float], None]
"""advance(now_ns, dt_s): advance from now_ns - dt_s to now_ns."""

Bearable = Callable[[int], int]
"""bearable(now_ns): longest allowed length of the next step, ns, at least 1."""

Settle = Callable[[], None]
"""settle(): a sleep is over; put on the wire what is still buffered, before its caller looks."""


BEAT_NS = 10_000_000
"""Interval at which simulated time that is held back (`Waiting`) calls it, s."""


class SimClock(Clock):
    """A clock on which simulated time passes only while a thread sleeps on it.

    step_s: the longest step of anything attached without a `bearable`, s.
    waiting: slows it down, so that a person can watch, and may end a sleep by an error; None: as fast as possible.
    """

    def __init__(self, step_s: float = 0.005, waiting: Waiting | None = None) -> None:
        self._waiting = waiting
        self._step_ns = round(step_s * NS_PER_S)
        self._now_ns = 0
        self._attached: list[Advance] = []
        self._bearable: list[Bearable] = []
        self._settle: list[Settle] = []
        self._all_bear = True  # everything attached has a `bearable`
        self._turns: _Turns | None = None

    def attach(self, advance: Advance, *, bearable: Bearable | None = None, settle: Settle | None = None) -> None:
        """Advance this too, after everything attached before it.

        Steps last as long as the smallest `bearable` allows, and at most `step_s` if anything attached has none.
        """
        self._attached.append(advance)
        if bearable is None:
            self._all_bear = False
        else:
            self._bearable.append(bearable)
        if settle is not None:
            self._settle.append(settle)

    def now_ns(self) -> int:
        return self._now_ns

    def check_interrupt(self) -> None:
        if self._waiting is not None:
            self._waiting.simulated(self._now_ns)

    def sleep_until_ns(self, time_ns: int) -> None:
        if self._now_ns >= time_ns:
            return
        turns = self._turns
        if turns is not None and turns.is_one_of_them():
            turns.sleep_until_ns(time_ns)
            return
        self._pass_until_ns(time_ns)

    def side_by_side(self, works: Sequence[Callable[[], None]]) -> Sequence[Callable[[], None]]:
        turns = self._turns = _Turns(self._now_ns, len(works), self._pass_until_ns)

        def in_turn(number: int, work: Callable[[], None]) -> None:
            turns.begin(number)
            try:
                work()
            finally:
                turns.end()

        return [partial(in_turn, number, work) for number, work in enumerate(works)]

    def _pass_until_ns(self, time_ns: int) -> None:
        if self._now_ns >= time_ns:
            return
        if self._waiting is None:
            self._advance_to(time_ns)
            self._settled()
            return
        try:
            while self._now_ns < time_ns:
                self._advance_to(min(time_ns, self._now_ns + BEAT_NS))
                self._waiting.simulated(self._now_ns)
        finally:
            self._settled()

    def _advance_to(self, time_ns: int) -> None:
        attached, bearable = self._attached, self._bearable
        while (left_ns := time_ns - self._now_ns) > 0:
            step_ns = left_ns if self._all_bear and bearable else min(self._step_ns, left_ns)
            for bears in bearable:
                step_ns = min(step_ns, max(1, bears(self._now_ns)))
            self._now_ns += step_ns
            dt_s = step_ns / NS_PER_S
            for advance in attached:
                advance(self._now_ns, dt_s)

    def _settled(self) -> None:
        for settle in self._settle:
            settle()


class _Turns:
    """Scheduling of several threads on one clock: one runs at a time, and when it sleeps or ends the next is the one whose sleep ends
    first, of equal ones that with the lowest number. So a run with threads is as repeatable as one without.

    pass_until_ns: advances the clock; called by the running thread.
    """

    def __init__(self, now_ns: int, count: int, pass_until_ns: Callable[[int], None]) -> None:
        self._pass_until_ns = pass_until_ns
        self._wakes_ns = dict.fromkeys(range(count), now_ns)  # of the threads that have not ended
        self._runs: int | None = 0
        self._changed = threading.Condition()
        self._own = threading.local()

    def is_one_of_them(self) -> bool:
        """Whether the calling thread is one of these, and has not ended."""
        return getattr(self._own, "number", None) is not None

    def begin(self, number: int) -> None:
        """To be called by each thread first; returns when it may run."""
        self._own.number = number
        self._await(number)

    def sleep_until_ns(self, time_ns: int) -> None:
        """Let the others run until then. Raises the error that ends the sleep; then the calling thread continues."""
        number: int = self._own.number
        self._wakes_ns[number] = time_ns
        following = self._next()
        if following != number:
            self._hand_on(following)
            self._await(number)
        self._pass_until_ns(time_ns)  # this thread's sleep ends first

    def end(self) -> None:
        """To be called by each thread last, however it ended."""
        del self._wakes_ns[self._own.number]
        self._own.number = None
        self._hand_on(self._next() if self._wakes_ns else None)

    def _next(self) -> int:
        return min(self._wakes_ns, key=lambda number: (self._wakes_ns[number], number))

    def _hand_on(self, number: int | None) -> None:
        with self._changed:
            self._runs = number
            self._changed.notify_all()

    def _await(self, number: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._runs == number)
