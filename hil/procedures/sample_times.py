"""When the samples of an instrument were taken, in the clock by which the drive is commanded.

A reading tells when it *arrived*, within the time between two looks: milliseconds, where a table at 100 mm/s moves 0.1 mm in each.
But samples come at an even rate, so the arrival of one, found to a microsecond by halving the doubt with each sample, dates all
others. Two such finds, before and after a motion, bear a clock of the instrument that runs a little fast or slow.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.errors import MeasurementLostError
from hil.procedures.session import AxisSession

HALVINGS = 14
"""A sample period halved so often is a few microseconds at most."""


@dataclass(frozen=True)
class Arrival:
    """Sample number `index` arrived by `time_ns`, and not earlier than `doubt_ns` before."""

    index: int
    time_ns: int
    doubt_ns: int


class SampleTimes:
    """Dates the samples of a session's instrument, by their numbers in the session.

    latency_s: from the moment of a sample to its arrival, as the instrument's maker states it. An unknown part of it cannot be told
    from a lag of the table: both are an error in proportion to velocity.
    """

    def __init__(self, session: AxisSession, latency_s: float = 0.0) -> None:
        self._session = session
        self._index = 0
        self._latency_ns = round(latency_s * NS_PER_S)
        self._arrivals: list[Arrival] = []

    def find_arrival(self) -> Arrival:
        """At rest: look ever closer to the moment at which a sample comes. Takes some `HALVINGS` sample periods."""
        clock, period_ns = self._session.clock, self._period_ns()
        self._index = -1
        while self._index < 0:
            clock.sleep_until_ns(clock.now_ns() + period_ns)
            self._look()
        index = self._index
        low_ns, high_ns = clock.now_ns(), clock.now_ns() + period_ns
        for _ in range(HALVINGS):
            middle_ns = (low_ns + high_ns) // 2
            while middle_ns <= clock.now_ns():
                index, low_ns, high_ns, middle_ns = (
                    index + 1,
                    low_ns + period_ns,
                    high_ns + period_ns,
                    middle_ns + period_ns,
                )
            clock.sleep_until_ns(middle_ns)
            self._look()
            if self._index > index:
                high_ns = middle_ns
            else:
                low_ns = middle_ns
                clock.sleep_until_ns(high_ns + 1)
                self._look()
            if self._index <= index:
                raise MeasurementLostError(
                    f"instrument {self._session.instrument.name}: its samples do not come evenly enough to be dated"
                )
        arrival = Arrival(index + 1, high_ns, high_ns - low_ns)
        self._arrivals = [*self._arrivals[-1:], arrival]
        return arrival

    def _look(self) -> None:
        numbered = self._session.readings()
        if numbered:
            self._index = numbered[-1][0]

    def _period_ns(self) -> int:
        rate_hz = self._session.instrument.sample_rate_hz
        if rate_hz is None or not rate_hz > 0:
            raise MeasurementLostError(f"instrument {self._session.instrument.name} has not stated its sample rate")
        return round(NS_PER_S / rate_hz)

    def taken_ns(self, index: int) -> int:
        """When sample `index` was taken, from the last two arrivals that were found. Raises ValueError before there are two."""
        if len(self._arrivals) < 2:
            raise ValueError("two arrivals are needed to date a sample")
        first, last = self._arrivals
        step_ns = (last.time_ns - first.time_ns) / (last.index - first.index)
        return round(first.time_ns + (index - first.index) * step_ns) - self._latency_ns
