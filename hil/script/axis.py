"""An axis as one object for scripts: it is looked at and moved, and its jobs are those of the verbs and the screen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample, DriveState, ServoDrive
from drivers.errors import CapabilityError, InputError, LimitError, StateError
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.desk.reading import AxisReading
from hil.desk.rows import Rows
from hil.machine.events import Event, Listener, silent
from hil.records.journal import Campaign
from hil.script.given import Measuring, Passwords, RealTime, Reversing, Winding
from hil.script.results import (
    CalibrationResult,
    DoctorResult,
    LoopResult,
    ProcedureResult,
    ReversalResult,
    VerificationResult,
)

if TYPE_CHECKING:  # drivers and fits load slowly
    import canopen

    from drivers.instrument import Reading
    from hil.backlash.measured import BacklashResult
    from hil.correction.store import SealedStore
    from hil.desk.axis_thread import Connection
    from hil.desk.job import Job, Workplace
    from hil.desk.plan import Move
    from hil.desk.zero_statement import ZeroStatement
    from hil.machine.session import AxisSession
    from hil.machine.supervisor import Supervisor
    from hil.script.own_table import OwnTable
    from hil.script.parameters import Parameters
    from hil.script.procedure import Procedure
    from sim_backends.bench import Bench

ROUNDED = 1e-9
"""What a place (mm) and, as a share, a velocity may be beyond a planned move: they are sums and quotients of set-points."""


def open_axis(
    path: str | Path,
    *,
    password: str | None = None,
    key_password: str | None = None,
    on_event: Listener = silent,
    network: canopen.Network | None = None,
) -> Axis:
    """The axis of an axis file, for a `with` block. Entering connects the axis. Leaving stops it after an error, disables it unless it
    was enabled before, and disconnects it.

    password, key_password: of the sealed tables and of the builder's key; None takes them from the environment, the axis file or the
    keyboard. on_event: called with progress and warnings. network: your own canopen.Network in place of the axis file's bus. Raises
    InputError.
    """
    return Axis(load_drive_axis(path), Passwords(password, key_password), on_event, network=network)


class Axis:
    """A context manager, made by `hil.open`. After a job, call `home()` again before moving on."""

    def __init__(
        self,
        file: DriveAxis,
        passwords: Passwords,
        on_event: Listener,
        connection: Connection | None = None,
        network: canopen.Network | None = None,
    ) -> None:
        self.file = file
        self._passwords = passwords
        self._listener = on_event
        self._connection = connection  # given: of several axes, whose owner connects and disconnects them
        self._network = network
        self._shared = connection is not None
        self._stack = ExitStack()
        self._alone: Supervisor | None = None  # of a drive without an instrument
        self._bench: Bench | None = None
        self._opened_ns = 0
        self._homed = False  # the datum is taken, and the history known
        self._last: tuple[float, float, int] | None = None  # target, command, direction of arrival
        self._moves: tuple[Move, ...] | None = None  # that a procedure may make; None: no procedure runs
        self._first_run = 1

    @property
    def name(self) -> str:
        """Name of the axis in its file."""
        return self.file.name

    @property
    def parameters(self) -> Parameters:
        """The drive's parameters: backup, diff, download, verify, restore, store."""
        from hil.script.parameters import Parameters  # noqa: PLC0415

        return Parameters(self.file, self._carry_out)

    @property
    def drive_table(self) -> OwnTable:
        """The correction table that the drive itself holds: show, download, prove, remove."""
        from hil.script.own_table import OwnTable  # noqa: PLC0415

        return OwnTable(self.file, self._measured_file, self._passwords, self._carry_out)

    @property
    def first_run(self) -> int:
        """The first run that a procedure has to measure: 1, or after an interruption the run that was interrupted."""
        return self._first_run

    @property
    def bench(self) -> Bench:
        """The simulated machine of an axis file with backend "bench", new at each connection. Raises CapabilityError on hardware."""
        self._require()
        if self._bench is None:
            raise CapabilityError(f"axis {self.name} is no simulated machine in this process")
        return self._bench

    def __repr__(self) -> str:
        return f"<axis {self.name} of {self.file.path}{'' if self._connection else ', not open'}>"

    # -- coming and going ----------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self._connect()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._connection = None
        self._stack.__exit__(exc_type, exc, traceback)

    def confine(self, moves: tuple[Move, ...], first_run: int, begun_ns: int) -> None:
        """For the job of a procedure: the axis is homed, and moves within these moves alone. begun_ns: when its time began."""
        self._moves, self._first_run, self._opened_ns, self._homed = moves, first_run, begun_ns, True

    def hold(self) -> None:
        """For the job of a procedure that an error ends: no further move is one that its plan names."""
        self._moves = ()

    def forget(self) -> None:
        """The connection is closed by its owner; forget it."""
        self._connection = None

    def _connect(self) -> None:
        from hil.desk.axis_thread import Connection  # noqa: PLC0415  (drivers load slowly)
        from hil.machine.supervisor import Supervisor  # noqa: PLC0415
        from hil.machine.watched_axis import WatchedAxis  # noqa: PLC0415
        from hil.machine.who_is_there import naming_who_is_there  # noqa: PLC0415
        from hil.machine.wiring import connected, connected_drive  # noqa: PLC0415

        with ExitStack() as stack:
            with naming_who_is_there(self.file):
                if isinstance(self.file, AxisConfig):
                    machine = stack.enter_context(connected(self.file, network=self._network))
                    self._connection, self._bench = Connection(machine.session.drive, machine.session), machine.bench
                else:
                    drive = stack.enter_context(connected_drive(self.file, network=self._network))
                    self._connection = Connection(drive, None)
                    self._alone = stack.enter_context(Supervisor([WatchedAxis(drive)]))
            self._opened_ns = self._connection.drive.clock.now_ns()
            self._stack = stack.pop_all()

    @contextmanager
    def _disconnected(self) -> Iterator[None]:
        """For a job that connects the axis itself."""
        if self._shared:
            raise CapabilityError(f"axis {self.name} was opened with others: open it alone for this")
        self._require()
        self._connection = None
        self._stack.close()
        try:
            yield
        finally:
            self._connect()

    def _require(self) -> Connection:
        if self._connection is None:
            raise StateError(f'axis {self.name} is not open, expected: with hil.open("{self.file.path}") as axis')
        return self._connection

    @property
    def _supervisor(self) -> Supervisor:
        session = self._require().session
        if session is not None:
            return session.supervisor
        if self._alone is None:
            raise StateError(f"axis {self.name} is not open")
        return self._alone

    def _session(self) -> AxisSession:
        session = self._require().session
        if session is None:
            raise CapabilityError(f"axis {self.name} has no instrument: its file ends with the drive")
        return session

    # -- looking -------------------------------------------------------------------------------------------------------
    def read(self) -> AxisReading:
        """Drive, motor and instrument. At rest the instrument is averaged over reading_s, under power after a dwell. Raises
        MeasurementLostError without readings."""
        connection = self._require()
        session, drive = connection.session, connection.drive
        if session is None:
            return self._reading(self._supervisor.axes[0].look()[0], None)
        enabled = drive.sample().state is DriveState.ENABLED
        if self._homed and enabled:
            found = session.read_position()
            return self._reading(found.sample, found.position_load_mm, std_um=found.std_um)
        if enabled:
            return self._reading(drive.sample(), None, raw_mm=session.raw_average())
        positions = [one.position_mm for one in session.watch(session.how.reading_s) if one.position_mm is not None]
        if not positions:
            session.await_instrument()
        raw_mm = sum(positions) / len(positions) if positions else None
        return self._reading(drive.sample(), None, raw_mm=raw_mm)

    def watch(self, seconds: float, every_s: float = 0.05) -> Iterator[AxisReading]:
        """Yield readings for this time, as they come. An error of drive or instrument stops the axis and is raised."""
        axis, clock = self._supervisor.axes[0], self._require().drive.clock
        deadline, due_ns = clock.deadline(seconds), clock.now_ns()
        while not deadline.expired:
            due_ns = max(clock.now_ns(), due_ns + round(every_s * NS_PER_S))
            with self._supervisor.stopping_on_error():
                clock.sleep_until_ns(min(due_ns, deadline.end_ns))
                sample, readings = axis.look()
            yield self._with(sample, readings)

    def _with(self, sample: DriveSample, readings: Sequence[Reading]) -> AxisReading:
        session = self._require().session
        good = [one for one in readings if one.position_mm is not None]
        if session is None or not good:
            return self._reading(sample, None)
        if not self._homed:
            return self._reading(sample, None, raw_mm=good[-1].position_mm)
        return self._reading(sample, session.load_position_mm(good[-1]))

    def _reading(
        self,
        sample: DriveSample,
        instrument_mm: float | None,
        *,
        raw_mm: float | None = None,
        std_um: float | None = None,
    ) -> AxisReading:
        target_mm, command_mm, direction = self._last or (None, None, 0)
        return AxisReading(
            (sample.time_ns - self._opened_ns) / NS_PER_S,
            sample.state.value,
            sample.position_load_mm,
            instrument_mm,
            raw_mm,
            std_um,
            sample.velocity_mm_s,
            sample.torque_percent,
            sample.following_error_mm,
            sample.homed,
            sample.fault_code,
            target_mm,
            command_mm,
            direction,
            self._sensors(),
        )

    def _sensors(self) -> dict[str, float]:
        session = self._require().session
        known = {} if session is None else session.known()
        return {name: value for name, value in known.items() if name not in ("time_s", "velocity_mm_s")}

    # -- moving --------------------------------------------------------------------------------------------------------
    def home(self, *, corrected: bool = False, new_zero: bool = False, instrument_zeroed: bool = False) -> None:
        """Enable, home if the axis file says so, and set the instrument's datum at the reference position.

        corrected: whether the stored correction is in force afterwards; new_zero, instrument_zeroed: as the options of the verbs.
        """
        session = self._require().session
        if self._moves is not None:
            raise StateError(f"axis {self.name} is homed already: a procedure begins so")
        self._last = None
        if session is None:
            self._supervisor.get_ready(home=True)
            self._homed = True
            return
        store = self._passwords.store(self._measured_file(), writing=False) if corrected else None
        compensation = None if store is None else store.load()
        self._homed = False
        session.compensation = None
        with _stated(new_zero, instrument_zeroed).applied(session):
            session.prepare(None, compensation)
        session.compensation = compensation
        self._homed = True

    def move_to(self, position_mm: float, velocity_mm_s: float | None = None) -> None:
        """Move to a position, mm of the load, and return on arrival.

        velocity_mm_s: None takes that of [measurement]. Raises StateError before `home()` and after a stop, LimitError for a target
        outside the travel, and the error that stops the axis.
        """
        connection = self._require()
        session, sample = connection.session, connection.drive.sample()
        lost = session is not None and session.history is None
        if not self._homed or lost or sample.state is not DriveState.ENABLED:
            raise StateError(f"axis {self.name} is {sample.state.value} and not ready to move, expected home() first")
        connection.drive.limits.check_target(position_mm)
        before_mm = sample.position_load_mm if self._last is None else self._last[0]
        velocity, command_mm = self._velocity(velocity_mm_s), position_mm
        self._check_planned(position_mm, velocity)
        if session is None:
            self._supervisor.move(position_mm, velocity)
        else:
            command_mm = session.move_to(position_mm, velocity).command_mm
        came = 0 if position_mm == before_mm else 1 if position_mm > before_mm else -1
        direction = came or (0 if self._last is None else self._last[2])
        self._last = (position_mm, command_mm, direction)

    def _check_planned(self, position_mm: float, velocity_mm_s: float) -> None:
        """Raises LimitError for a move that a running procedure has not planned."""
        moves = self._moves
        if moves is not None and not any(
            one.low_mm - ROUNDED <= position_mm <= one.high_mm + ROUNDED
            and velocity_mm_s <= one.velocity_mm_s * (1.0 + ROUNDED)
            for one in moves
        ):
            raise LimitError(f"{position_mm:g} mm at {velocity_mm_s:g} mm/s is no move that plan() names")

    def _velocity(self, velocity_mm_s: float | None) -> float:
        if velocity_mm_s is not None:
            return velocity_mm_s
        if not isinstance(self.file, AxisConfig):
            raise InputError("has no [measurement] velocity_mm_s, expected one with the call", path=self.file.path)
        return self.file.measurement.velocity_mm_s

    def disable(self) -> None:
        """Switch off the power of the drive."""
        connection = self._require()
        connection.drive.disable()
        self._homed, self._last = False, None
        if connection.session is not None:
            connection.session.command_state.forget()

    def stream(self, positions_mm: Iterable[float], period_s: float, *, following_error_mm: float = 1.0) -> Rows:
        """Follow set-points, one each period, from where the axis stands; corrected after `home(corrected=True)`.

        Returns time_s, target_mm and motor_mm of each period. Raises StateError before `home()`, and LimitError for a target outside
        the travel. Any error stops the axis.
        """
        from drivers.set_points import SetPointSettings, SetPointStream  # noqa: PLC0415

        session = self._session()
        if not self._homed:
            raise StateError(f"axis {self.name}: expected home() before stream()")
        targets: list[float] = []
        found: list[tuple[int, float]] = []

        def path() -> Iterator[tuple[float, float]]:
            before_mm = session.command_state.known_history.position_mm
            for target_mm in positions_mm:
                self._check_planned(target_mm, abs(target_mm - before_mm) / period_s)
                targets.append(target_mm)
                yield target_mm, (target_mm - before_mm) / period_s
                before_mm = target_mm

        def at(stream: SetPointStream) -> None:
            found.append((stream.found[0], stream.found[1]))

        session.stream_along(path(), SetPointSettings(period_s, following_error_mm), at)
        self._last = None
        times = [(time_ns - self._opened_ns) / NS_PER_S for time_ns, _ in found]
        return Rows.from_lists(time_s=times, target_mm=targets[: len(found)], motor_mm=[place for _, place in found])

    # -- jobs ----------------------------------------------------------------------------------------------------------
    def doctor(self, *, move: bool = True, trust_file: bool = False, home: bool = False) -> DoctorResult:
        """Check the axis, as `hil doctor`."""
        from hil.doctor.procedure import doctor  # noqa: PLC0415  (drivers load slowly)

        self._measured_file()
        with self._job():
            checks = doctor(self._session(), move=move, trust_file=trust_file, home=home)
        return DoctorResult(self.file, None, tuple(checks))

    def calibrate(
        self,
        *,
        resume: bool = False,
        new_zero: bool = False,
        instrument_zeroed: bool = False,
        **how: Unpack[Measuring],
    ) -> CalibrationResult:
        """Measure, compute tables and store them, as `hil calibrate --without-proof`; `verify()` proves them."""
        from hil.calibration.job import CALIBRATE, calibration_job  # noqa: PLC0415  (loads slowly)

        axis, zero = self._measured_file(measurement=how), _stated(new_zero, instrument_zeroed)
        result = self._carry_out(
            calibration_job(axis, resume=resume, zero=zero), self._passwords.store(axis, writing=True), axis
        )
        return CalibrationResult(axis, _folder(axis, CALIBRATE), result)

    def verify(
        self,
        *,
        corrected: bool = True,
        seed: int = 1,
        resume: bool = False,
        instrument_zeroed: bool = False,
        **how: Unpack[Measuring],
    ) -> VerificationResult:
        """Measure at other targets with the stored correction in force, as `hil verify`; corrected: False measures without
        correction."""
        from hil.calibration.job import UNCORRECTED, VERIFY, Across, verification_job  # noqa: PLC0415  (loads slowly)

        axis, zero = self._measured_file(measurement=how), _stated(False, instrument_zeroed)
        store = self._passwords.store(axis, writing=False) if corrected else None
        across = None
        if store is not None and axis.straightness is not None and store.load().moves_axis:
            across = Across.of(axis, self._store_of_other(axis))
        job = verification_job(axis, corrected=corrected, seed=seed, resume=resume, zero=zero, across=across)
        verified = self._carry_out(job, store, axis)
        tables = None if verified.compensation is None else verified.compensation.tables
        folder = _folder(axis, VERIFY if corrected else UNCORRECTED)
        return VerificationResult(axis, folder, tables, verified.result, self._passwords)

    def _store_of_other(self, axis: AxisConfig) -> SealedStore | None:
        other = load_drive_axis(axis.across().axis_file)
        return self._passwords.store(other, writing=False) if isinstance(other, AxisConfig) else None

    def backlash(self, *, write: bool = False, **how: Unpack[Winding]) -> BacklashResult:
        """Lost motion by the servo's torque, as `hil backlash`. write: whether the mean is written into the drive's parameter, or into
        the tables if the drive has none."""
        from hil.backlash.job import backlash_config, measuring_job  # noqa: PLC0415  (loads slowly)

        axis = load_drive_axis(self.file.path, {"backlash": how} if how else {})
        settings = backlash_config(axis)
        into_tables = write and settings.parameter is None and isinstance(axis, AxisConfig)
        store = self._passwords.store(axis, writing=True) if into_tables and isinstance(axis, AxisConfig) else None
        found: BacklashResult = self._carry_out(measuring_job(axis, settings, write=write), store)
        return found

    def lost_motion(
        self, *, store: bool = True, seed: int = 1, resume: bool = False, **how: Unpack[Reversing]
    ) -> ReversalResult:
        """Lost motion after a reversal by the instrument, as `hil lost-motion`. store: whether a proven correction is put into force.

        Raises NoLostMotionError if there is nothing to correct.
        """
        from hil.correction.store import bound_tables  # noqa: PLC0415  (cryptography loads slowly)
        from hil.lost_motion.job import lost_motion_config, measuring_job, store_job  # noqa: PLC0415

        axis = self._measured_file(lost_motion=how)
        there = bound_tables(axis) is not None
        opened = self._passwords.store(axis, writing=store) if store or there else None
        measured = self._carry_out(measuring_job(axis, lost_motion_config(axis), seed=seed, resume=resume), opened)
        stored = store and measured.result.good
        if stored:
            self._carry_out(store_job(axis, measured), opened)
        return ReversalResult(axis, measured.kept, measured, stored)

    def close_loop(
        self,
        *,
        runs: int = 8,
        rows: int = 42,
        warm_up_s: float = 240.0,
        feeds_mm_s: Sequence[float] = (),
        resume: bool = False,
    ) -> LoopResult:
        """Calibrate, diagnose, add what is found, measure again, as `hil close-loop`. feeds_mm_s: of further passes in motion."""
        from hil.calibration.explore import Exploration  # noqa: PLC0415  (the diagnosis loads slowly)
        from hil.diagnosis.loop.job import loop_job  # noqa: PLC0415
        from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP, passes_at  # noqa: PLC0415
        from hil.diagnosis.loop.procedure import Turning  # noqa: PLC0415

        axis = self._measured_file()
        in_motion = passes_at(axis, tuple(feeds_mm_s)) if feeds_mm_s else None
        turning = Turning(Exploration(runs, rows, warm_up_s), in_motion=in_motion)
        looped = self._carry_out(loop_job(axis, turning, resume=resume), self._passwords.store(axis, writing=True))
        return LoopResult(axis, _folder(axis, CLOSE_LOOP), looped.loop, looped.stages, looped.good)

    def _measured_file(self, **given: Any) -> AxisConfig:
        """The axis file with these values in its sections, checked as its own. Raises CapabilityError without an instrument."""
        used = {section: values for section, values in given.items() if values}
        axis = load_drive_axis(self.file.path, used) if used else self.file
        if not isinstance(axis, AxisConfig):
            raise CapabilityError(f"axis {self.name} has no instrument: its file ends with the drive")
        return axis

    def run(
        self,
        procedure: Procedure,
        *,
        corrected: bool = False,
        resume: bool = False,
        new_zero: bool = False,
        instrument_zeroed: bool = False,
    ) -> ProcedureResult:
        """Carry out your own procedure, as `hil run`; corrected: whether the stored correction is in force."""
        from hil.script.procedure import values_of  # noqa: PLC0415  (drivers load slowly)
        from hil.script.procedure_job import procedure_job  # noqa: PLC0415  (as above)

        axis, zero = self._measured_file(), _stated(new_zero, instrument_zeroed)
        job = procedure_job(axis, procedure, corrected=corrected, resume=resume, zero=zero)
        carried = self._carry_out(job, self._passwords.store(axis, writing=False) if corrected else None)
        name = type(procedure).__name__
        return ProcedureResult(axis, carried.campaign, name, values_of(procedure), carried.records)

    def _carry_out(self, job: Job, store: SealedStore | None = None, axis: AxisConfig | None = None) -> Any:
        """Run a job as the screen's desk does; its result. axis: with the measurement that takes the place of the session's."""
        on = self._require()
        if job.connects:
            with self._disconnected():
                return job.work(self._place(None, None, store))
        with self._job():
            session = on.session
            usual = None if session is None else session.how
            if session is not None and axis is not None:
                session.how = axis.measurement
            try:
                return job.work(self._place(on.drive, session, store))
            finally:
                if session is not None and usual is not None:
                    session.how = usual
                notes = [] if session is None else session.untold_notes()
                for note in notes:
                    self._tell(note)

    @contextmanager
    def _job(self) -> Iterator[None]:
        if self._moves is not None:
            raise StateError(f"axis {self.name} is carrying out a procedure: no other job can run meanwhile")
        one_job: AbstractContextManager[object] = self._require().one_job()
        self._homed, self._last = False, None
        with one_job:
            yield

    def _place(self, drive: ServoDrive | None, session: AxisSession | None, store: SealedStore | None) -> Workplace:
        from hil.desk.job import Workplace  # noqa: PLC0415  (drivers load slowly)

        unseen = lambda _name, _drive, _session: None  # noqa: E731
        return Workplace(self.file, drive, session, self._listener, self._tell, store, RealTime(), unseen)

    def _tell(self, note: str) -> None:
        self._listener(Event("note", note, warning=True))


def _folder(axis: AxisConfig, kind: str) -> Path | None:
    """The folder of the last campaign of a kind."""
    last = Campaign.latest(axis.store.directory, kind)
    return None if last is None else last.directory


def _stated(new_zero: bool, instrument_zeroed: bool) -> ZeroStatement:
    from hil.desk.zero_statement import ZeroStatement  # noqa: PLC0415  (drivers load slowly)

    return ZeroStatement(new_zero, instrument_zeroed)
