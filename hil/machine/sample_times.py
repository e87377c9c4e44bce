"""Sample times of an instrument, in the clock by which the drive is commanded.

A reading states when it *arrived*, to within the interval between two polls: milliseconds, in each of which a table at 100 mm/s moves
0.1 mm. Samples come at an even rate, so a straight line of arrival time over sample number dates all of them. Before and after a
motion, at rest, a search narrows the arrival of single samples to microseconds on an even link; on an uneven link the spread of the
arrivals limits it. Arrivals during the motion are not used: polls then come at an even rate too, so that all of them may be late by
the same.

An instrument that answers requests takes its sample soon after the request: there the time of the request dates the sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import MeasurementLostError
from drivers.instrument import Reading
from hil.machine.session import AxisSession

NARROWINGS = 60
"""Most samples of one search for an arrival. On an even link each narrows the window of the one before."""
FINEST_NS = 2000
"""Width of the window, ns, at which the search ends: clocks and polls are no better."""
WIDER = 1.1
"""Factor by which the next window is wider than the last, for a rate that is not quite even."""
_AT_FIRST = 8
"""Part of the period, 1/8, that the first window has; also the number of samples that the period is measured over."""
_EVEN, _UNEVEN = (-3, -1, 0, 1), tuple(range(-6, 7))
"""Polls around the time at which a sample is due, in halves of its window."""
_MISSES = 3
"""After so many samples outside their window the link counts as uneven. From then on all samples are searched in one window of equal
steps, so that the window does not depend on the sample before; the mean of the arrivals is used."""
_SILENT_S = 5.0
"""Longest wait for a sample, s."""


@dataclass(frozen=True)
class Arrival:
    """Sample number `index` arrived by `time_ns`, and at most `doubt_ns` earlier, ns."""

    index: int
    time_ns: int
    doubt_ns: int

    @property
    def middle_ns(self) -> float:
        """Middle of the interval in which it arrived, ns."""
        return self.time_ns - self.doubt_ns / 2


class SampleDating(ABC):
    """Times of samples by their numbers in the session.

    latency_s: from the moment of a sample to its arrival, s. For an instrument that answers requests it counts to the request and is
    negative. See `hil.figures.latency`.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self._latency_ns = round(latency_s * NS_PER_S)

    def taken_ns(self, index: int, reading: Reading) -> int:
        """When a sample was taken, ns. Raises ValueError before two arrivals were found."""
        return round(self.arrived_ns(index, reading)) - self._latency_ns

    @abstractmethod
    def arrived_ns(self, index: int, reading: Reading) -> float:
        """When it arrived, or was requested, ns."""

    @abstractmethod
    def find_arrival(self) -> Arrival:
        """Find the arrival of a sample closely; call at rest, before and after a motion.

        Raises MeasurementLostError when no sample comes, and what watching the axis raises.
        """


def sample_dating(session: AxisSession, latency_s: float = 0.0) -> SampleDating:
    """By arrivals or by requests, as the session's instrument works. latency_s: see `SampleDating`."""
    if session.instrument.answers_when_asked:
        return RequestTimes(session, latency_s)
    return SampleTimes(session, latency_s)


