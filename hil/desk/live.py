"""The state of an axis as the screen shows it: the latest state, and its signals of the last minute in memory of fixed size.

One thread publishes, any thread reads. Published values are immutable.
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
"""Length of the kept signals, s."""
RATE_HZ = 20.0
"""Points of the signals per second."""
_KEPT = round(TRACE_S * RATE_HZ)


@dataclass(frozen=True)
class SignalLimits:
    """What the drive allows, by its own parameters; None where it does not tell. torque_percent: of the rated torque;
    following_error_um: at which it raises a fault."""

    torque_percent: float | None = None
    following_error_um: float | None = None


@dataclass(frozen=True)
class Live:
    """The axis at one moment, in its clock's time. Unknown values are None.

    position_load_mm: by the motor's encoder; remaining_mm: distance to the target of the present motion
    instrument_mm: load position where the instrument has a datum (`on_datum`), else in its own frame
    correction_um: correction in the last command; in_force: digest of the tables in force, "" for none
    limits: what the drive allows, as read when it was connected
    trouble: why the axis is not connected, "" while it is
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
    limits: SignalLimits = SignalLimits()


@dataclass(frozen=True)
class TracePoint:
    """One point of the live plots. number: consecutive, so that a reader can request new points; instrument_load_mm: None while the
    instrument has no datum, as a curve is in one frame; mark: "target", "stop" or "fault" since the point before, "" for none."""

    number: int
    time_s: float
    position_load_mm: float | None
    following_error_um: float | None
    velocity_mm_s: float | None
    torque_percent: float | None
    instrument_load_mm: float | None
    mark: str = ""


def of_sample(before: Live, sample: DriveSample, destination_load_mm: float | None) -> Live:
    """The state after a sample of the drive. destination_load_mm: target of the present motion, mm, None where unknown."""
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


@dataclass(frozen=True)
class Silence:
    """Real time since each source was last heard, s; None for a source that is not connected or has not answered yet.

    has_instrument: whether the connected axis has an instrument; good: whether its last reading has a usable signal
    drive_lost_s, instrument_lost_s: real time since each had live data last, s; since the begin where it never had
    """

    drive_s: float | None
    instrument_s: float | None
    has_instrument: bool
    good: bool
    drive_lost_s: float
    instrument_lost_s: float


@dataclass
class Board:
    """The published state of an axis: written by its thread, read by any."""

    monotonic_s: Callable[[], float] = time.monotonic
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _live: Live = field(default_factory=Live)
    _trace: deque[TracePoint] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _number: int = 0
    _due_s: float = 0.0  # when the next point of the plots is due
    _mark: str = ""  # since the last point
    _reading: Reading | None = None
    _drive_at_s: float | None = None  # real time of the last sample and of the last reading
    _instrument_at_s: float | None = None

    def __post_init__(self) -> None:
        self._drive_live_s = self._instrument_live_s = self.monotonic_s()

    # -- for the axis's thread -----------------------------------------------------------------------------------------
    def publish(self, live: Live) -> None:
        """Publish a state. A point of the plots is added `RATE_HZ` times per second of real time, also at an uneven rate of
        samples."""
        now_s = self.monotonic_s()
        with self._lock:
            self._mark = _mark(self._live, live) or self._mark
            self._live = live
            self._drive_at_s = now_s if live.connected else None
            if live.connected:
                self._drive_live_s = now_s
            if live.connected and now_s >= self._due_s:
                self._due_s = max(self._due_s + 1.0 / RATE_HZ, now_s - 1.0 / RATE_HZ)
                self._number += 1
                self._trace.append(_trace_point(self._number, live, self._mark))
                self._mark = ""

    def forget(self, trouble: str = "") -> None:
        """Publish that the axis is not connected, without its old values. trouble: the reason."""
        self._reading = self._instrument_at_s = None
        self.publish(Live(trouble=trouble))

    def heard(self, readings: Sequence[Reading], position_of: Callable[[Reading], float | None]) -> None:
        """Take new readings. position_of: load position of a good reading, mm, None without a datum."""
        if not readings:
            return
        last = readings[-1]
        in_load_mm = position_of(last) if last.position_mm is not None else None
        with self._lock:
            self._reading, self._instrument_at_s = last, self.monotonic_s()
            if last.position_mm is not None:
                self._instrument_live_s = self._instrument_at_s
            self._live = replace(
                self._live,
                instrument_status=last.status,
                instrument_mm=last.position_mm if in_load_mm is None else in_load_mm,
                on_datum=self._live.on_datum if last.position_mm is None else in_load_mm is not None,
            )

    def instrument_age_s(self, now_ns: int) -> float | None:
        """Age of the last reading, s; None before the first."""
        return None if self._reading is None else self._reading.age_ns(now_ns) / NS_PER_S

    # -- for everybody ---------------------------------------------------------------------------------------------------
    @property
    def live(self) -> Live:
        with self._lock:
            return self._live

    def silence(self) -> Silence:
        """How long ago drive and instrument were last heard, by the real clock: also where the thread that publishes is held up."""
        with self._lock:
            now_s, live = self.monotonic_s(), self._live
            drive_s, instrument_s = (
                None if at_s is None else now_s - at_s for at_s in (self._drive_at_s, self._instrument_at_s)
            )
            lost_s = now_s - self._drive_live_s, now_s - self._instrument_live_s
        return Silence(
            drive_s, instrument_s, bool(live.instrument), live.instrument_status is ReadingStatus.GOOD, *lost_s
        )

    def trace(self, since: int = 0) -> tuple[TracePoint, ...]:
        """The kept points after number `since`, oldest first."""
        with self._lock:
            first = self._number - len(self._trace) + 1
            skip = max(0, since + 1 - first)
            return tuple(self._trace[i] for i in range(skip, len(self._trace)))


def _mark(before: Live, now: Live) -> str:
    """What the axis came to between two states."""
    if now.state is before.state:
        return "target" if before.moving and not now.moving and now.state is DriveState.ENABLED else ""
    if now.state in (DriveState.FAULT, DriveState.FAULT_REACTION):
        return "" if before.state is DriveState.FAULT_REACTION else "fault"
    return "stop" if now.state is DriveState.QUICK_STOP else ""


def _trace_point(number: int, live: Live, mark: str) -> TracePoint:
    return TracePoint(
        number,
        live.time_s,
        live.position_load_mm,
        live.following_error_um,
        live.velocity_mm_s,
        live.torque_percent,
        live.instrument_mm if live.on_datum else None,
        mark,
    )
