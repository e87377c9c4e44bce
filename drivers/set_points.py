"""SetPointStream: set-points to one axis, or to several that move together, one each per period, whatever wire they are on.

`drivers.paced_stream` paces them by the host's clock, for wires without a SYNC; on CANopen `drivers.canopen.stream` does by SYNC.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from drivers.errors import InputError


@dataclass(frozen=True)
class SetPointSettings:
    """period_s: one set-point each, s. following_error_mm: largest allowed distance between a position and the set-point before it,
    mm.

    missed_limit: number of consecutive periods without a set-point after which the stream is stopped.
    """

    period_s: float
    following_error_mm: float = 1.0
    missed_limit: int = 3

    def __post_init__(self) -> None:
        if not self.period_s > 0:
            raise InputError(f"stream period is {self.period_s} s, expected > 0")


class SetPointStream(ABC):
    """A context manager around enabled axes. Leaving it holds them, enabled; an error quick-stops them all.

    missed_cycles: number of periods without new set-points. reached_ns: the clock's time at which the last set-points are to be
    reached: one period after they came into force. found: (clock's time in ns, load mm) of each axis in the last `cycle`, as exactly
    as the wire can tell.
    """

    missed_cycles: int
    reached_ns: int
    found: list[tuple[int, float]]

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

    @abstractmethod
    def cycle(self, positions_load_mm: Sequence[float]) -> None:
        """Give every axis its set-point (load mm, one per axis) and wait until their time; `found` then has the axes' positions.

        Raises LimitError before anything is sent, SafetyError (cycles missed), FollowingErrorError, DriveFaultError, StateError,
        TransportError - each with all axes quick-stopped; InputError for another number of set-points.
        """
