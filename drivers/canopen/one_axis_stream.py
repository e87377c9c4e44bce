"""Streams to one axis and to several behind the faces that all wires have, over `CyclicStream`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

from drivers.canopen.stream import CyclicStream, StreamSettings
from drivers.clock import NS_PER_S
from drivers.set_points import SetPointGroup, SetPoints, SetPointSettings, SetPointStream

if TYPE_CHECKING:
    from drivers.canopen.drive import CanOpenDrive


def _by_sync(settings: SetPointSettings) -> StreamSettings:
    return StreamSettings(
        settings.period_s, following_error_mm=settings.following_error_mm, missed_limit=settings.missed_limit
    )


class _BySync(SetPoints):
    """SYNC comes from this process. On entering, the axes must be enabled and the bus be able to carry the cycle."""

    def __init__(self, drives: Sequence[CanOpenDrive], settings: SetPointSettings) -> None:
        self._stream = CyclicStream(drives, _by_sync(settings))

    def __enter__(self) -> Self:
        self._stream.__enter__()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stream.__exit__(exc_type, exc, traceback)

    @property
    def missed_cycles(self) -> int:
        return self._stream.counters.missed_cycles


class OneAxisStream(_BySync, SetPointStream):
    """One axis by SYNC."""

    def __init__(self, drive: CanOpenDrive, settings: SetPointSettings) -> None:
        super().__init__([drive], settings)
        self._period_ns = round(settings.period_s * NS_PER_S)
        self._found = 0, math.nan

    def cycle(self, position_load_mm: float) -> float:
        (feedback,) = self._stream.cycle([position_load_mm])
        if not feedback.late:  # it is of the SYNC that this cycle was for
            self._found = self._stream.next_sync_ns - self._period_ns, feedback.position_load_mm
        return feedback.position_load_mm

    @property
    def found(self) -> tuple[int, float]:
        return self._found

    @property
    def reached_ns(self) -> int:
        return self._stream.next_sync_ns


class AxesInStep(_BySync, SetPointGroup):
    """Several axes on one bus, all by one SYNC."""

    def cycle(self, positions_load_mm: Sequence[float]) -> list[float]:
        return [feedback.position_load_mm for feedback in self._stream.cycle(positions_load_mm)]
