"""WayOut: the time limit for shutting down a drive: one budget for its stop, its power and its settings, whichever step fails.

Without it the time-outs of the steps add up, as each step knows only its own.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.clock import NS_PER_S, Clock
from drivers.drive import DriveLimits
from drivers.errors import BridgeError
from drivers.shared_time import SharedTime

_LEAST_S = 6.0
"""Part of the 10 s from a fault to the end, s. The rest is for noticing it (three requests of 1 s on TCP) and for other devices."""
_MACHINE_S = 10.0
"""Time after its begin after which a failed shutdown is over, s: a later stop or disabling begins another, as after a repair."""
_LEAST_REPLY_S = 0.1
"""Time-out of a request once nothing is left, s: any drive that works answers within it (most take 1 to 20 ms)."""
POWER_OFF_S = 1.0
"""Part of the budget that the wait for standstill leaves, s: to take the power off, and see it confirmed."""


class WayOut:
    """Time limit of one drive: begun by its first stop, `disable` or `close`, shared by those that follow.

    A halt and a quick stop may each have to brake from the axis's highest velocity by its acceleration: where both need longer than
    `_LEAST_S` leaves them, the budget is longer. Counted is the time in the steps, and all time once one has failed, by the clock;
    or the time spent on requests without an answer, if that is more, as it passes in real time only. For any thread; waits are
    limited for the thread that is in a step.

    Axes that shut down together share one such time (`share`). Where axes without an answer have used it up, each of the others still
    has `least_s`, in which an axis brakes and answers.
    """

    def __init__(self, clock: Clock, limits: DriveLimits) -> None:
        self._clock = clock
        self.budget_s = max(_LEAST_S, 3.0 + 2.0 * limits.max_velocity_mm_s / limits.max_acceleration_mm_s2)
        self.least_s = 1.0 + limits.max_velocity_mm_s / limits.max_acceleration_mm_s2
        self._shared: SharedTime | None = None
        self._thread = threading.local()
        self._begun_ns: int | None = None
        self._counted_ns = 0  # time up to here is counted
        self._used_s = self._unanswered_s = 0.0
        self._failed = False

    def over(self) -> None:
        """For a new connection, or an axis that is enabled again: the next stop begins another limit."""
        self._begun_ns, self._used_s, self._unanswered_s, self._failed = None, 0.0, 0.0, False
        self._shared = None

    def share(self, time: SharedTime) -> None:
        """Begin here, together with others; one in progress that is shared already continues."""
        if self._inside or (self._recent and self._shared is not None):
            return
        if not self._recent:
            self.over()
            self._begun_ns = self._clock.now_ns()
        self._shared = time
        if self._failed and self._begun_ns is not None:  # what failed before axes were joined counts too
            time.failed(self._begun_ns)
            time.unanswered(self._unanswered_s)

    @contextmanager
    def step(self, *, last: bool) -> Iterator[None]:
        """Context of each step. last: it ends a shutdown in which nothing has failed, as the axis is then seen without power."""
        if self._inside:
            yield
            return
        now_ns = self._clock.now_ns()
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
            self._used_s, self._counted_ns = self._spent_s(), self._clock.now_ns()
            self._thread.inside = False
        if last and not self._failed:
            self.over()

    @property
    def _inside(self) -> bool:
        return bool(getattr(self._thread, "inside", False))

    @property
    def _recent(self) -> bool:
        past_s = math.inf if self._begun_ns is None else (self._clock.now_ns() - self._begun_ns) / NS_PER_S
        return past_s < max(_MACHINE_S, self.budget_s)

    def _spent_s(self) -> float:
        running = self._inside or self._failed
        return self._used_s + running * (self._clock.now_ns() - self._counted_ns) / NS_PER_S

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

    # -- requests ----------------------------------------------------------------------------------------------------
    def _limits_requests(self) -> bool:
        return self._inside or (self._failed and self._recent)

    def repeats(self, own: int, *, silent: bool) -> int:
        """Number of repeats of a request. silent: the unit has left one unanswered, with repeats, and answered nothing since."""
        return 0 if self._limits_requests() and (silent or self.left_s() <= 0.0) else own

    def reply_s(self) -> float:
        """Longest wait for a reply, s."""
        return max(_LEAST_REPLY_S, self.left_s()) if self._limits_requests() else math.inf

    def busy_s(self, own_s: float) -> float:
        """Longest time that a busy unit is asked again, s: all that is left, as the stop and the power go before everything else."""
        return self.left_s() if self._limits_requests() else own_s

    def unanswered(self, waited_s: float) -> None:
        """A request was not answered for this much real time, s."""
        if self._limits_requests():
            self._unanswered_s += waited_s
            if self._shared is not None:
                self._shared.unanswered(waited_s)
