"""SetPointStream: set-points to one axis, one per period, whatever wire it is on; SetPointGroup: to several in the same periods.

`drivers.paced_stream` builds them for wires without a SYNC; on CANopen `drivers.canopen.stream` paces several axes at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from drivers.errors import InputError, StateError


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


class SetPoints(ABC):
    """A context manager around enabled axes, one or several. Leaving it holds them, enabled; an error quick-stops them all."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

    @property
    @abstractmethod
    def missed_cycles(self) -> int:
        """Number of periods without a new set-point for an axis."""


class SetPointStream(SetPoints):
    """Set-points to one axis."""

    @abstractmethod
    def cycle(self, position_load_mm: float) -> float:
        """Give one set-point, load mm, and wait until its time; the axis's position (load mm) in this cycle, see `found`.

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
        """(clock's time in ns, load mm) of the axis in the last `cycle`, as exactly as the wire can tell."""


class SetPointGroup(SetPoints):
    """Set-points to several axes that move together."""

    @abstractmethod
    def cycle(self, positions_load_mm: Sequence[float]) -> list[float]:
        """Give every axis its set-point (load mm, one per axis), wait until their time; the axes' positions (load mm) in this cycle.

        Raises as `SetPointStream.cycle`, with all axes quick-stopped.
        """

    @property
    @abstractmethod
    def reached_ns(self) -> int:
        """As `SetPointStream.reached_ns`, of the first axis."""

    @property
    @abstractmethod
    def found(self) -> list[tuple[int, float]]:
        """As `SetPointStream.found`, of each axis."""


class FirstOfGroup(SetPointStream):
    """A running group as the stream of its first axis, for readers of that axis. The group's owner gives the set-points."""

    def __init__(self, group: SetPointGroup) -> None:
        self._group = group

    def __enter__(self) -> Self:
        raise StateError("a group of axes is entered by its owner")

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Nothing: the group's owner leaves it."""

    def cycle(self, position_load_mm: float) -> float:
        raise StateError(f"set-point of {position_load_mm:g} mm to one axis of a group, expected one for each")

    @property
    def missed_cycles(self) -> int:
        return self._group.missed_cycles

    @property
    def reached_ns(self) -> int:
        return self._group.reached_ns

    @property
    def found(self) -> tuple[int, float]:
        return self._group.found[0]
