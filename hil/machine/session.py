"""The session of one axis under measurement: drive, instrument and compensation.

An `AxisSession` prepares the axis, moves it to targets and reads the position reached. Its `Supervisor` samples drive and instrument
during every wait and stops the axis on any error; its `CommandState` computes the command for a target. On leaving, the axis is
disabled unless it was enabled on entering.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.drive import Capability, DriveSample, ServoDrive
from drivers.errors import InputError, InstrumentLinkError, LinkLostError, StateError
from drivers.instrument import DistanceInstrument, Reading
from drivers.set_points import SetPointSettings, SetPointStream
from drivers.undo import undo_all
from hil.axis.agreement import AgreementLimits
from hil.axis.axis_file import MeasurementConfig
from hil.correction.compensation import Compensation, CorrectedSetPoint, MotionHistory
from hil.correction.streamed import StreamedCorrection
from hil.effects.history import Course, through
from hil.figures.material import Material
from hil.machine.conditions import Conditions, NoConditions
from hil.machine.cross_axis import CrossAxisDrive
from hil.machine.dwell import average_at_rest
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.machine.set_points import CommandState
from hil.machine.supervisor import SLICE_S, Look, Supervisor
from hil.machine.watched_axis import STALE_AFTER_S, WatchedAxis
from hil.records.made_with import MadeWithKeeper
from hil.records.zero import ZeroKeeper


@dataclass(frozen=True)
class PositionReading:
    """The load's position at rest, mm, averaged over the reading time by the rules of `hil.figures.reading`.

    std_um: standard deviation of one reading; mean_std_um: of the mean; count: readings used; left_out: outliers, not used.
    """

    position_load_mm: float
    std_um: float
    count: int
    sample: DriveSample
    mean_std_um: float = math.nan
    left_out: int = 0


class AxisSession:
    """A context manager: entering connects and enables nothing; leaving stops after an error, disables and disconnects.

    how: velocities, dwell and reading times; stale_after_s: greatest age of a sample or reading that is used; agreement: limits of
    instrument against motor, None: the defaults.
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
        self.command_state = CommandState()
        self.axis = WatchedAxis(
            drive, instrument, stale_after_s=stale_after_s, agreement=agreement, on_stop=self.command_state.forget
        )
        self.supervisor = Supervisor([self.axis])
        self.material: Material | None = None  # for the reduction of lengths to 20 °C; None: no reduction
        self.resume_within_s: float | None = (
            None  # time limit for a lost signal to come back; None: no automatic resume
        )
        self.cross: CrossAxisDrive | None = (
            None  # moved against this axis's straightness error; None: no such axis is connected
        )
        self.beside_in_stream: frozenset[str] = frozenset()  # axes whose set-points the caller moves by `across_um`
        self.made_with: MadeWithKeeper | None = None  # None: as for zero
        self.zero: ZeroKeeper | None = None  # None: no record of earlier connections (a replayed recording)
        self.time_offset_s = 0.0  # added to `time_s` in rows, so that a resumed campaign continues its time
        self._datum_mm: float | None = None  # instrument's reading at load position 0
        self._entered = False
        self._homed_here = False  # since the session was entered
        self._keeps_home = False  # the homing of an earlier job is still valid
        self._course = Course()  # of the sensors, for effects that read them through a lag
        self._notes_told = 0  # of the drive's notes: those of `open` are the doctor's

    @property
    def drive(self) -> ServoDrive:
        return self.axis.drive

    @property
    def instrument(self) -> DistanceInstrument:
        """The watched instrument. Raises StateError for an axis without one."""
        if self.axis.instrument is None:
            raise StateError(f"drive {self.drive.name} is watched without an instrument")
        return self.axis.instrument

    # -- coming and going --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self.drive.open()
        try:
            self._open_instrument()
            self.supervisor.begin()
        except BaseException as error:
            undo_all((("", self.instrument.close), ("", self.drive.close)), during=error)
            raise
        self._entered = True
        self._notes_told = len(self.drive.notes)
        self._homed_here = self._keeps_home = False
        self.drive.corrected_outside = self.compensation is not None
        return self

    def _open_instrument(self) -> None:
        try:
            self.instrument.open()
        except LinkLostError as error:
            raise InstrumentLinkError(
                f"instrument {self.instrument.name} ([instrument] of the axis file): {error}"
            ) from error

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
            self.command_state.forget()

    def untold_notes(self) -> list[str]:
        """What was found of the drive while it moved, since the session was entered or this was last called; one sentence each."""
        new = list(self.drive.notes[self._notes_told :])
        self._notes_told += len(new)
        return new

    @contextmanager
    def one_job(self) -> Iterator[None]:
        """Run one of several jobs on one connection. It begins as if the session had just been entered, without a correction; who
        begins it acknowledges a signal that was lost. At its end the axis is stopped where the job failed, and disabled unless it was
        enabled at the begin.

        An axis that an earlier job has homed is not homed again unless its drive was in a fault since: a method that takes the present
        position for home would move the zero.
        """
        self._keeps_home = self._homed_here and self.drive.sample().homed is True
        self._datum_mm = None
        self.time_offset_s = 0.0
        self.acknowledge_loss()
        self.supervisor.begin()
        self.command_state.forget()
        self.compensation = None
        try:
            with self.supervisor.leaving():
                yield
        finally:
            self.compensation = None

    # -- one correction --------------------------------------------------------------------------------------------------
    @property
    def compensation(self) -> Compensation | None:
        """The bridge's correction; None leaves commands as they are.

        Setting it raises StateError while the drive corrects by a table of its own (the error would be corrected twice), ZeroError for
        tables of another zero, MadeWithError for tables made with other parameters of the drive, and CorrectionBoundError for a
        correction beyond the axis's bound. The drive's table is also checked before each move. A straightness table that moves
        another axis needs that axis connected and ready (StateError), and is held against its bound and travel too
        (CorrectionBoundError, LimitError).
        """
        return self.command_state.compensation

    @compensation.setter
    def compensation(self, compensation: Compensation | None) -> None:
        if compensation is not None and self._entered:
            refuse_while_drive_corrects(self.drive)
            if self.zero is not None:
                self.zero.check_tables(compensation.zero)
            self._check_made_with(compensation)
        if compensation is not None:
            compensation.check(self.command_state.bound, "correction not put into force")
            self._check_cross(compensation)
        self.command_state.compensation = compensation
        self.drive.corrected_outside = compensation is not None

    def _check_cross(self, compensation: Compensation, *, ready: bool = True) -> None:
        """Check the axis that the compensation moves, and, with `ready`, that it stands where it was commanded to."""
        name = compensation.moves_axis
        if not name or name in self.beside_in_stream:
            return
        if self.cross is None or self.cross.name != name:
            raise StateError(
                f"the straightness correction of axis {self.drive.name} moves axis {name}, which is not connected here"
                " ([straightness] axis_file of the axis file names it)"
            )
        self.cross.check(compensation.tables)
        if ready and not self.cross.ready:
            raise StateError(f"axis {name}, which straightness moves, is not ready: prepare() first")

    def require_cross(self) -> CrossAxisDrive:
        """The axis that straightness moves. Raises InputError where none is connected."""
        if self.cross is None:
            raise InputError("straightness is corrected by another axis, and none is connected")
        return self.cross

    @property
    def _cross_in_use(self) -> CrossAxisDrive | None:
        """The axis that straightness moves, while it stands ready or has to: then commands for it raise until it does."""
        cross = self.cross
        if cross is None or cross.ready:
            return cross
        return cross if self.compensation is not None and self.compensation.moves_axis == cross.name else None

    def _check_made_with(self, compensation: Compensation) -> None:
        if self.made_with is not None:
            self.made_with.check(self.drive, compensation.made_with, reversal=compensation.corrects_reversal)

    # -- watching ----------------------------------------------------------------------------------------------------
    def elapsed_s(self) -> float:
        """Seconds since the session was entered, or its job began, in the clock's time."""
        return self.axis.elapsed_s()

    def await_instrument(self) -> None:
        """Wait for the instrument's first reading; call before any motion. Raises MeasurementLostError when none comes."""
        self.supervisor.await_instrument()

    def watch(self, duration_s: float) -> list[Reading]:
        """Watch the axis at rest for `duration_s`; returns the readings that arrived meanwhile. Raises what `WatchedAxis.look`
        raises."""
        return self.supervisor.watch(duration_s)

    def readings(self) -> list[tuple[int, Reading]]:
        """The instrument's new readings, each with its number in the session; for use while a stream samples the drive."""
        return self.supervisor.readings()

    # -- getting ready -----------------------------------------------------------------------------------------------
    def prepare(self, campaign: Path | None = None, compensation: Compensation | None = None) -> None:
        """Wait for the signal, enable, home and take the datum: afterwards the instrument's readings give load positions, mm.

        campaign: folder of the rows to be measured; compensation: the correction to be put into force afterwards.

        The datum is taken once, at the reference position approached upwards and without correction, so that all passes of a session,
        with and without correction, share it. Raises StateError while the drive corrects by a table of its own: the datum, and tables
        made on it, would contain the drive's correction. Raises ZeroError, before any motion or at the reference position, where the
        campaign, the tables or the axis have another zero than before, and MadeWithError, before any motion, where the drive no longer
        has the parameters that the tables, or the campaign's rows, were made with. Raises what moving and reading raise.
        """
        if not self._entered:
            raise StateError("prepare() needs the session to be entered first")
        refuse_while_drive_corrects(self.drive)
        if compensation is not None:
            self._check_cross(compensation, ready=False)
        self.drive.require(Capability.PROFILE_POSITION, *([Capability.HOMING] if self.how.home else []))
        self.await_instrument()
        readings = self.watch(max(self.how.reading_s, 2 * SLICE_S))
        if self.zero is not None:
            stored = None if compensation is None else compensation.zero
            old = compensation is not None and stored is None
            self.zero.begin(self.drive, homes=self.how.home, campaign=campaign, tables=stored, old_tables=old)
        if self.made_with is not None:
            self.made_with.begin(self.drive, campaign)
        if compensation is not None:
            self._check_made_with(compensation)
        if self.cross is not None:
            self.cross.get_ready()
        self.supervisor.enable()
        stands = self.zero is not None and self.zero.homing_would_lose_zero
        anew = self.zero is not None and self.zero.anew
        if self.how.home and not stands and (anew or self.axis.saw_fault or not self._keeps_home):
            self.command_state.forget()
            self.supervisor.home()
            self._homed_here, self.axis.saw_fault = True, False
        raw_mm = self._at_reference_mm()
        if self.zero is not None:
            sequence = readings[-1].sequence if readings and self.instrument.numbers_samples else None
            motor_mm = self.drive.sample().position_load_mm
            self.zero.at_reference(motor_mm, raw_mm, sequence, self.instrument.sample_rate_hz)
        self._datum_mm = raw_mm - self.how.reference_mm

    def take_datum(self, *, signal_was_lost: bool = False) -> None:
        """Take the datum anew: move to the reference position from below, uncorrected, and equate the reading there with it."""
        raw_mm = self._at_reference_mm()
        self._datum_mm = raw_mm - self.how.reference_mm
        if signal_was_lost and self.zero is not None:
            self.zero.instrument_lost(self.drive.sample().position_load_mm, raw_mm)

    def _at_reference_mm(self) -> float:
        self.come_to_reference()
        return self.raw_average()

    def come_to_reference(self) -> None:
        """Move to the reference position from below, uncorrected; afterwards the direction of arrival is known."""
        if self.cross is not None:
            self.cross.get_ready()  # it lost its place where it was stopped
        reference = self.how.reference_mm
        here = self.drive.sample().position_load_mm
        self.move_uncorrected(reference - self.how.overrun_mm, self.how.velocity_mm_s)
        self.move_uncorrected(reference, self.how.velocity_mm_s)
        came = MotionHistory(here).moved_to(reference - self.how.overrun_mm).moved_to(reference)
        self.command_state.set_position(came, reference)

    @contextmanager
    def without_power(self) -> Iterator[None]:
        """Disable the axis inside the block, while a person works in the machine. Afterwards the axis is enabled and moves to the
        reference position, so that the direction of arrival is known. The datum is kept."""
        self.drive.disable()
        self.command_state.forget()
        if self.cross is not None:
            self.cross.without_power()
        yield
        self.drive.enable()
        self.come_to_reference()

    def move_uncorrected(
        self, position_load_mm: float, velocity_mm_s: float, *, slice_s: float = SLICE_S, look: Look | None = None
    ) -> None:
        """Move the motor to a position, mm, without correction, watched. The motion history is unknown afterwards.

        slice_s: interval between samples; look: called with each sample. Raises as `Supervisor.move`.
        """
        self.command_state.forget()
        self.supervisor.move(position_load_mm, velocity_mm_s, slice_s=slice_s, look=look)

    def acknowledge_loss(self) -> None:
        """Read positions again after a lost signal, whose cause somebody has removed. The instrument counts from another zero:
        `prepare` or `take_datum` comes next."""
        if self.axis.acknowledge_loss() and self.zero is not None:
            self.zero.signal_was_lost = True

    def approach(self, position_mm: float) -> None:
        """Move to the position, mm, from which the next target is approached. Raises LimitError before any motion.

        Nothing is measured there. Where the corrected command leaves the travel, as at the overrun of an outermost target, the
        correction is left out.
        """
        command = self._command(position_mm)
        limits = self.drive.limits
        if not limits.travel_min_mm <= command.command_mm <= limits.travel_max_mm:
            command = CorrectedSetPoint(position_mm, position_mm, 0.0, command.history)
        self._move(command, None)

    def raw_average(self) -> float:
        """Dwell, then average the instrument's own position, mm, over the reading time. Raises as `average_at_rest`."""
        return average_at_rest(self.supervisor, self.how).position_mm

    # -- moving ------------------------------------------------------------------------------------------------------
    def known(self, velocity_mm_s: float = 0.0) -> dict[str, float]:
        """Record columns known when a set-point is issued: time (s), feed (mm/s), sensors and conditions."""
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
        self._course.note(self.clock.now_ns() / 1e9, known)
        return known

    def move_to(
        self, target_mm: float, velocity_mm_s: float | None = None, *, across_um: float = 0.0
    ) -> CorrectedSetPoint:
        """Move to a target, mm, with the correction in force; returns the command once the axis has arrived.

        velocity_mm_s: None, the session's; across_um: what other axes add for their straightness. Raises LimitError before any motion
        when the target or the corrected command leaves the travel, StateError when the correction would reverse the motion, and what
        `Supervisor.move` raises.
        """
        command = self._command(target_mm, across_um)
        self._move(command, velocity_mm_s)
        return command

    def _command(self, target_mm: float, across_um: float = 0.0) -> CorrectedSetPoint:
        return self.command_state.command(target_mm, self.known_for_commands(), across_um=across_um)

    def known_for_commands(self) -> dict[str, float]:
        """`known()` at the begin of a move or a stream. Raises StateError while bridge and drive both correct."""
        if self.compensation is None:
            return self.known()
        refuse_while_drive_corrects(self.drive)
        known = self.known()
        for column, tau_s in self.compensation.lags:
            now = self._course.now(column, tau_s)
            if now is not None:
                known[through(column, tau_s)] = now
        return known

    def _move(self, command: CorrectedSetPoint, velocity_mm_s: float | None) -> None:
        velocity = self.how.velocity_mm_s if velocity_mm_s is None else velocity_mm_s
        self.drive.limits.check_target(command.target_mm)
        self.command_state.check_way(command)
        with self._cross_moving(command):
            self.supervisor.move(command.command_mm, velocity, started=lambda: self.command_state.issued(command))

    @contextmanager
    def _cross_moving(self, command: CorrectedSetPoint) -> Iterator[None]:
        """The block's move, together with that of the axis which straightness moves, to its place for the block's target."""
        cross = self._cross_in_use
        if cross is None:
            yield
            return
        across = cross.command(self.across_um(command.target_mm, cross.name), self.elapsed_s())
        if cross.unchanged(across):
            yield
            return
        cross.drive.limits.check_target(across.command_mm)
        cross.state.check_way(across)
        self.drive.limits.check_target(command.command_mm)
        started = partial(cross.state.issued, across)
        with self.supervisor.moving_beside(cross.axis, across.command_mm, cross.velocity_mm_s, started):
            yield

    def stream_along(
        self, path_mm: Iterable[tuple[float, float]], settings: SetPointSettings, at: Callable[[SetPointStream], None]
    ) -> None:
        """Follow a path, one set-point per period, each with the correction in force.

        path_mm: (target in mm, velocity in mm/s) of each period, starting where the axis stands; at: called after each set-point.
        Where straightness moves another axis, that axis gets its set-point in the same period. Raises LimitError for a target outside
        the travel, CapabilityError for axes that cannot stream together, and what the stream raises; any error stops the axes.
        """
        points = self.set_points()
        crosses = [] if self._cross_in_use is None else [self._cross_in_use]
        across = [(cross, cross.set_points(self.elapsed_s())) for cross in crosses]
        with ExitStack() as stack:
            stack.enter_context(self.supervisor.stopping_on_error())
            found = [stack.enter_context(axis.following()) for axis in (self.axis, *(cross.axis for cross in crosses))]
            stream = stack.enter_context(self.drive.stream(settings, [cross.drive for cross in crosses]))
            for target_mm, velocity_mm_s in path_mm:
                commands_mm = [self.set_point(points, target_mm, velocity_mm_s)]
                for cross, its_points in across:
                    across_um = self.across_um(target_mm, cross.name)
                    commands_mm.append(cross.set_point(its_points, across_um, self.elapsed_s()))
                stream.cycle(commands_mm)
                points.issued()
                self.command_state.found_at(stream.found[0][1])
                for _, its_points in across:
                    its_points.issued()
                for tell, place in zip(found, stream.found, strict=True):
                    tell(*place, velocity_mm_s)
                at(stream)

    def across_um(self, target_mm: float, other: str, direction: int = 0) -> float:
        """What this axis's straightness adds to the set-points of another while its own target is `target_mm`, µm.

        direction: of arrival there; 0: the one of a motion from where the axis stands
        """
        if self.compensation is None or self.compensation.moves_axis != other:
            return 0.0
        came = direction or self.command_state.known_history.moved_to(target_mm).direction
        return float(self.compensation.tables.cross_correction_um(target_mm, came, other))

    def set_points(self) -> StreamedCorrection:
        """Begin a stream of set-points with the correction in force and the sensors' values of this moment.

        Raises StateError while bridge and drive both correct, and as `CommandState.stream`.
        """
        return self.command_state.stream(self.known_for_commands())

    def set_point(
        self, points: StreamedCorrection, target_mm: float, velocity_mm_s: float, *, across_um: float = 0.0
    ) -> float:
        """The command, mm, for the next set-point of a stream. target_mm, velocity_mm_s: at this period; across_um: what other axes
        add for their straightness.

        The caller reports it by `points.issued` once the drive has it. Raises LimitError for a target outside the travel, and as
        `StreamedCorrection.command_mm`.
        """
        self.drive.limits.check_target(target_mm)
        if points.follows_motion:
            points.known["velocity_mm_s"] = velocity_mm_s
            points.known["time_s"] = self.elapsed_s() + self.time_offset_s
        return points.command_mm(target_mm, across_um)

    @property
    def history(self) -> MotionHistory | None:
        """The commanded motion so far, None while it is unknown."""
        return self.command_state.history

    @property
    def commanded_mm(self) -> float:
        """The last command, NaN while the axis's history is unknown."""
        return self.command_state.commanded_mm

    @property
    def stroke_or_long_mm(self) -> float:
        """Length of the stroke before the last reversal, mm. Raises StateError while the history is unknown."""
        return self.command_state.known_history.stroke_or_long_mm

    def load_position_mm(self, reading: Reading) -> float:
        """Load position of a reading, mm. Raises StateError before `prepare()` or for a reading without a position."""
        if self._datum_mm is None or reading.position_mm is None:
            raise StateError("expected prepare() and a good reading before a position: the instrument has no datum")
        return self._in_load_frame(reading.position_mm, self._datum_mm)

    def _in_load_frame(self, position_mm: float, datum_mm: float) -> float:
        """Load position, mm. Lengths from the reference position are reduced to 20 °C where the axis file names the material."""
        load_mm = position_mm - datum_mm
        if self.material is None:
            return load_mm
        reference_mm = self.how.reference_mm
        return reference_mm + self.material.at_reference_mm(load_mm - reference_mm, self.instrument.environment())

    # -- reading -----------------------------------------------------------------------------------------------------
    def read_position(self) -> PositionReading:
        """Dwell, then average the instrument over the reading time.

        Raises StateError before `prepare()`, MeasurementLostError without readings, and as `average_at_rest`.
        """
        if self._datum_mm is None:
            raise StateError("read_position() needs prepare() first: the instrument has no datum")
        mean = average_at_rest(self.supervisor, self.how)
        load_mm = self._in_load_frame(mean.position_mm, self._datum_mm)
        return PositionReading(load_mm, mean.std_um, mean.count, self.drive.sample(), mean.mean_std_um, mean.left_out)
