"""Back-off after wrong passwords and tokens: after the first, a slip, each doubles the wait before the next is looked at."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

FIRST_S, LONGEST_S = 1.0, 60.0
"""Wait after the second wrong one and the longest wait, s: at the longest, a year has half a million attempts."""
_MOST = 1000


class BackOff:
    """Waits by key (an address, a role), for any thread. A right one ends its key's wait. The latest `_MOST` keys are kept."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = monotonic_s
        self._lock = threading.Lock()
        self._wrong: OrderedDict[str, tuple[int, float]] = OrderedDict()  # number in a row, end of the wait

    def wait_s(self, key: str) -> float:
        """Time until the next attempt of this key counts, s; 0 for none."""
        with self._lock:
            return max(0.0, self._wrong.get(key, (0, 0.0))[1] - self._now_s())

    def wrong(self, key: str) -> int:
        """Note a wrong one; how many in a row."""
        with self._lock:
            count = self._wrong.pop(key, (0, 0.0))[0] + 1
            wait_s = 0.0 if count == 1 else min(LONGEST_S, FIRST_S * 2.0 ** min(count - 2, 10))
            self._wrong[key] = (count, self._now_s() + wait_s)
            if len(self._wrong) > _MOST:
                self._wrong.popitem(last=False)
            return count

    def right(self, key: str) -> None:
        with self._lock:
            self._wrong.pop(key, None)
