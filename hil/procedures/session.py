"""An axis under measurement: drive, instrument and compensation together, watched without a gap.

Every wait of every procedure passes through `AxisSession.watch`, which looks at drive and instrument every `SLICE_S` at least: a
fault, a lost beam, a stale reading or a lost link stops the axis (quick stop) before the error reaches the procedure. On leaving,
the axis is put back as it was found: disabled unless it was enabled before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from drivers.clock import NS_PER_S
from drivers.drive import Capability, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    BridgeError,
    DriveFaultError,
    FollowingErrorError,
    LimitError,
    LinkLostError,
    LocalError,
    MeasurementLostError,
    MotionTimeoutError,
    StateError,
)
from drivers.instrument import DistanceInstrument, Reading, ReadingStatus
from drivers.set_points import SetPointSettings, SetPointStream
from hil.axis import MeasurementConfig
from hil.compensation import Command, Compensation, MotionHistory
from hil.material import Material
from hil.procedures.at_rest import average_at_rest
from hil.procedures.conditions import Conditions, NoConditions
from hil.procedures.one_correction import refuse_while_drive_corrects

SLICE_S = 0.05
"""How often drive and instrument are looked at while the axis moves."""
REST_SLICE_S = 0.2
"""The same while it stands still: soon enough to say what broke, within what instruments keep for a reader."""
FIRST_READING_S = 2.0
"""How long an instrument may need from its opening to its first reading, as when its air sensors report in turn."""
ARRIVED_WITHIN_MM = 0.1
"""Motor encoder against command at the end of a motion: above any position window, below any distance worth measuring over."""

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)


@dataclass(frozen=True)
class PositionReading:
    """The load's position at rest, averaged over a window by the rules of `hil.reading`.

    std_um: of one reading; mean_std_um: of the mean; count: readings used; left_out: as outliers
    """

    position_load_mm: float
    std_um: float
    count: int
    sample: DriveSample
    mean_std_um: float = math.nan
    left_out: int = 0


class AxisSession:
    """Use as a context manager: entering connects and enables nothing; leaving stops, restores and disconnects.

    how: velocities, dwell and reading times; stale_after_s: oldest reading that is still believed.
    """

    def __init__(
        self,
        drive: ServoDrive,
        instrument: DistanceInstrument,
        how: MeasurementConfig,
        *,
        stale_after_s: float = 0.5,
        conditions: Conditions | None = None,
    ) -> None:
        self.drive = drive
        self.instrument = instrument
        self.clock = drive.clock
        self.how = how
        self.conditions: Conditions = NoConditions() if conditions is None else conditions
        self._compensation: Compensation | None = None
        self.history: MotionHistory | None = None
        self.beside: tuple[AxisSession, ...] = ()  # other axes of the machine, looked at and stopped with this one
        self.material: Material | None = None  # what lengths are brought to 20 °C by
        self.resume_within_s: float | None = None  # for a lost signal, before the axis moves again by itself
        self.time_offset_s = 0.0  # of `time_s` in rows: a resumed campaign goes on where it was left
        self._stale_ns = round(stale_after_s * NS_PER_S)
        self._start_ns = self.clock.now_ns()
        self.on_readings: Callable[[Sequence[Reading]], None] | None = None  # hears what the instrument sent
        self._datum_mm: float | None = None
        self._commanded_mm = math.nan  # the last command, known whenever the history is
        self._latest: Reading | None = None
        self._samples = 0  # of the instrument, those that were lost too
        self._was_enabled = False
        self._entered = False
        self._stopped_for: BaseException | None = None
        self._has_home = self._keeps_home = False  # homed in here, no fault since; and so for the job that runs

    # -- coming and going --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self.drive.open()
        try:
            self.instrument.open()
            self._was_enabled = self.drive.sample().state is DriveState.ENABLED
        except BaseException:
            self.instrument.close()
            self.drive.close()
            raise
        self._entered = True
        self._has_home = self._keeps_home = False
        self.drive.corrected_outside = self._compensation is not None
        self._start_ns = self.clock.now_ns()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with ExitStack() as stack:  # each of these is done whatever becomes of the others
            stack.callback(self.drive.close)
            stack.callback(self.instrument.close)
            if not self._was_enabled:
                stack.callback(self._disable_if_reachable, raising=exc_type is None)
            if exc_type is not None:
                stack.callback(self._stop_whatever_happens)
            self._entered = self.drive.corrected_outside = False
            self._stopped_for = None
            self.history = None

    @contextmanager
    def one_job(self) -> Iterator[None]:
        """One of several jobs on one connection: each begins as if the session had just been entered, and ends by putting the axis
        back as it was found, stopped first where the job failed. What was in force of a correction is not any more.

        An axis that was homed by an earlier job is not homed again unless its drive was in a fault since: by a method that takes the
        present position for home, that would move the zero.
        """
        sample = self.drive.sample()
        self._was_enabled = sample.state is DriveState.ENABLED
        self._keeps_home = self._has_home and sample.homed is True
        self._latest = self._datum_mm = self.history = self._stopped_for = None
        self._start_ns = self.clock.now_ns()
        self.time_offset_s = 0.0
        self.compensation = None
        try:
            yield
        except BaseException as error:
            self._stop_for(error)
            if not self._was_enabled:
                self._disable_if_reachable(raising=False)
            raise
        finally:
            self.compensation = None
        if not self._was_enabled:
            self.drive.disable()

    def _stop_whatever_happens(self) -> None:
        """Quick stop on the way out; the error under way matters more than one of stopping, so that is not raised.

        Where the axis comes to rest nobody knows, so neither is the direction it came from.
        """
        for axis in (self, *self.beside):
            axis.history = None
            with suppress(BridgeError):  # the link is gone or the drive is in a fault: there is nothing left to tell it
                axis.drive.quick_stop()

    @contextmanager
    def stopping_on_error(self) -> Iterator[None]:
        """Whatever goes wrong inside, an interrupt from the keyboard too, stops the axis, and those beside it, at once."""
        try:
            yield
        except BaseException as error:
            self._stop_for(error)
            raise

    def _stop_for(self, error: BaseException) -> None:
        """Once for each error, however many hands it passes through on its way up."""
        if error is not self._stopped_for:
            self._stopped_for = error
            self._stop_whatever_happens()

    def _disable_if_reachable(self, *, raising: bool) -> None:
        try:
            self.drive.disable()
        except BridgeError:
            if raising:
                raise

    # -- one correction --------------------------------------------------------------------------------------------------
    @property
    def compensation(self) -> Compensation | None:
        """What the bridge corrects by; None leaves commands as they are.

        Putting one into force raises StateError while the drive corrects by a table of its own: the error would be taken out twice.
        The drive is asked, each time and before each move.
        """
        return self._compensation

    @compensation.setter
    def compensation(self, compensation: Compensation | None) -> None:
        if compensation is not None and self._entered:
            refuse_while_drive_corrects(self.drive)
        self._compensation = compensation
        self.drive.corrected_outside = compensation is not None

    # -- watching ----------------------------------------------------------------------------------------------------
    def elapsed_s(self) -> float:
        """Seconds since the session was entered, in the clock's time."""
        return (self.clock.now_ns() - self._start_ns) / NS_PER_S

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
            self._has_home = self._keeps_home = False
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
        """What the instrument has sent, each with its number in the session, for while a stream looks after the drive.

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
                self._require_enabled(sample, what)
                if condition(sample):
                    return sample
                if deadline.expired:
                    raise MotionTimeoutError(f"drive {self.drive.name}: {what} not over within {timeout_s:.1f} s")
                self.clock.sleep_s(SLICE_S)

    def _require_enabled(self, sample: DriveSample, what: str) -> None:
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {self.drive.name}: {what} ended by itself, it is {sample.state.value}")

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

    # -- getting ready -----------------------------------------------------------------------------------------------
    def prepare(self) -> None:
        """Signal, enable, home, datum: afterwards positions of the instrument are load positions of the axis.

        The instrument's zero is taken once, at the reference position approached upwards and without any correction, so that all
        passes of a session, with and without correction, share one datum. Raises StateError while the drive corrects by a table of
        its own: that datum, and tables made on it, would hold the drive's correction.
        """
        if not self._entered:
            raise StateError("prepare() needs the session to be entered first")
        refuse_while_drive_corrects(self.drive)
        self.drive.require(Capability.PROFILE_POSITION, *([Capability.HOMING] if self.how.home else []))
        self.await_instrument()
        self.watch(max(self.how.reading_s, 2 * SLICE_S))
        if self.drive.sample().state is not DriveState.ENABLED:
            self.drive.enable()
        if self.how.home and not self._keeps_home:
            self.history = None
            limits = self.drive.limits
            slowest = limits.max_velocity_mm_s / 100
            self._start(self.drive.start_homing)
            self.watch_until(
                lambda sample: bool(sample.homed) and sample.target_reached,
                30 + (limits.travel_max_mm - limits.travel_min_mm) / slowest,
                "homing",
            )
            self._has_home = True
        self.take_datum()

    def take_datum(self) -> None:
        """Go to the reference position from below, uncorrected, and call the instrument's reading there that position."""
        self.come_to_reference()
        self._datum_mm = self.raw_average() - self.how.reference_mm

    def come_to_reference(self) -> None:
        """Go to the reference position from below, uncorrected; from there on the direction of arrival is known."""
        reference = self.how.reference_mm
        here = self.drive.sample().position_load_mm
        self.move_uncorrected(reference - self.how.overrun_mm, self.how.velocity_mm_s)
        self.move_uncorrected(reference, self.how.velocity_mm_s)
        self.history = MotionHistory(here).moved_to(reference - self.how.overrun_mm).moved_to(reference)
        self._commanded_mm = reference

    def move_uncorrected(self, position_load_mm: float, velocity_mm_s: float) -> None:
        """Move the motor to a position as it is, watched; the history for corrections is unknown afterwards."""
        self.history = None
        travel_mm = abs(position_load_mm - self.drive.sample().position_load_mm)
        self._start(lambda: self.drive.start_move(position_load_mm, velocity_mm_s))
        self._wait_arrived(position_load_mm, travel_mm, velocity_mm_s)

    def approach(self, position_mm: float) -> None:
        """Go to where the next target is approached from. Raises LimitError before any motion.

        Nothing is measured there, so where the correction leads out of the travel (the overrun of an outermost target may end
        right at its end) it is left out.
        """
        command = self._command(position_mm)
        limits = self.drive.limits
        if not limits.travel_min_mm <= command.command_mm <= limits.travel_max_mm:
            command = Command(position_mm, position_mm, 0.0, command.history)
        self._move(command, None)

    def _start(self, start: Callable[[], None]) -> None:
        """Start a motion; after any error but a refusal it may be under way, and is stopped."""
        try:
            start()
        except (LimitError, LocalError):
            raise  # refused: nothing moved, nothing is forgotten
        except BaseException as error:
            self._stop_for(error)
            raise

    def raw_average(self) -> float:
        """Dwell, then the instrument's own position in mm, averaged over the reading time."""
        return average_at_rest(self).position_mm

    # -- moving ------------------------------------------------------------------------------------------------------
    def known(self, velocity_mm_s: float = 0.0) -> dict[str, float]:
        """What is known when a set-point is issued, as record columns: time, feed, sensors."""
        environment = self.instrument.environment()
        known = {"time_s": self.elapsed_s() + self.time_offset_s, "velocity_mm_s": velocity_mm_s}
        for name, value in (
            ("air_temp_c", environment.air_temp_c),
            ("air_pressure_hpa", environment.air_pressure_hpa),
            ("air_humidity_percent", environment.air_humidity_percent),
        ):
            if value is not None:
                known[name] = value
        for place, value in environment.place_temps_c.items():
            known[f"temp_{place}_c"] = value
        known.update(environment.beside)
        known.update(self.conditions.read())
        return known

    def move_to(self, target_mm: float, velocity_mm_s: float | None = None) -> Command:
        """Move to a target with the correction in force; returns, once the axis has arrived, the command it was given.

        Raises LimitError before any motion when the target, or the corrected command, leaves the travel; StateError when the
        correction would turn the motion around.
        """
        command = self._command(target_mm)
        self._move(command, velocity_mm_s)
        return command

    def _command(self, target_mm: float) -> Command:
        if self._compensation is not None:
            refuse_while_drive_corrects(self.drive)
        return self._command_of(target_mm, self.known())

    def _command_of(self, target_mm: float, known: Mapping[str, float]) -> Command:
        history = self._known_history()
        if self._compensation is None:
            return Command(target_mm, target_mm, 0.0, history.moved_to(target_mm))
        return self._compensation.command(target_mm, history, known)

    def _known_history(self) -> MotionHistory:
        if self.history is None:
            raise StateError(
                "where the axis came from is unknown, and with it the direction of arrival: prepare() or take_datum() first"
            )
        return self.history

    def _move(self, command: Command, velocity_mm_s: float | None) -> None:
        velocity = self.how.velocity_mm_s if velocity_mm_s is None else velocity_mm_s
        self.drive.limits.check_target(command.target_mm)
        history = self._known_history()
        travel_mm = abs(command.target_mm - history.position_mm)
        if travel_mm and not (command.command_mm - self._commanded_mm) * command.history.direction > 0:
            raise StateError(
                f"the correction at {command.target_mm:g} mm ({command.correction_um:+.1f} µm) turns a motion of"
                f" {travel_mm * 1000:.1f} µm around: the direction of arrival would not be the one it is for;"
                " take a longer way (overrun_mm)"
            )
        self._start(lambda: self.drive.start_move(command.command_mm, velocity))
        self.history, self._commanded_mm = command.history, command.command_mm
        self._wait_arrived(command.command_mm, travel_mm, velocity)

    def _wait_arrived(self, command_mm: float, travel_mm: float, velocity_mm_s: float) -> None:
        expected_s = travel_mm / velocity_mm_s + velocity_mm_s / self.drive.limits.max_acceleration_mm_s2
        with self.stopping_on_error():
            sample = self.watch_until(lambda sample: sample.target_reached, 5.0 + 3.0 * expected_s, "move")
            if abs(sample.position_load_mm - command_mm) > ARRIVED_WITHIN_MM:
                raise FollowingErrorError(
                    f"drive {self.drive.name} says it arrived, but is at {sample.position_load_mm:.4f} mm,"
                    f" expected {command_mm:.4f} mm"
                )

    def stream_along(
        self, path_mm: Iterable[tuple[float, float]], settings: SetPointSettings, at: Callable[[SetPointStream], None]
    ) -> None:
        """Follow a path, one set-point per period, each with the correction in force; `at` is called after each.

        path_mm: targets and the velocities (mm/s) there, from where the axis stands.
        """
        known = self.known_in_stream()
        with self.stopping_on_error(), self.drive.stream(settings) as stream:
            for target_mm, velocity_mm_s in path_mm:
                command = self.set_point(target_mm, velocity_mm_s, known)
                stream.cycle(command.command_mm)
                self.given(command)
                at(stream)

    def known_in_stream(self) -> dict[str, float]:
        """What `set_point` needs to know, read once before a stream. Raises as refusing a correction that the drive makes too."""
        if self._compensation is not None:
            refuse_while_drive_corrects(self.drive)
        return self.known()

    def set_point(self, target_mm: float, velocity_mm_s: float, known: dict[str, float]) -> Command:
        """One set-point of a stream with the correction in force; once the drive has it, tell it by `given`. Raises LimitError."""
        self.drive.limits.check_target(target_mm)
        known["velocity_mm_s"] = velocity_mm_s
        known["time_s"] = self.elapsed_s() + self.time_offset_s
        return self._command_of(target_mm, known)

    def given(self, command: Command) -> None:
        """The drive has this set-point: the axis's history goes on from there."""
        self.history, self._commanded_mm = command.history, command.command_mm

    @property
    def commanded_mm(self) -> float:
        """The last command, NaN while the axis's history is unknown."""
        return math.nan if self.history is None else self._commanded_mm

    @property
    def stroke_or_long_mm(self) -> float:
        """Length of the stroke before the last reversal."""
        return self._known_history().stroke_or_long_mm

    def load_position_mm(self, reading: Reading) -> float:
        """A good reading in the frame of the load. Raises StateError before `prepare()`."""
        if self._datum_mm is None or reading.position_mm is None:
            raise StateError("a position needs a good reading, and prepare() first: the instrument has no datum")
        return self._in_load_frame(reading.position_mm, self._datum_mm)

    def _in_load_frame(self, position_mm: float, datum_mm: float) -> float:
        """Lengths from the reference position are brought to 20 °C where the axis file says of what they are."""
        load_mm = position_mm - datum_mm
        if self.material is None:
            return load_mm
        reference_mm = self.how.reference_mm
        return reference_mm + self.material.at_reference_mm(load_mm - reference_mm, self.instrument.environment())

    # -- reading -----------------------------------------------------------------------------------------------------
    def read_position(self) -> PositionReading:
        """Dwell, then average the instrument over the reading time. Raises MeasurementLostError without readings."""
        if self._datum_mm is None:
            raise StateError("read_position() needs prepare() first: the instrument has no datum")
        mean = average_at_rest(self)
        load_mm = self._in_load_frame(mean.position_mm, self._datum_mm)
        return PositionReading(load_mm, mean.std_um, mean.count, self.drive.sample(), mean.mean_std_um, mean.left_out)
