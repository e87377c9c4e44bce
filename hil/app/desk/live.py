"""What is shown of an axis: one frozen picture of it, and the last minute of its signals in memory of fixed size.

One thread publishes, any thread reads; readers get values that nobody changes any more.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample, DriveState
from drivers.instrument import Environment, Reading, ReadingStatus
from hil.records.rows import UM_PER_MM

TRACE_S = 60.0
RATE_HZ = 20.0
_KEPT = round(TRACE_S * RATE_HZ)


@dataclass(frozen=True)
class Live:
    """The axis at one moment, in its clock's time. What is not known is None.

    position_load_mm: by the motor's encoder; remaining_mm: to where the motion under way leads; instrument_mm: in the load's frame
    where the instrument has a datum (`on_datum`), else in its own; correction_um: what the last command had on it; in_force: what
    corrects, "" for nothing; trouble: why there is no axis, "" while there is
    """

    connected: bool = False
    trouble: str = ""
    time_s: float = 0.0
    state: DriveState = DriveState.UNKNOWN
    fault_code: int | None = None
    homed: bool | None = None
    moving: bool = False
    position_load_mm: float | None = None
    following_error_um: float | None = None
    velocity_mm_s: float | None = None
    torque_percent: float | None = None
    remaining_mm: float | None = None
    instrument: str = ""
    instrument_status: ReadingStatus | None = None
    instrument_mm: float | None = None
    instrument_age_s: float | None = None
    on_datum: bool = False
    correction_um: float | None = None
    in_force: str = ""
    environment: Environment | None = None


@dataclass(frozen=True)
class TracePoint:
    """One point of the live plots. number: counts up without a gap, so that a reader can ask for what is new; instrument_load_mm: None
    while the instrument has no datum, for one curve is in one frame"""

    number: int
    time_s: float
    position_load_mm: float | None
    following_error_um: float | None
    velocity_mm_s: float | None
    torque_percent: float | None
    instrument_load_mm: float | None


def of_sample(before: Live, sample: DriveSample, destination_load_mm: float | None) -> Live:
    """The picture after a look at the drive."""
    error_mm = sample.following_error_mm
    moving = sample.state is DriveState.ENABLED and not sample.target_reached
    left_mm = None
    if moving and destination_load_mm is not None:
        left_mm = destination_load_mm - sample.position_load_mm
    return replace(
        before,
        connected=True,
        trouble="",
        time_s=sample.time_ns / NS_PER_S,
        state=sample.state,
        fault_code=sample.fault_code,
        homed=sample.homed,
        moving=moving,
        position_load_mm=sample.position_load_mm,
        following_error_um=None if error_mm is None else error_mm * UM_PER_MM,
        velocity_mm_s=sample.velocity_mm_s,
        torque_percent=sample.torque_percent,
        remaining_mm=left_mm,
    )


@dataclass
class Board:
    """Where the axis's thread puts what it sees, and everybody reads it."""

    monotonic_s: Callable[[], float] = time.monotonic
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _live: Live = field(default_factory=Live)
    _trace: deque[TracePoint] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _number: int = 0
    _due_s: float = 0.0  # when the next point of the plots is due
    _reading: Reading | None = None

    # -- for the axis's thread -----------------------------------------------------------------------------------------
    def publish(self, live: Live) -> None:
        """The picture from now on; a point of the plots RATE_HZ times a second of real time, however uneven the looks come."""
        now_s = self.monotonic_s()
        with self._lock:
            self._live = live
            if live.connected and now_s >= self._due_s:
                self._due_s = max(self._due_s + 1.0 / RATE_HZ, now_s - 1.0 / RATE_HZ)
                self._number += 1
                self._trace.append(_trace_point(self._number, live))

    def forget(self, trouble: str = "") -> None:
        """There is no axis here for now, and what was read of it is not shown as if there were."""
        self._reading = None
        self.publish(Live(trouble=trouble))

    def heard(self, readings: Sequence[Reading], position_of: Callable[[Reading], float | None]) -> None:
        """The instrument has sent something. position_of: a good reading in the load's frame, None without a datum."""
        if not readings:
            return
        last = readings[-1]
        in_load_mm = position_of(last) if last.position_mm is not None else None
        with self._lock:
            self._reading = last
            self._live = replace(
                self._live,
                instrument_status=last.status,
                instrument_mm=last.position_mm if in_load_mm is None else in_load_mm,
                on_datum=self._live.on_datum if last.position_mm is None else in_load_mm is not None,
            )

    def instrument_age_s(self, now_ns: int) -> float | None:
        """How old the last reading is; None before the first."""
        return None if self._reading is None else self._reading.age_ns(now_ns) / NS_PER_S

    # -- for everybody ---------------------------------------------------------------------------------------------------
    @property
    def live(self) -> Live:
        with self._lock:
            return self._live

    def trace(self, since: int = 0) -> tuple[TracePoint, ...]:
        """The points after number `since` that are still kept, oldest first."""
        with self._lock:
            first = self._number - len(self._trace) + 1
            skip = max(0, since + 1 - first)
            return tuple(self._trace[i] for i in range(skip, len(self._trace)))


def _trace_point(number: int, live: Live) -> TracePoint:
    return TracePoint(
        number,
        live.time_s,
        live.position_load_mm,
        live.following_error_um,
        live.velocity_mm_s,
        live.torque_percent,
        live.instrument_mm if live.on_datum else None,
    )
