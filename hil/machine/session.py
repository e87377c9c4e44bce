"""An axis under measurement: drive, instrument and compensation together.

An `AxisSession` prepares the axis, moves it to targets and reads where it came to. Its `Supervisor` looks at drive and instrument
during every wait and stops the axis for whatever is wrong; its `Steering` knows what the drive is told for a target. On leaving, the
axis is put back as it was found: disabled unless it was enabled before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.drive import Capability, DriveSample, ServoDrive
from drivers.errors import StateError
from drivers.instrument import DistanceInstrument, Reading
from drivers.set_points import SetPointSettings, SetPointStream
from drivers.undo import undo_all
from hil.axis.agreement import AgreementLimits
from hil.axis.axis_file import MeasurementConfig
from hil.correction.compensation import Command, Compensation, MotionHistory
from hil.figures.material import Material
from hil.machine.conditions import Conditions, NoConditions
from hil.machine.dwell import average_at_rest
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.machine.set_points import Steering
from hil.machine.supervisor import SLICE_S, Look, Supervisor
from hil.machine.watched_axis import STALE_AFTER_S, WatchedAxis
from hil.records.zero import ZeroKeeper


@dataclass(frozen=True)
class PositionReading:
    """The load's position at rest, averaged over a window by the rules of `hil.figures.reading`.

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

    how: velocities, dwell and reading times; stale_after_s: oldest reading that is still believed; agreement: of the instrument with
    the motor, None: the defaults.
    """

    def __init__(
        self,
        drive: ServoDrive,
        instrument: DistanceInstrument,
        how: MeasurementConfig,
        *,
        stale_after_s: float = STALE_AFTER_S,
        agreement: AgreementLimits | None = None,
        conditions: Conditions | None = None,
    ) -> None:
        self.clock = drive.clock
        self.how = how
        self.conditions: Conditions = NoConditions() if conditions is None else conditions
        self.steering = Steering()
        self.axis = WatchedAxis(
            drive, instrument, stale_after_s=stale_after_s, agreement=agreement, on_stop=self.steering.lose
        )
        self.supervisor = Supervisor([self.axis])
        self.material: Material | None = None  # what lengths are brought to 20 °C by
        self.resume_within_s: float | None = None  # for a lost signal, before the axis moves again by itself
        self.zero: ZeroKeeper | None = (
            None  # None: nothing is known of earlier connections (a recording that is played)
        )
        self.time_offset_s = 0.0  # of `time_s` in rows: a resumed campaign goes on where it was left
        self._datum_mm: float | None = None
        self._entered = False
        self._homed_here = False  # since it was entered
        self._keeps_home = False  # that of an earlier job, unless the drive was in a fault since

    @property
    def drive(self) -> ServoDrive:
        """The one that is watched."""
        return self.axis.drive

    @property
    def instrument(self) -> DistanceInstrument:
        """The one that is watched."""
        if self.axis.instrument is None:
            raise StateError(f"drive {self.drive.name} is watched without an instrument")
        return self.axis.instrument

    # -- coming and going --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self.drive.open()
        try:
            self.instrument.open()
            self.supervisor.begin()
        except BaseException as error:
            undo_all((("", self.instrument.close), ("", self.drive.close)), during=error)
            raise
        self._entered = True
        self._homed_here = self._keeps_home = False
        self.drive.corrected_outside = self.compensation is not None
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self.supervisor.leave(
                exc,
                (f"drive {self.drive.name} was not let go", self.drive.close),
                (f"instrument {self.instrument.name} was not let go", self.instrument.close),
            )
        finally:
            self._entered = self.drive.corrected_outside = False
            self.steering.lose()

    @contextmanager
    def one_job(self) -> Iterator[None]:
        """One of several jobs on one connection: each begins as if the session had just been entered, and ends by putting the axis
        back as it was found, stopped first where the job failed. What was in force of a correction is not any more.

        An axis that was homed by an earlier job is not homed again unless its drive was in a fault since: by a method that takes the
        present position for home, that would move the zero.
        """
        self._keeps_home = self._homed_here and self.drive.sample().homed is True
        self._datum_mm = None
        self.time_offset_s = 0.0
        self.supervisor.begin()
        self.steering.lose()
        self.compensation = None
        try:
            with self.supervisor.leaving():
                yield
        finally:
            self.compensation = None

    # -- one correction --------------------------------------------------------------------------------------------------
    @property
    def compensation(self) -> Compensation | None:
        """What the bridge corrects by; None leaves commands as they are.

        Putting one into force raises StateError while the drive corrects by a table of its own: the error would be taken out twice.
        The drive is asked, each time and before each move. Raises CorrectionBoundError for one beyond the axis's bound.
        """
        return self.steering.compensation

    @compensation.setter
    def compensation(self, compensation: Compensation | None) -> None:
        if compensation is not None and self._entered:
            refuse_while_drive_corrects(self.drive)
            if self.zero is not None:
                self.zero.check_tables(compensation.zero)
        if compensation is not None:
            compensation.check(self.steering.bound, "correction not put into force")
        self.steering.compensation = compensation
        self.drive.corrected_outside = compensation is not None

    # -- watching ----------------------------------------------------------------------------------------------------
    def elapsed_s(self) -> float:
        """Seconds since the session was entered, or its job began, in the clock's time."""
        return self.axis.elapsed_s()

    def await_instrument(self) -> None:
        """Before anything moves: wait for the instrument's first reading."""
        self.supervisor.await_instrument()

    def watch(self, duration_s: float) -> list[Reading]:
        """Let time pass with the axis at rest, watched; returns the readings that arrived meanwhile."""
        return self.supervisor.watch(duration_s)

    def readings(self) -> list[tuple[int, Reading]]:
        """What the instrument has sent, each with its number in the session, for while a stream looks after the drive."""
        return self.supervisor.readings()

    # -- getting ready -----------------------------------------------------------------------------------------------
    def prepare(self, campaign: Path | None = None, compensation: Compensation | None = None) -> None:
        """Signal, enable, home, datum: afterwards positions of the instrument are load positions of the axis.

        campaign: the folder of the rows that are to be measured; compensation: what is to be put into force. Raises ZeroError for
        either, or an axis, in another zero than the axis had: before anything moves, or at the reference position.

        The instrument's zero is taken once, at the reference position approached upwards and without any correction, so that all
        passes of a session, with and without correction, share one datum. Raises StateError while the drive corrects by a table of
        its own: that datum, and tables made on it, would hold the drive's correction.
        """
        if not self._entered:
            raise StateError("prepare() needs the session to be entered first")
        refuse_while_drive_corrects(self.drive)
        self.drive.require(Capability.PROFILE_POSITION, *([Capability.HOMING] if self.how.home else []))
        self.await_instrument()
        readings = self.watch(max(self.how.reading_s, 2 * SLICE_S))
        if self.zero is not None:
            stored = None if compensation is None else compensation.zero
            old = compensation is not None and stored is None
            self.zero.begin(self.drive, homes=self.how.home, campaign=campaign, tables=stored, old_tables=old)
        self.supervisor.enable()
        stands = self.zero is not None and self.zero.homing_would_lose_zero
        anew = self.zero is not None and self.zero.anew
        if self.how.home and not stands and (anew or self.axis.saw_fault or not self._keeps_home):
            self.steering.lose()
            self.supervisor.home()
            self._homed_here, self.axis.saw_fault = True, False
        raw_mm = self._at_reference_mm()
        if self.zero is not None:
            sequence = readings[-1].sequence if readings and self.instrument.numbers_samples else None
            motor_mm = self.drive.sample().position_load_mm
            self.zero.at_reference(motor_mm, raw_mm, sequence, self.instrument.sample_rate_hz)
        self._datum_mm = raw_mm - self.how.reference_mm

    def take_datum(self, *, signal_was_lost: bool = False) -> None:
        """Go to the reference position from below, uncorrected, and call the instrument's reading there that position."""
        raw_mm = self._at_reference_mm()
        self._datum_mm = raw_mm - self.how.reference_mm
        if signal_was_lost and self.zero is not None:
            self.zero.instrument_lost(self.drive.sample().position_load_mm, raw_mm)

    def _at_reference_mm(self) -> float:
        self.come_to_reference()
        return self.raw_average()

    def come_to_reference(self) -> None:
        """Go to the reference position from below, uncorrected; from there on the direction of arrival is known."""
        reference = self.how.reference_mm
        here = self.drive.sample().position_load_mm
        self.move_uncorrected(reference - self.how.overrun_mm, self.how.velocity_mm_s)
        self.move_uncorrected(reference, self.how.velocity_mm_s)
        came = MotionHistory(here).moved_to(reference - self.how.overrun_mm).moved_to(reference)
        self.steering.stands(came, reference)

    @contextmanager
    def without_power(self) -> Iterator[None]:
        """While somebody reaches into the machine. Afterwards the axis is enabled again and comes to the reference position, so that
        the direction it came from is known; the instrument's zero is kept."""
        self.drive.disable()
        self.steering.lose()
        yield
        self.drive.enable()
        self.come_to_reference()

    def move_uncorrected(
        self, position_load_mm: float, velocity_mm_s: float, *, slice_s: float = SLICE_S, look: Look | None = None
    ) -> None:
        """Move the motor to a position as it is, watched; the history for corrections is unknown afterwards.

        slice_s: how often it is looked at; look: hears each sample.
        """
        self.steering.lose()
        self.supervisor.move(position_load_mm, velocity_mm_s, slice_s=slice_s, look=look)

    def acknowledge_loss(self) -> None:
        """After a lost signal, read positions again; their zero may be a new one."""
        self.axis.acknowledge_loss()

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

    def raw_average(self) -> float:
        """Dwell, then the instrument's own position in mm, averaged over the reading time."""
        return average_at_rest(self.supervisor, self.how).position_mm

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
        return self.steering.command(target_mm, self.known_for_commands())

    def known_for_commands(self) -> dict[str, float]:
        """What is known now, once for a move or a stream. Raises StateError for a correction in force that the drive makes too."""
        if self.compensation is not None:
            refuse_while_drive_corrects(self.drive)
        return self.known()

    def _move(self, command: Command, velocity_mm_s: float | None) -> None:
        velocity = self.how.velocity_mm_s if velocity_mm_s is None else velocity_mm_s
        self.drive.limits.check_target(command.target_mm)
        self.steering.check_way(command)
        self.supervisor.move(command.command_mm, velocity, started=lambda: self.steering.given(command))

    def stream_along(
        self, path_mm: Iterable[tuple[float, float]], settings: SetPointSettings, at: Callable[[SetPointStream], None]
    ) -> None:
        """Follow a path, one set-point per period, each with the correction in force; `at` is called after each.

        path_mm: targets and the velocities (mm/s) there, from where the axis stands.
        """
        known = self.known_for_commands()
        with (
            self.supervisor.stopping_on_error(),
            self.axis.following() as found,
            self.drive.stream(settings) as stream,
        ):
            for target_mm, velocity_mm_s in path_mm:
                command = self.set_point(target_mm, velocity_mm_s, known)
                stream.cycle(command.command_mm)
                self.steering.given(command)
                found(*stream.found, velocity_mm_s)
                at(stream)

    def set_point(self, target_mm: float, velocity_mm_s: float, known: dict[str, float]) -> Command:
        """One set-point of a stream with the correction in force; once the drive has it, tell `steering`. Raises LimitError."""
        self.drive.limits.check_target(target_mm)
        known["velocity_mm_s"] = velocity_mm_s
        known["time_s"] = self.elapsed_s() + self.time_offset_s
        return self.steering.command(target_mm, known)

    @property
    def history(self) -> MotionHistory | None:
        """The commanded motion so far, None while it is unknown."""
        return self.steering.history

    @property
    def commanded_mm(self) -> float:
        """The last command, NaN while the axis's history is unknown."""
        return self.steering.commanded_mm

    @property
    def stroke_or_long_mm(self) -> float:
        """Length of the stroke before the last reversal."""
        return self.steering.known_history.stroke_or_long_mm

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
        mean = average_at_rest(self.supervisor, self.how)
        load_mm = self._in_load_frame(mean.position_mm, self._datum_mm)
        return PositionReading(load_mm, mean.std_um, mean.count, self.drive.sample(), mean.mean_std_um, mean.left_out)
