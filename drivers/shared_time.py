"""SharedTime: one time limit for stopping, disabling and putting back several axes together, whichever of them do not answer."""

from __future__ import annotations

from drivers.clock import NS_PER_S, Clock


class SharedTime:
    """Runs from the first step that fails; axes that answer are not limited. budget_s: the longest of the axes' limits, s."""

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
