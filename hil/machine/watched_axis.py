"""WatchedAxis: a drive and, where there is one, the instrument at its load, sampled and checked together.

`look` takes a sample of the drive and the new readings of the instrument. It raises on a fault, a sample or reading that is too old,
a lost signal, a motor that is too fast or outside its allowed positions, and an instrument that does not follow the motor. The
supervisor then stops the axis.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise

from drivers.clock import NS_PER_S
from drivers.drive import FAULTS, DriveSample, DriveState, ServoDrive
from drivers.errors import DriveFaultError, LimitError, LinkLostError, MeasurementLostError, OverspeedError, StateError
from drivers.instrument import DistanceInstrument, Reading, ReadingStatus
from hil.axis.agreement import AgreementLimits
from hil.machine.instrument_check import RATE_OVER_S, Agreement
from hil.machine.motion_checks import OVER_S, Overspeed, PositionCheck
from hil.machine.time_out import Motion

STALE_AFTER_S = 0.5
"""Greatest age of a sample or reading that is used, s, unless the axis file gives another."""
POLLED_S = 0.25
"""Longest time between two polls that counts as silence of the instrument, s: above the interval at rest. Beyond it this process was
delayed, and what was sent meanwhile may come with the next poll."""
STALLED_S = 3.0
"""Time at standstill, s, after which a commanded motion counts as stalled: brakes open and homings reverse in one or two seconds, and
with the 6 s in which a Modbus drive is shut down it is less than the 10 s from a fault to the end."""
STANDS_WITHIN_MM = 0.001
"""Range of positions within which an axis counts as standing, mm: 1 µm in `STALLED_S` is slower than any move of a machine tool."""
TO_AND_FRO = 5.0
"""Ratio of path length to range of positions from which an axis counts as oscillating. A homing reverses twice, at a switch or a
pulse, and reaches three; an axis that hunts, or that another master moves, goes beyond."""


class WatchedAxis:
    """An open drive and an open instrument (None for a drive alone).

    on_stop: called when the axis is stopped, as its rest position is not known then; on_readings: called with new readings
    saw_fault: the drive was in a fault since this was last set to False; motion: the motion under way, None at rest
    kept_for: what the axis is kept enabled for beside others, in words; "" where it may be disabled
    """

    def __init__(
        self,
        drive: ServoDrive,
        instrument: DistanceInstrument | None = None,
        *,
        stale_after_s: float = STALE_AFTER_S,
        agreement: AgreementLimits | None = None,
        on_stop: Callable[[], None] = lambda: None,
    ) -> None:
        self.drive = drive
        self.instrument = instrument
        self.on_stop = on_stop
        self.on_readings: Callable[[Sequence[Reading]], None] | None = None
        self.saw_fault = False
        self.motion: Motion | None = None
        self.kept_for = ""
        self.looked_ns = 0
        self._stale_ns = round(stale_after_s * NS_PER_S)
        self._agreement = Agreement(agreement or AgreementLimits(), drive.limits.max_velocity_mm_s)
        self._compared = True
        self._overspeed = Overspeed()
        self._place = PositionCheck(drive.limits)
        self._stream_mm_s = 0.0  # of set-points, the fastest so far
        self._speeds: deque[tuple[int, float]] = deque()  # of motions that are over, and when they were
        self._lately: deque[tuple[int, float]] = deque()  # of the motor, over `STALLED_S` of a motion
        self._path: deque[tuple[int, float]] = deque()  # of the motor, over the last second of a motion
        self._numbered = 0  # of the instrument's samples, those that were lost too
        self.begin()

    def begin(self) -> None:
        """Drop earlier readings and compare travel from here on."""
        self._start_ns = self.drive.clock.now_ns()
        self._latest: Reading | None = None
        self._polled_ns, self._silent_ns = self._start_ns, 0
        self.motion = None
        self._forget_travel()

    def _forget_travel(self) -> None:
        self._agreement.forget()
        self._overspeed.forget()
        self._place.forget()
        self._path.clear()

    def elapsed_s(self) -> float:
        """Seconds since `begin`, in the clock's time."""
        return (self.drive.clock.now_ns() - self._start_ns) / NS_PER_S

    # -- motions and streams ---------------------------------------------------------------------------------------------
    @contextmanager
    def moving(self, motion: Motion, found: DriveSample | None = None) -> Iterator[None]:
        """Around a motion, from before it is commanded until it is over or was stopped. found: a sample from just before.

        A homing changes the drive's zero, so travel and speed are not compared during it, nor across it.
        """
        homing = motion.target_mm is None
        self._overspeed.forget()
        self._path.clear()
        self._lately.clear()
        if found is not None and found.target_reached and found.state is DriveState.ENABLED:
            self._overspeed.stood(self.drive.clock.now_ns(), found.position_load_mm)
        self.motion = motion
        try:
            yield
        finally:
            self._speeds.append((self.drive.clock.now_ns(), motion.speed_mm_s))
            self.motion = None
            self._overspeed.forget()
            if homing:
                self._forget_travel()

    @contextmanager
    def following(self) -> Iterator[Callable[[int, float, float], None]]:
        """Around a stream. The function that it gives takes, each cycle, the motor's sample time (ns) and position (mm) and the
        speed of the set-points (mm/s)."""

        def found(time_ns: int, position_mm: float, speed_mm_s: float) -> None:
            self._stream_mm_s = max(self._stream_mm_s, abs(speed_mm_s))
            self._agreement.motor_at(time_ns, position_mm)

        try:
            yield found
        finally:
            self._speeds.append((self.drive.clock.now_ns(), self._stream_mm_s))
            self._stream_mm_s = 0.0
            self._place.forget()  # a stream checks no position; the axis may rest where the stream ends

    @contextmanager
    def travel_unproven(self) -> Iterator[None]:
        """Do not compare instrument and motor inside the block: for procedures that find out whether the units are right."""
        self._compared = False
        try:
            yield
        finally:
            self._compared = True
            self._forget_travel()

    def acknowledge_loss(self) -> bool:
        """Use the instrument again after a lost signal, from another zero; whether one was lost."""
        self._forget_travel()
        if self.instrument is None:
            return False
        with suppress(MeasurementLostError):  # a port that is gone is told by the next look
            self._poll()  # what has arrived may be of the loss
        return self.instrument.acknowledge_loss()

    @property
    def instrument_name(self) -> str:
        """The instrument's name for messages, "" without an instrument."""
        return "" if self.instrument is None else self.instrument.name

    @property
    def steady_mm(self) -> float:
        """Allowed change of the readings while the axis stands, mm."""
        return self._agreement.limits.steady_mm

    @property
    def _speed_mm_s(self) -> float:
        return self._stream_mm_s if self.motion is None else self.motion.speed_mm_s

    def _readings_mm_s(self) -> float:
        """Greatest speed, mm/s, of the motions that readings of the last second may belong to, latency included; 0.0: not known."""
        over_ns = self.drive.clock.now_ns() - 2 * round(RATE_OVER_S * NS_PER_S)
        while self._speeds and self._speeds[0][0] < over_ns:
            self._speeds.popleft()
        speeds_mm_s = [speed for _, speed in self._speeds]
        if self.motion is not None or self._stream_mm_s:
            speeds_mm_s.append(self._speed_mm_s)
        return 0.0 if 0.0 in speeds_mm_s else max(speeds_mm_s, default=0.0)

    @property
    def seen_mm_s(self) -> float:
        """Mean speed of the motor over the last second of the motion under way, mm/s, signed; 0.0 before two samples."""
        if len(self._path) < 2 or self._path[-1][0] == self._path[0][0]:
            return 0.0
        (from_ns, from_mm), (to_ns, to_mm) = self._path[0], self._path[-1]
        return (to_mm - from_mm) * NS_PER_S / (to_ns - from_ns)

    @property
    def stalled(self) -> str:
        """How the motion under way is stalled for `STALLED_S`, as a phrase; "" when it is not, and at rest."""
        lately = self._lately
        if self.motion is None or not lately or self.drive.clock.now_ns() - lately[0][0] < STALLED_S * NS_PER_S:
            return ""
        places_mm = [place_mm for _, place_mm in lately]
        range_mm = max(places_mm) - min(places_mm)
        if range_mm <= STANDS_WITHIN_MM:
            return "has stood"
        way_mm = sum(abs(to_mm - from_mm) for from_mm, to_mm in pairwise(places_mm))
        return "has gone to and fro" if way_mm >= TO_AND_FRO * range_mm else ""

    # -- looking -----------------------------------------------------------------------------------------------------
    def look(self) -> tuple[DriveSample, Sequence[Reading]]:
        """Sample the drive and poll the instrument; returns the sample and the new readings.

        Raises DriveFaultError for a fault, OverspeedError, LimitError for a position that is not allowed, LinkLostError for an old
        sample, and MeasurementLostError for a lost signal, an old reading or one that does not agree with the motor.
        """
        asked_ns = self.drive.clock.now_ns()
        sample = self.drive.sample()
        self.looked_ns = self.drive.clock.now_ns()
        self.drive.looked_at(sample)
        readings = self._poll()
        if sample.state in FAULTS:
            self.saw_fault = True
            code = "" if sample.fault_code is None else f": {self.drive.fault_text(sample.fault_code)}"
            during = "" if self.motion is None else f" during {self.motion.what}"
            raise DriveFaultError(
                f"drive {self.drive.name} went into {sample.state.value}{during}{code}", sample.fault_code
            )
        if self.motion is not None:
            self._judge_speed(sample)
        self._judge_place(sample)
        self._agreement.motor_at(sample.time_ns, sample.position_load_mm, since_ns=sample.since_ns)
        self._take(readings, compared=sample.state is DriveState.ENABLED)
        if (
            sample.age_ns(asked_ns) > self._stale_ns
        ):  # not by now: what this process does with it is no delay of the drive
            raise LinkLostError(f"drive {self.drive.name}: no sample for {sample.age_ns(asked_ns) / NS_PER_S:.2f} s")
        self._check_instrument_fresh()
        return sample, readings

    def look_enabled(self, what: str) -> DriveSample:
        """As `look`, for an axis that must be enabled; returns the sample. Raises as `look`, and StateError when it is not enabled."""
        sample, _ = self.look()
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {self.drive.name}: {what} ended by itself, it is {sample.state.value}")
        return sample

    def readings(self) -> list[tuple[int, Reading]]:
        """New readings, each with its number, while a stream samples the drive. Raises MeasurementLostError for a bad or old one."""
        number, numbered = self._numbered, []
        readings = self._poll()
        self._take(readings, compared=True)
        self._check_instrument_fresh()
        for reading in readings:
            number += 1 + reading.lost_before
            numbered.append((number, reading))
        return numbered

    def latest_status(self) -> ReadingStatus | None:
        """Status of the latest reading that has arrived, None for none. The drive is not sampled. Raises MeasurementLostError for an
        instrument whose port is gone."""
        readings = self._poll()
        if not readings:
            return None
        if readings[-1].status is ReadingStatus.GOOD:
            self._take(readings[-1:], compared=False)
        return readings[-1].status

    def _poll(self) -> Sequence[Reading]:
        """New readings. Raises MeasurementLostError, not LinkLostError, when the instrument's port disappears."""
        if self.instrument is None:
            return ()
        now_ns = self.drive.clock.now_ns()
        self._silent_ns += min(now_ns - self._polled_ns, round(POLLED_S * NS_PER_S))
        self._polled_ns = now_ns
        try:
            readings = self.instrument.poll()
        except LinkLostError as error:
            raise self._lost(str(error)) from error
        if self.on_readings is not None and readings:
            self.on_readings(readings)
        return readings

    def _take(self, readings: Sequence[Reading], *, compared: bool) -> None:
        homing = self.motion is not None and self.motion.target_mm is None
        fastest_mm_s = self._readings_mm_s() if readings else 0.0
        if not compared:
            self._agreement.forget_rest()
        for reading in readings:
            if reading.status is not ReadingStatus.GOOD:
                raise self._lost(reading.status.value)
            self._numbered += 1 + reading.lost_before
            if not self._compared:
                continue
            wrong = self._agreement.rate(reading, fastest_mm_s)
            if wrong is None and compared and not homing:
                wrong = self._agreement.compare(reading, self._speed_mm_s)
            if wrong is not None:
                raise self._lost(wrong, followed_ns=self._agreement.followed_ns)
        if readings:
            self._latest = readings[-1]
            self._silent_ns = max(0, self._polled_ns - self._latest.time_ns)

    def _judge_speed(self, sample: DriveSample) -> None:
        """Check the motor's speed in a motion. Raises OverspeedError."""
        motion = self.motion
        self._lately.append((sample.time_ns, sample.position_load_mm))
        while len(self._lately) > 1 and sample.time_ns - self._lately[1][0] >= STALLED_S * NS_PER_S:
            self._lately.popleft()
        while self._path and sample.time_ns - self._path[0][0] > OVER_S * NS_PER_S:
            self._path.popleft()
        self._path.append((sample.time_ns, sample.position_load_mm))
        if motion is None or motion.target_mm is None or sample.state is not DriveState.ENABLED:
            return
        wrong = self._overspeed.look(sample.time_ns, sample.position_load_mm, motion.speed_mm_s, now_ns=self.looked_ns)
        if wrong is not None:
            raise OverspeedError(f"drive {self.drive.name} {wrong}")

    def _judge_place(self, sample: DriveSample) -> None:
        """Check the position of an enabled axis, except in a homing. Raises LimitError."""
        homing = self.motion is not None and self.motion.target_mm is None
        if homing or sample.state is not DriveState.ENABLED:
            self._place.forget()
            return
        moving = self.motion is not None or self._stream_mm_s > 0.0
        wrong = self._place.look(sample.position_load_mm, moving=moving)
        if wrong is not None:
            raise LimitError(f"drive {self.drive.name} {wrong}")

    def _check_instrument_fresh(self) -> None:
        if self.instrument is not None and self._silent_ns > self._stale_ns:
            raise self._lost(f"no reading for {self._silent_ns / NS_PER_S:.2f} s")

    def _lost(self, what: str, *, followed_ns: int | None = None) -> MeasurementLostError:
        return MeasurementLostError(f"instrument {self.instrument_name}: {what}", followed_ns=followed_ns)
