"""Simulated time: whoever sleeps on this clock makes the machine move on instead of waiting.

One thread owns simulated time: the procedure that sleeps. While it sleeps, everything attached is advanced in small steps, in the
order of attachment (the servo with its plant first, then what shows them on a wire), so a run depends on its seeds alone and not
on how fast the host is.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.clock import NS_PER_S, Clock, Waiting

Advance = Callable[[int, float], None]
"""advance(now_ns, dt_s): bring yourself from now_ns - dt_s to now_ns."""

Bearable = Callable[[int], int]
"""bearable(now_ns): how many ns the next step may last without you missing anything, at least 1."""

Settle = Callable[[], None]
"""settle(): a sleep is over and its sleeper is about to look; put on the wire what you still hold."""


BEAT_NS = 10_000_000
"""How often simulated time that is held back (`Waiting`) asks how long it should last."""


class SimClock(Clock):
    """A clock whose sleep is the only thing that makes simulated time pass.

    step_s: the longest step of anything that does not say itself how long a step it can bear.
    waiting: who holds it back, so that a person can watch, and may end a sleep by an error; None: as fast as it goes.
    """

    def __init__(self, step_s: float = 0.005, waiting: Waiting | None = None) -> None:
        self._waiting = waiting
        self._step_ns = round(step_s * NS_PER_S)
        self._now_ns = 0
        self._attached: list[Advance] = []
        self._bearable: list[Bearable] = []
        self._settle: list[Settle] = []
        self._all_bear = True  # everything attached states its own longest step

    def attach(self, advance: Advance, *, bearable: Bearable | None = None, settle: Settle | None = None) -> None:
        """Advance this too, after everything attached before it.

        Steps last as long as the least patient bears, and `step_s` at most if anything attached does not say.
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
