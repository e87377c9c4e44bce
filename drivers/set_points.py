"""SetPointStream: set-points to one axis, one per period, whatever wire it is on; SetPointGroup: to several in the same periods.

`drivers.paced_stream` is what wires without a SYNC build theirs from; on CANopen `drivers.canopen.stream` paces several axes at once.
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
    """period_s: one set-point each. following_error_mm: largest allowed distance between a position and the set-point before it.

    missed_limit: so many periods in a row may pass without a set-point before the stream is stopped.
    """

    period_s: float
    following_error_mm: float = 1.0
    missed_limit: int = 3

    def __post_init__(self) -> None:
        if not self.period_s > 0:
            raise InputError(f"stream period is {self.period_s} s, expected > 0")


class SetPoints(ABC):
    """A context manager around enabled axes, one or several; leaving it holds them, enabled, an error quick-stops them all."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

    @property
    @abstractmethod
    def missed_cycles(self) -> int:
        """Periods that went by without a new set-point for an axis."""


class SetPointStream(SetPoints):
    """To one axis."""

    @abstractmethod
    def cycle(self, position_load_mm: float) -> float:
        """Give one set-point, wait for its time; the axis's position (load mm) as it was in this cycle, see `found`.

        Raises LimitError before anything is sent, SafetyError (cycles missed), FollowingErrorError, DriveFaultError, StateError,
        TransportError - each with the axis quick-stopped.
        """

    @property
    @abstractmethod
    def reached_ns(self) -> int:
        """The clock's time at which the last set-point is to be reached: one period after it came into force."""

    @property
    @abstractmethod
    def found(self) -> tuple[int, float]:
        """Where the last `cycle` found the axis, load mm, and the clock's time when it was there, as well as the wire can tell."""


class SetPointGroup(SetPoints):
    """To several axes that move together."""

    @abstractmethod
    def cycle(self, positions_load_mm: Sequence[float]) -> list[float]:
        """Give every axis its set-point, wait for their time; the axes' positions (load mm) as they were in this cycle.

        Raises as `SetPointStream.cycle`, with all axes quick-stopped.
        """
