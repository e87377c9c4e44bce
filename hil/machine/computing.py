"""What takes seconds to compute in the middle of a procedure: at once, or aside while the axis goes on being watched.

Computed at once, time stands still for a simulated axis, and the same rows give the same figures whatever the host is busy with.
Watched, nobody at a real axis waits: the drive is looked at, and a stop is carried out in the middle of it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Protocol, TypeVar

from hil.machine.session import AxisSession
from hil.machine.supervisor import SLICE_S

Result = TypeVar("Result")


class Computing(Protocol):
    """How a procedure has something computed."""

    def __call__(self, session: AxisSession, work: Callable[[], Result], /) -> Result:
        """The result of `work`; raises what it raises, and what watching the axis raises."""


def at_once(_session: AxisSession, work: Callable[[], Result], /) -> Result:
    """In the axis's own thread."""
    return work()


def watched(session: AxisSession, work: Callable[[], Result], /) -> Result:
    """In a thread of its own. When watching raises, what is being computed is left to end by itself and forgotten."""
    pool = ThreadPoolExecutor(1, "computing")
    try:
        computed = pool.submit(work)
        while not computed.done():
            session.watch(SLICE_S)
            wait([computed], timeout=SLICE_S / 2)  # where time is simulated, watching takes none
        return computed.result()
    finally:
        pool.shutdown(wait=False)
