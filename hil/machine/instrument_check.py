"""Agreement check: the instrument's travel against the motor's. Does no I/O.

The zeros of the two do not matter. The range of `reading - motor` since `forget` must not exceed the errors of a machine, whatever
status the instrument reports. Each check returns what is wrong as a sentence.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.instrument import Reading
from hil.axis.agreement import DATED_WITHIN_S, AgreementLimits

SHARE_OF_TRAVEL = 1e-3
"""Allowed difference per travel, besides the limits of the axis file: class C10 of JIS B 1192 allows rolled ball screws 210 µm in
300 mm, and 25 K of steel at 11.7 µm/(m·K) are added."""
FASTER_SHARE = 0.2
"""Share by which a speed may exceed the commanded one: more than the overshoot of a tuned velocity loop."""
RATE_OVER_S = 1.0
"""Longest time between two readings that are compared for their rate, s."""
STANDS_MM = 0.01
"""Range of motor positions within which the motor counts as standing, mm: a position loop oscillates by one or two counts, which are
µm."""
APART = 3
"""Consecutive deviating readings at rest that count as a jump. Fewer are outliers, which an average leaves out."""
_KEEP_S = 10.0
"""Time for which motor positions are kept, s."""
_STANDS_SHARE = 0.1
"""Share of the motor's travel below which the instrument is reported as standing still."""


@dataclass(frozen=True)
class _Pair:
    """A reading and the motor positions, mm, between which it was taken."""

    reading_mm: float
    low_mm: float
    high_mm: float

    @property
    def least_mm(self) -> float:
        """The smallest reading - motor."""
        return self.reading_mm - self.high_mm

    @property
    def most_mm(self) -> float:
        """The largest reading - motor."""
        return self.reading_mm - self.low_mm

    @property
    def motor_mm(self) -> float:
        return (self.low_mm + self.high_mm) / 2.0


@dataclass
class _Rest:
    """A reading at rest, and the range of motor positions since, mm."""

    time_ns: int
    reading_mm: float
    motor_mm: float
    low_mm: float
    high_mm: float
    apart: int = 0  # consecutive latest readings at rest that deviate from it


