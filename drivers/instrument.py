"""DistanceInstrument: what measures the table itself, and the environment sensors beside it.

An instrument is *polled*: `poll()` returns whatever arrived since the last call, without waiting, so one thread can watch
drive and instrument together and no reading is ever waited for while an axis moves unwatched. Every reading carries its status
and the time it arrived; a reading without a good status has no position.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Self


class ReadingStatus(Enum):
    GOOD = "good"
    BEAM_LOST = "beam lost"
    HEAD_ERROR = "head error"
    OVERSPEED = "overspeed"


@dataclass(frozen=True)
class Reading:
    """One reading of the displacement.

    position_mm is in the instrument's own frame (its zero, its direction) and None unless the status is GOOD;
    sequence counts the instrument's samples, and lost_before how many are missing just before this one.
    time_ns: when it was here; since_ns: it was taken no earlier than then (the look or the request before it), None where time_ns
    is exact. How long bytes wait in a serial port nobody looks at, no instrument tells, so both travel with the value.
    """

    time_ns: int
    status: ReadingStatus
    position_mm: float | None
    sequence: int
    lost_before: int = 0
    since_ns: int | None = None

    @property
    def earliest_ns(self) -> int:
        """The earliest moment at which it can have been taken."""
        return self.time_ns if self.since_ns is None else self.since_ns

    def age_ns(self, now_ns: int) -> int:
        """How old the value is at most."""
        return now_ns - self.earliest_ns


@dataclass(frozen=True)
class Environment:
    """The latest of every environment channel; None is 'never heard', a place is what the axis file calls it.

    beside: what else the instrument measures with the position, such as the table's angles, by the name of its record column
    """

    time_ns: int
    air_temp_c: float | None = None
    air_pressure_hpa: float | None = None
    air_humidity_percent: float | None = None
    place_temps_c: dict[str, float] = field(default_factory=dict)
    beside: dict[str, float] = field(default_factory=dict)


class DistanceInstrument(ABC):
    """A laser interferometer, length gauge or scale that reads the load's position."""

    name: str
    numbers_samples = False
    """`Reading.sequence` is the instrument's own and goes on from one connection to the next for as long as it has power."""
    answers_when_asked = False
    """Each look brings one reading at most, asked for by the look before: it wants to be looked at often."""

    @abstractmethod
    def open(self) -> None:
        """Connect. Does not change the instrument's zero."""

    @abstractmethod
    def close(self) -> None:
        """Let go; never raises for a link that is already dead."""

    @abstractmethod
    def poll(self) -> Sequence[Reading]:
        """All readings that arrived since the last call, oldest first; empty when none did. Never waits.

        Raises LinkLostError when the port is gone. Looking again may find it plugged in again.
        """

    def acknowledge_loss(self) -> None:  # noqa: B027 - most instruments have nothing to forget
        """After a lost signal, give positions again; their zero may be a new one."""

    @abstractmethod
    def environment(self) -> Environment:
        """The latest environment values heard, possibly none."""

    @property
    @abstractmethod
    def sample_rate_hz(self) -> float | None:
        """Readings per second as the instrument states it, None while unknown."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