class SampleTimes(SampleDating):
    """Sample times of an instrument that sends by itself."""

    def __init__(self, session: AxisSession, latency_s: float = 0.0) -> None:
        super().__init__(latency_s)
        self._session = session
        self._seen: list[Arrival] = []
        self._finds = 0
        self._last_find = 0  # index in `_seen` at which the last search began
        self._line: tuple[int, tuple[float, float, float, float]] | None = None

    # -- at rest -------------------------------------------------------------------------------------------------------------
    def find_arrival(self) -> Arrival:
        """Narrow the window around the expected arrival, sample by sample, to `FINEST_NS` or for `NARROWINGS` samples."""
        self._seen, self._last_find = self._seen[self._last_find :], len(self._seen) - self._last_find
        period_ns = self._period_ns()
        best = arrival = self._next(period_ns / _AT_FIRST)
        due_ns, half_ns = arrival.middle_ns, WIDER * arrival.doubt_ns / 2
        missed = 0
        for _ in range(NARROWINGS):
            if best.doubt_ns <= FINEST_NS:
                break
            while due_ns - _UNEVEN[-1] * half_ns <= self._session.clock.now_ns():
                due_ns += period_ns
            arrival, expected = self._expect(due_ns, half_ns, _EVEN if missed < _MISSES else _UNEVEN)
            if missed >= _MISSES:
                if arrival.doubt_ns > 1.5 * half_ns:  # before the first look
                    due_ns -= _UNEVEN[-1] / 2 * half_ns
            elif expected:
                due_ns, half_ns = arrival.middle_ns, max(WIDER * arrival.doubt_ns / 2, FINEST_NS / 4)
            else:
                missed += 1
                half_ns = min(2 * half_ns, period_ns / _AT_FIRST)
                if missed == _MISSES:
                    del self._seen[self._last_find :]
            if arrival.doubt_ns < best.doubt_ns:
                best = arrival
        self._finds += 1
        return best

    def _expect(self, due_ns: float, half_ns: float, looks: tuple[int, ...]) -> tuple[Arrival, bool]:
        """The next arrival, and whether it was within `half_ns` of the time at which it was due."""
        for off in looks:
            fresh = self._look_at(due_ns + off * half_ns)
            if fresh:
                return fresh[-1], off in (0, 1)
        return self._next(half_ns), False

    def _next(self, step_ns: float) -> Arrival:
        """Poll every `step_ns` until a sample comes."""
        clock = self._session.clock
        deadline = clock.deadline(_SILENT_S)
        self._look_at(clock.now_ns())  # what is in the receive buffer is of unknown age
        while not deadline.expired:
            if fresh := self._look_at(clock.now_ns() + step_ns):
                return fresh[-1]
        raise MeasurementLostError(f"instrument {self._session.instrument.name}: no sample in {_SILENT_S:g} s")

    def _look_at(self, time_ns: float) -> list[Arrival]:
        self._session.clock.sleep_until_ns(round(time_ns))
        numbered = self._session.readings()
        fresh = [Arrival(index, r.time_ns, r.time_ns - r.earliest_ns) for index, r in numbered]
        self._seen += fresh[-1:]
        return fresh

    def _period_ns(self) -> float:
        """Sample period, ns: from the rate that the instrument states, or measured."""
        rate_hz = self._session.instrument.sample_rate_hz
        if rate_hz is not None and rate_hz > 0:
            return NS_PER_S / rate_hz
        first = self._next(NS_PER_S / 200)
        last = first
        for _ in range(_AT_FIRST):
            last = self._next(NS_PER_S / 200)
        return (last.middle_ns - first.middle_ns) / max(1, last.index - first.index)

    # -- dates ---------------------------------------------------------------------------------------------------------------
    def arrived_ns(self, index: int, reading: Reading) -> float:
        """By the line through the arrivals of the last two searches, ns. Raises ValueError before there are two."""
        del reading
        if self._finds < 2:
            raise ValueError("two arrivals are needed to date a sample")
        if self._line is None or self._line[0] != self._finds:
            self._line = self._finds, self._fitted()
        first_index, first_ns, offset_ns, period_ns = self._line[1]
        return first_ns + offset_ns + (index - first_index) * period_ns

    def _fitted(self) -> tuple[float, float, float, float]:
        """First index, first time, offset and period, ns, of the line: least squares, each arrival weighted by its window's variance
        plus the variance of the link, which is estimated from the residuals."""
        widest_ns = 2.0 * float(np.median([seen.doubt_ns for seen in self._seen]))
        closely = [
            seen for seen in self._seen if seen.doubt_ns <= widest_ns
        ]  # those that were in the receive buffer are wide
        index = np.array([seen.index for seen in closely], dtype=np.float64)
        middle_ns = np.array([seen.middle_ns for seen in closely])
        width_ns = np.maximum([seen.doubt_ns for seen in closely], FINEST_NS / 4)
        rows = np.column_stack([np.ones_like(index), index - index[0]])
        known = width_ns**2 / 12.0
        uneven = 0.0
        for _ in range(3):
            weight = 1.0 / (known + uneven)
            root = np.sqrt(weight)
            line = np.linalg.lstsq(rows * root[:, None], (middle_ns - middle_ns[0]) * root, rcond=None)[0]
            residual = middle_ns - middle_ns[0] - rows @ line
            uneven = max(0.0, float(np.average(residual**2 - known, weights=weight**2)))
        return float(index[0]), float(middle_ns[0]), float(line[0]), float(line[1])


class RequestTimes(SampleDating):
    """Sample times of an instrument that answers requests: each sample is dated by its request."""

    def __init__(self, session: AxisSession, latency_s: float = 0.0) -> None:
        super().__init__(latency_s)
        self._session = session

    def find_arrival(self) -> Arrival:
        """The next answer, between its request and now; no search is needed. Raises MeasurementLostError when none comes."""
        deadline = self._session.clock.deadline(_SILENT_S)
        while not deadline.expired:
            self._session.clock.sleep_s(0.005)
            if numbered := self._session.readings():
                index, reading = numbered[-1]
                return Arrival(index, reading.time_ns, reading.time_ns - reading.earliest_ns)
        raise MeasurementLostError(f"instrument {self._session.instrument.name}: no sample in {_SILENT_S:g} s")

    def arrived_ns(self, index: int, reading: Reading) -> float:
        """When it was requested, ns."""
        del index
        return float(reading.earliest_ns)