class Agreement:
    """Agreement check of one axis. fastest_mm_s: the axis file's largest velocity."""

    def __init__(self, limits: AgreementLimits, fastest_mm_s: float) -> None:
        self.limits = limits
        self._fastest_mm_s = fastest_mm_s
        self._times_ns: list[int] = []
        self._since_ns: list[int] = []
        self._places_mm: list[float] = []
        self._recent: deque[Reading] = deque()
        self._least: _Pair | None = None  # of the smallest `most_mm`
        self._most: _Pair | None = None  # of the largest `least_mm`
        self._travel_mm = (0.0, 0.0)
        self._rest: _Rest | None = None
        self._followed: tuple[float, float] | None = None  # reading and motor position at `followed_ns`, mm
        self.followed_ns: int | None = None
        """Time of the last reading at rest that was seen to follow the motor; None before the first."""

    def forget(self) -> None:
        """Compare travel from the next reading on: call when either zero changes."""
        self._times_ns.clear()
        self._since_ns.clear()
        self._places_mm.clear()
        self._recent.clear()
        self._least = self._most = self._followed = None
        self.forget_rest()

    def forget_rest(self) -> None:
        """Drop the last rest: call while the axis is without power, when a person may move something in the machine."""
        self._rest = None

    def motor_at(self, time_ns: int, position_mm: float, *, since_ns: int | None = None) -> None:
        """Take a motor position, mm, of a moment from `since_ns` to `time_ns`; None: of `time_ns` exactly.

        One that is not later than the position before it is not used."""
        if self._times_ns and time_ns <= self._times_ns[-1]:
            return
        self._times_ns.append(time_ns)
        self._since_ns.append(time_ns if since_ns is None else since_ns)
        self._places_mm.append(position_mm)
        if time_ns - self._times_ns[0] > 2 * _KEEP_S * NS_PER_S:
            old = bisect_left(self._times_ns, time_ns - round(_KEEP_S * NS_PER_S))
            del self._times_ns[:old], self._since_ns[:old], self._places_mm[:old]

    def rate(self, reading: Reading, speed_mm_s: float) -> str | None:
        """What is wrong with the rate of the readings, None when nothing is. speed_mm_s: commanded, 0.0: not known.

        Raises ValueError for a reading without a position.
        """
        position_mm = _position(reading)
        while self._recent and reading.time_ns - self._recent[0].time_ns > RATE_OVER_S * NS_PER_S:
            self._recent.popleft()
        allowed_mm_s = (speed_mm_s or self._fastest_mm_s) * (1.0 + FASTER_SHARE)
        wrong = None
        for before in (self._recent[0], self._recent[-1]) if self._recent else ():
            change_mm = position_mm - _position(before)
            seconds = (reading.time_ns - before.earliest_ns) / NS_PER_S + DATED_WITHIN_S
            if abs(change_mm) > allowed_mm_s * seconds + self.limits.slack_mm:
                wrong = (
                    f"its reading changed by {change_mm:.3f} mm within {seconds:.2f} s, the axis moves at"
                    f" {allowed_mm_s:g} mm/s at most: a jump, or the load moves faster than commanded"
                )
        self._recent.append(reading)
        return wrong

    def compare(self, reading: Reading, speed_mm_s: float) -> str | None:
        """What is wrong between this reading and the motor; None when nothing is, or the motor's position at its time is not known.

        speed_mm_s: commanded at present, 0.0 at rest. Raises ValueError for a reading without a position.
        """
        span = self._motor_between(reading, speed_mm_s)
        if span is None:
            return None
        (low_mm, high_mm), position_mm = span, _position(reading)
        self._follow(reading, low_mm, high_mm)
        wrong = self._at_rest(reading, low_mm, high_mm)
        if wrong is not None:
            return wrong
        now = _Pair(position_mm, low_mm, high_mm)
        if self._least is None or self._most is None:
            self._least = self._most = now
            self._travel_mm = span
            return None
        self._travel_mm = min(self._travel_mm[0], low_mm), max(self._travel_mm[1], high_mm)
        if now.most_mm < self._least.most_mm:
            self._least = now
        if now.least_mm > self._most.least_mm:
            self._most = now
        allowed_mm = self.limits.slack_mm + SHARE_OF_TRAVEL * (self._travel_mm[1] - self._travel_mm[0])
        if self._most.least_mm - self._least.most_mm <= allowed_mm:
            return None
        extreme = self._least if self._most is now else self._most
        return self._told(reading, extreme.reading_mm, now.motor_mm - extreme.motor_mm, allowed_mm)

    def _follow(self, reading: Reading, low_mm: float, high_mm: float) -> None:
        """Note the time of a reading at rest that moved as the motor did since the one before: by half to twice of it, as the load may
        wait within a reversal. A frozen reading moves by nothing."""
        if high_mm - low_mm > STANDS_MM:
            return
        position_mm, motor_mm = _position(reading), (low_mm + high_mm) / 2.0
        if self._followed is not None:
            seen_mm, moved_mm = position_mm - self._followed[0], motor_mm - self._followed[1]
            if abs(moved_mm) < STANDS_MM or not 0.5 <= seen_mm / moved_mm <= 2.0:
                return
        self._followed, self.followed_ns = (position_mm, motor_mm), reading.time_ns

    def _at_rest(self, reading: Reading, low_mm: float, high_mm: float) -> str | None:
        """What is wrong between readings at rest, where the motor's position does not depend on the time of the sample.

        From one rest to the next the load may lose up to a reversal, and the share of the travel.
        """
        rest, position_mm = self._rest, _position(reading)
        if rest is not None:
            rest.low_mm, rest.high_mm = min(rest.low_mm, low_mm), max(rest.high_mm, high_mm)
        if high_mm - low_mm > STANDS_MM:
            return None
        now = _Rest(reading.time_ns, position_mm, (low_mm + high_mm) / 2.0, low_mm, high_mm)
        if rest is None:
            self._rest = now
            return None
        travel_mm = rest.high_mm - rest.low_mm
        allowed_mm = self.limits.steady_mm + SHARE_OF_TRAVEL * travel_mm
        if travel_mm > STANDS_MM:
            allowed_mm += min(travel_mm, self.limits.largest_reversal_um / 1000.0)
        step_mm = position_mm - rest.reading_mm - (now.motor_mm - rest.motor_mm)
        if abs(step_mm) > allowed_mm:
            rest.apart += 1
            if rest.apart < APART:
                return None
            return (
                f"jumped by {step_mm:.3f} mm against a motor that {'travelled' if travel_mm > STANDS_MM else 'stands'}: it saw"
                f" {position_mm - rest.reading_mm:.3f} mm while the motor travelled {now.motor_mm - rest.motor_mm:.3f} mm from rest to"
                f" rest, allowed is a difference of {allowed_mm:.3f} mm"
                " ([instrument] instrument_agrees_within_um, [axis] largest_reversal_um)"
            )
        rest.apart = 0
        if travel_mm > STANDS_MM or reading.time_ns - rest.time_ns > RATE_OVER_S * NS_PER_S:
            self._rest = now
        return None

    def _motor_between(self, reading: Reading, speed_mm_s: float) -> tuple[float, float] | None:
        """The smallest and largest position of the motor while the sample may have been taken."""
        least_s, most_s = self.limits.lags_s
        from_ns = reading.earliest_ns - round(most_s * NS_PER_S)
        to_ns = reading.time_ns - round(least_s * NS_PER_S)
        times = self._times_ns
        if not times or from_ns < times[0]:
            return None
        places = self._places_mm[bisect_right(times, from_ns) - 1 : bisect_left(self._since_ns, to_ns) + 1]
        beyond_mm = max(0, to_ns - self._since_ns[-1]) / NS_PER_S * speed_mm_s * (1.0 + FASTER_SHARE)
        return min(places) - beyond_mm, max(places) + beyond_mm

    def _told(self, reading: Reading, before_mm: float, motor_mm: float, allowed_mm: float) -> str:
        """The deviation as a sentence, by the latest reading of the last second that shows it; else by an earlier one, before_mm, and
        the motor's travel since, motor_mm."""
        seen_mm, position_mm, motor_now_mm, step = (
            _position(reading) - before_mm,
            _position(reading),
            self._motor_mm(reading),
            False,
        )
        for before in reversed(self._recent):
            since_mm, motor_since_mm = position_mm - _position(before), motor_now_mm - self._motor_mm(before)
            if abs(since_mm - motor_since_mm) > allowed_mm:
                seen_mm, motor_mm, step = since_mm, motor_since_mm, before is self._recent[-2]
                break
        figures = (
            f"it saw {seen_mm:.3f} mm while the motor travelled about {motor_mm:.3f} mm,"
            f" allowed is a difference of {allowed_mm:.3f} mm"
        )
        if step and abs(motor_mm) < abs(seen_mm) / 2.0:
            return f"jumped by {seen_mm - motor_mm:.3f} mm: {figures}"
        if abs(seen_mm) < _STANDS_SHARE * abs(motor_mm):
            return f"stands still, whatever its status says: {figures}"
        if seen_mm * motor_mm < 0.0:
            return f"runs against the motor ([instrument] direction, or [scaling] direction): {figures}"
        return f"does not follow the motor: {figures} ([instrument] instrument_agrees_within_um, [axis] largest_reversal_um)"

    def _motor_mm(self, reading: Reading) -> float:
        """The motor's approximate position when a reading was taken, mm."""
        middle_ns = (reading.earliest_ns + reading.time_ns - round(sum(self.limits.lags_s) * NS_PER_S)) // 2
        at = bisect_right(self._times_ns, middle_ns)
        if at in (0, len(self._times_ns)):
            return self._places_mm[max(0, at - 1)]
        (from_ns, to_ns), (from_mm, to_mm) = self._times_ns[at - 1 : at + 1], self._places_mm[at - 1 : at + 1]
        return from_mm + (to_mm - from_mm) * (middle_ns - from_ns) / (to_ns - from_ns)


def _position(reading: Reading) -> float:
    if reading.position_mm is None:
        raise ValueError("a reading without a position cannot be compared")
    return reading.position_mm
