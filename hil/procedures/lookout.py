"""Drive and instrument of an axis, looked at together without a gap: what is wrong with either stops the axis before anyone hears.

Every wait of every procedure passes through `Lookout.watch` or `watch_until`, which look every `REST_SLICE_S` or closer. A fault, a
lost beam, a stale reading or a lost link stops the axis (quick stop), and those beside it, before the error reaches the procedure.
What is commanded is the business of others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample, DriveState, ServoDrive
from drivers.errors import (
    DriveFaultError,
    LinkLostError,
    MeasurementLostError,
    MotionTimeoutError,
    StateError,
)
from drivers.instrument import DistanceInstrument, Reading, ReadingStatus
from hil.procedures.way_out import completed

SLICE_S = 0.05
"""How often drive and instrument are looked at while the axis moves."""
REST_SLICE_S = 0.2
"""The same while it stands still: soon enough to say what broke, within what instruments keep for a reader."""
FIRST_READING_S = 2.0
"""How long an instrument may need from its opening to its first reading, as when its air sensors report in turn."""

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)


class Lookout:
    """Of an open drive and an open instrument.

    stale_after_s: oldest sample or reading that is still believed; on_stop: called when this axis is stopped, for where it comes to
    rest nobody knows; beside: of the machine's other axes, looked at and stopped with this one; on_readings: hears what the instrument
    sent; saw_fault: the drive was in a fault since this was last made False.
    """

    def __init__(
        self,
        drive: ServoDrive,
        instrument: DistanceInstrument,
        *,
        stale_after_s: float,
        on_stop: Callable[[], None],
    ) -> None:
        self.drive = drive
        self.instrument = instrument
        self.clock = drive.clock
        self.beside: tuple[Lookout, ...] = ()
        self.on_readings: Callable[[Sequence[Reading]], None] | None = None
        self.saw_fault = False
        self._on_stop = on_stop
        self._stale_ns = round(stale_after_s * NS_PER_S)
        self._start_ns = self.clock.now_ns()
        self._latest: Reading | None = None
        self._samples = 0  # of the instrument, those that were lost too
        self._stopped_for: BaseException | None = None

    def begin(self) -> None:
        """From now on: what was read before is of no use."""
        self._start_ns = self.clock.now_ns()
        self._latest = self._stopped_for = None

    def end(self) -> None:
        """The error that stopped the axis is not kept."""
        self._stopped_for = None

    def elapsed_s(self) -> float:
        """Seconds since `begin`, in the clock's time."""
        return (self.clock.now_ns() - self._start_ns) / NS_PER_S

    # -- stopping ----------------------------------------------------------------------------------------------------
    @contextmanager
    def stopping_on_error(self) -> Iterator[None]:
        """Whatever goes wrong inside, an interrupt from the keyboard too, stops the axis, and those beside it, at once."""
        try:
            yield
        except BaseException as error:
            self.stop_for(error)
            raise

    def stop_for(self, error: BaseException) -> None:
        """Once for each error, however many hands it passes through on its way up."""
        if error is not self._stopped_for:
            self._stopped_for = error
            self.stop()

    def stop(self) -> None:
        """Quick stop of this axis and those beside it; the error under way matters more than one of stopping, which is not raised."""
        with ExitStack() as stack:  # each of them whatever becomes of the others
            for axis in (*self.beside, self):
                axis._on_stop()
                stack.callback(completed, axis.drive.quick_stop)

    # -- looking -----------------------------------------------------------------------------------------------------
    def look(self) -> tuple[DriveSample, Sequence[Reading]]:
        """One look at drive and instrument; stops the axis and raises on whatever makes motion unsafe or readings worthless."""
        with self.stopping_on_error():
            for other in self.beside:
                other._look_alone()
            return self._look_alone()

    def _look_alone(self) -> tuple[DriveSample, Sequence[Reading]]:
        sample = self.drive.sample()
        self.drive.looked_at(sample)
        readings = self._poll()
        if sample.state in _FAULTS:
            self.saw_fault = True
            code = "" if sample.fault_code is None else f" (error code {sample.fault_code:04X}h)"
            raise DriveFaultError(f"drive {self.drive.name} went into {sample.state.value}{code}", sample.fault_code)
        self._take(readings)
        self._check_fresh(sample)
        return sample, readings

    def _poll(self) -> Sequence[Reading]:
        """A port of the instrument's that went away is a lost measurement, not a lost drive."""
        try:
            readings = self.instrument.poll()
        except LinkLostError as error:
            raise MeasurementLostError(f"instrument {self.instrument.name}: {error}") from error
        if self.on_readings is not None and readings:
            self.on_readings(readings)
        return readings

    def _take(self, readings: Sequence[Reading]) -> None:
        for reading in readings:
            if reading.status is not ReadingStatus.GOOD:
                raise MeasurementLostError(f"instrument {self.instrument.name}: {reading.status.value}")
            self._samples += 1 + reading.lost_before
        if readings:
            self._latest = readings[-1]

    def readings(self) -> list[tuple[int, Reading]]:
        """What the instrument has sent, each with its number, for while a stream looks after the drive.

        The axis stops on a bad or an old reading.
        """
        with self.stopping_on_error():
            number, numbered = self._samples, []
            readings = self._poll()
            self._take(readings)
            self._check_instrument_fresh()
            for reading in readings:
                number += 1 + reading.lost_before
                numbered.append((number, reading))
            return numbered

    def _check_fresh(self, sample: DriveSample) -> None:
        now_ns = self.clock.now_ns()
        if sample.age_ns(now_ns) > self._stale_ns:
            raise LinkLostError(f"drive {self.drive.name}: no sample for {sample.age_ns(now_ns) / NS_PER_S:.2f} s")
        self._check_instrument_fresh()

    def _check_instrument_fresh(self) -> None:
        now_ns = self.clock.now_ns()
        newest_ns = self._start_ns if self._latest is None else max(self._latest.time_ns, self._start_ns)
        if now_ns - newest_ns > self._stale_ns:
            raise MeasurementLostError(
                f"instrument {self.instrument.name}: no reading for {(now_ns - newest_ns) / NS_PER_S:.2f} s"
            )

    # -- waiting -----------------------------------------------------------------------------------------------------
    def await_instrument(self) -> None:
        """Before anything moves: wait for the instrument's first reading, which may take longer than those after it."""
        deadline = self.clock.deadline(FIRST_READING_S)
        with self.stopping_on_error():
            while self._latest is None:
                self._take(self._poll())
                if self._latest is None and deadline.expired:
                    raise MeasurementLostError(
                        f"instrument {self.instrument.name}: no reading within {FIRST_READING_S:g} s; nothing was enabled"
                    )
                self.clock.sleep_s(SLICE_S)

    def watch(self, duration_s: float) -> list[Reading]:
        """Let time pass with the axis at rest, watched; returns the readings that arrived meanwhile."""
        deadline = self.clock.deadline(duration_s)
        slice_s = SLICE_S if self.instrument.answers_when_asked else REST_SLICE_S
        arrived: list[Reading] = []
        with self.stopping_on_error():
            while not deadline.expired:
                slice_end_ns = self.clock.now_ns() + round(slice_s * NS_PER_S)
                self.clock.sleep_until_ns(min(slice_end_ns, deadline.end_ns))
                arrived.extend(self.look()[1])
        return arrived

    def watch_until(self, condition: Callable[[DriveSample], bool], timeout_s: float, what: str) -> DriveSample:
        """Watch until the drive's sample fulfils the condition; quick stop and MotionTimeoutError when it does not in time.

        A drive that is no longer enabled fulfils nothing: standing still is not having arrived.
        """
        deadline = self.clock.deadline(timeout_s)
        with self.stopping_on_error():
            while True:
                sample, _ = self.look()
                if sample.state is not DriveState.ENABLED:
                    raise StateError(f"drive {self.drive.name}: {what} ended by itself, it is {sample.state.value}")
                if condition(sample):
                    return sample
                if deadline.expired:
                    raise MotionTimeoutError(f"drive {self.drive.name}: {what} not over within {timeout_s:.1f} s")
                self.clock.sleep_s(SLICE_S)
