"""Long computations within a procedure: in the axis's thread (`at_once`), or in a second thread while the axis is watched (`watched`).

At once, a simulated clock does not advance, so that the same rows give the same figures at any load of the host.
Watched, the drive of a real axis is sampled during the computation, and a stop is carried out during it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Protocol, TypeVar

from hil.machine.session import AxisSession
from hil.machine.supervisor import SLICE_S

Result = TypeVar("Result")


class Computing(Protocol):
    """A way to run a long computation."""

    def __call__(self, session: AxisSession, work: Callable[[], Result], /) -> Result:
        """Returns the result of `work`. Raises what `work` raises, and what watching the axis raises."""


def at_once(_session: AxisSession, work: Callable[[], Result], /) -> Result:
    """Run in the axis's own thread. Raises what `work` raises."""
    return work()


def watched(session: AxisSession, work: Callable[[], Result], /) -> Result:
    """Run in a second thread, watching the axis meanwhile. Raises what `work` raises, and what watching raises; in the second case the
    computation ends by itself and its result is dropped."""
    pool = ThreadPoolExecutor(1, "computing")
    try:
        computed = pool.submit(work)
        while not computed.done():
            session.watch(SLICE_S)
            wait([computed], timeout=SLICE_S / 2)  # where time is simulated, watching takes none
        return computed.result()
    finally:
        pool.shutdown(wait=False)
