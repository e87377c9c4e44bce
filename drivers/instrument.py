"""DistanceInstrument: measures the position of the table itself, with the environment sensors beside it.

An instrument is *polled*: `poll()` returns the readings that have arrived since the last call and never waits, so that one thread can
watch drive and instrument together. Every reading carries its status and its time of arrival; a reading without a good status has no
position.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Self


class ReadingStatus(Enum):
    """Status of a reading; only GOOD has a position. LOST_BEFORE: the signal is back, and nobody has acknowledged its loss."""

    GOOD = "good"
    BEAM_LOST = "beam lost"
    HEAD_ERROR = "head error"
    OVERSPEED = "overspeed"
    LOST_BEFORE = "its signal was lost before, and with it its zero: acknowledge_loss() uses it again"


@dataclass(frozen=True)
class Reading:
    """One reading of the displacement.

    position_mm is in the instrument's own frame (its zero, its direction) and None unless the status is GOOD;
    sequence counts the instrument's samples, and lost_before is the number missing just before this one.
    time_ns: arrival; since_ns: the earliest possible time of the sample (the poll or the request before it), None where time_ns
    is exact. How long bytes wait in a serial port that is not polled, no instrument reports, so both bounds travel with the value.
    """

    time_ns: int
    status: ReadingStatus
    position_mm: float | None
    sequence: int
    lost_before: int = 0
    since_ns: int | None = None

    @property
    def earliest_ns(self) -> int:
        """The earliest time at which the sample can have been taken, ns."""
        return self.time_ns if self.since_ns is None else self.since_ns

    def age_ns(self, now_ns: int) -> int:
        """Largest possible age of the value at `now_ns`, ns."""
        return now_ns - self.earliest_ns


@dataclass(frozen=True)
class Environment:
    """The latest value of every environment channel; None: never received. A place is what the axis file calls it.

    beside: quantities measured together with the position, such as the table's angles, by the name of its record column
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
    """Whether `Reading.sequence` is the instrument's own counter, which goes on from one connection to the next while it has power."""
    answers_when_asked = False
    """Whether each poll brings one reading at most, requested by the poll before: such an instrument has to be polled often."""

    @abstractmethod
    def open(self) -> None:
        """Connect. Does not change the instrument's zero. Raises LinkLostError."""

    @abstractmethod
    def close(self) -> None:
        """Disconnect; never raises for a link that is already lost."""

    @abstractmethod
    def poll(self) -> Sequence[Reading]:
        """All readings that arrived since the last call, oldest first; empty when none did. Never waits.

        Raises LinkLostError when the port is gone. A later call may find it plugged in again.
        """

    def acknowledge_loss(self) -> bool:
        """After a lost signal, allow positions again, from another zero; whether one was lost since the last call."""
        return False

    @abstractmethod
    def environment(self) -> Environment:
        """The latest environment values received; None where there are none."""

    @property
    @abstractmethod
    def sample_rate_hz(self) -> float | None:
        """Readings per second as the instrument states it, None while unknown."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
