"""WayOut: the time limit for shutting down a drive: one budget for its stop, its power and its settings, whichever step fails.

Without it the time-outs of the steps add up, as each step knows only its own.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from drivers.clock import NS_PER_S, Clock
from drivers.errors import BridgeError

_LEAST_S = 6.0
"""Part of the 10 s from a fault to the end, s. The rest is for noticing it (three requests of 1 s on TCP) and for other devices."""
_MACHINE_S = 10.0
"""Time after its begin after which a failed shutdown is over, s: a later stop or disabling begins another, as after a repair."""
_LEAST_REPLY_S, _LEAST_SILENT_S = 0.5, 0.1
"""Time-out of a request once nothing is left, s: of a unit that answers, and of one that has ceased to. Most answer in 1 to 20 ms, a
slow one in up to 0.3 s."""
_AGAIN_S = 0.5
"""Time for the disabling of a drive after a step that failed, s: fifty slow control cycles."""
POWER_OFF_S = 1.0
"""Part of the budget that the wait for standstill leaves, s: to take the power off, and see it confirmed."""


class WayOut:
    """Time limit of one drive: begun by its first confirmed stop, `disable` or `close`, shared by those that follow.

    braking_s: longest time of braking by the drive's ramp, s. A halt and a quick stop may each have to brake from the axis's highest
    velocity: where both need longer than `_LEAST_S` leaves them, the budget is longer. Counted is the time in the steps, and all time
    once one has failed, by the clock; or the time spent on requests without an answer, if that is more, as it passes in real time
    only. For any thread; waits are limited for the thread that is in a step.

    Axes that shut down together share one such time (`join`). Where axes without an answer have used it up, each of the others
    still has `least_s`, in which an axis brakes and answers.
    """

    def __init__(self, clock: Clock, braking_s: float) -> None:
        self.clock = clock
        self.braking_s = braking_s
        self._shared: _SharedTime | None = None
        self._thread = threading.local()
        self._begun_ns: int | None = None
        self._counted_ns = 0  # time up to here is counted
        self._used_s = self._unanswered_s = 0.0
        self._failed = False

    @property
    def budget_s(self) -> float:
        return max(_LEAST_S, 3.0 + 2.0 * self.braking_s)

    @property
    def least_s(self) -> float:
        return 1.0 + self.braking_s

    def over(self) -> None:
        """For a new connection, or an axis that is enabled again: the next stop begins another limit."""
        self._begun_ns, self._used_s, self._unanswered_s, self._failed = None, 0.0, 0.0, False
        self._shared = None

    def share(self, time: _SharedTime) -> None:
        """Begin here, together with others; one in progress that is shared already continues."""
        if self._inside or (self._recent and self._shared is not None):
            return
        if not self._recent:
            self.over()
            self._begun_ns = self.clock.now_ns()
        self._shared = time
        if self._failed and self._begun_ns is not None:  # what failed before axes were joined counts too
            time.failed(self._begun_ns)
            time.unanswered(self._unanswered_s)

    @contextmanager
    def step(self, *, last: bool) -> Iterator[None]:
        """Context of each step. last: it ends a shutdown in which everything was answered and nothing failed, as the axis is then seen
        without power."""
        if self._inside:
            yield
            return
        now_ns = self.clock.now_ns()
        if not self._recent:
            self.over()
            self._begun_ns = now_ns
        if not self._failed:
            self._counted_ns = now_ns
        self._thread.inside = True
        try:
            yield
        except BridgeError:
            self._failed = True
            if self._shared is not None:
                self._shared.failed(now_ns)
            raise
        finally:
            self._used_s, self._counted_ns = self._spent_s(), self.clock.now_ns()
            self._thread.inside = False
        if last and not self._failed and not self._unanswered_s:
            self.over()

    @property
    def _inside(self) -> bool:
        return bool(getattr(self._thread, "inside", False))

    @property
    def _recent(self) -> bool:
        past_s = math.inf if self._begun_ns is None else (self.clock.now_ns() - self._begun_ns) / NS_PER_S
        return past_s < max(_MACHINE_S, self.budget_s)

    def _spent_s(self) -> float:
        running = self._inside or self._failed
        return self._used_s + running * (self.clock.now_ns() - self._counted_ns) / NS_PER_S

    def left_s(self) -> float:
        """Rest of the budget, s."""
        spent_s = max(self._spent_s(), self._unanswered_s)
        left_s = self.budget_s - spent_s
        if self._shared is not None:
            left_s = min(left_s, max(self._shared.left_s(), self.least_s - spent_s))
        return max(0.0, left_s)

    def within_s(self, own_s: float, *, leave_s: float = 0.0) -> float:
        """Time to wait for something that has own_s by itself, s. leave_s: kept for what comes after it."""
        return min(own_s, max(0.0, self.left_s() - leave_s)) if self._inside else own_s

    def power_off_s(self, own_s: float) -> float:
        """Time to wait for a state without power, s: less for a drive that stayed enabled in an earlier step."""
        return self.within_s(min(own_s, _AGAIN_S) if self._failed else own_s)

    # -- requests ----------------------------------------------------------------------------------------------------
    def _limits_requests(self) -> bool:
        return self._inside or (self._failed and self._recent)

    def gives_up(self, *, silent: bool) -> bool:
        """Whether a request is not even tried: nothing is left for a unit that has ceased to answer."""
        return self._inside and silent and self.left_s() <= 0.0

    def repeats(self, own: int, *, silent: bool) -> int:
        """Number of repeats of a request. silent: the unit has left one unanswered, with repeats, and answered nothing since."""
        return 0 if self._limits_requests() and (silent or self.left_s() <= 0.0) else own

    def reply_s(self, *, silent: bool) -> float:
        """Longest wait for a reply, s."""
        least_s = _LEAST_SILENT_S if silent else _LEAST_REPLY_S
        return max(least_s, self.left_s()) if self._limits_requests() else math.inf

    def busy_s(self, own_s: float) -> float:
        """Longest time that a busy unit is asked again, s: all that is left, as the stop and the power go before everything else."""
        return self.left_s() if self._limits_requests() else own_s

    def unanswered(self, waited_s: float) -> None:
        """A request was not answered for this long, s, which a simulated clock may not show."""
        if self._limits_requests():
            self._unanswered_s += waited_s
            if self._shared is not None:
                self._shared.unanswered(waited_s)


class _SharedTime:
    """Time limit of several axes that are shut down together, whichever of them do not answer.

    Runs from the first step that fails; axes that answer are not limited. budget_s: the longest of the axes' limits, s.
    """

    def __init__(self, clock: Clock, budget_s: float) -> None:
        self._clock = clock
        self._budget_s = budget_s
        self._since_ns: int | None = None
        self._unanswered_s = 0.0

    def failed(self, began_ns: int) -> None:
        """A step of one axis, begun at this time (ns), has failed."""
        if self._since_ns is None:
            self._since_ns = began_ns

    def unanswered(self, waited_s: float) -> None:
        """A request was not answered for this much real time, s, which a simulated clock does not show."""
        self._unanswered_s += waited_s

    def left_s(self) -> float:
        if self._since_ns is None:
            return self._budget_s
        past_s = (self._clock.now_ns() - self._since_ns) / NS_PER_S
        return max(0.0, self._budget_s - max(past_s, self._unanswered_s))


def join(ways: Sequence[WayOut]) -> None:
    """Give axes that shut down together one common time limit."""
    if len(ways) > 1:
        time = _SharedTime(ways[0].clock, max(way.budget_s for way in ways))
        for way in ways:
            way.share(time)
