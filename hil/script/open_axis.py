"""An open axis with its jobs, for scripts: they are those of the verbs and the screen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack

from drivers.drive import ServoDrive
from drivers.errors import CapabilityError
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.machine.events import Event, Listener, silent
from hil.records.journal import Campaign
from hil.script.axis import Axis, stated
from hil.script.given import Measuring, Passwords, RealTime, Reversing, Winding
from hil.script.results import CalibrationResult, DoctorResult, LoopResult, ProcedureResult, VerificationResult

if TYPE_CHECKING:  # drivers and fits load slowly
    import canopen

    from hil.backlash.measured import BacklashResult
    from hil.correction.store import SealedStore
    from hil.desk.axis_thread import DeskConnection
    from hil.desk.job import Job, Workplace
    from hil.lost_motion.measured import ReversalResult
    from hil.machine.bench_wiring import RunningBench
    from hil.machine.session import AxisSession
    from hil.script.own_table import OwnTable
    from hil.script.parameters import Parameters
    from hil.script.procedure import Procedure
    from sim_backends.bench import Bench


def open_axis(
    path: str | Path,
    *,
    password: str | None = None,
    key_password: str | None = None,
    on_event: Listener = silent,
    network: canopen.Network | None = None,
) -> OpenAxis:
    """The axis of an axis file, for a `with` block, which connects it.

    password, key_password: of the sealed tables and of the builder's key; None takes them from the environment, the axis file or the
    keyboard. on_event: called with progress and warnings. network: your own canopen.Network in place of the axis file's bus. Raises
    InputError.
    """
    return OpenAxis(load_drive_axis(path), Passwords(password, key_password), on_event, network=network)


class OpenAxis(Axis):
    """A context manager, made by `hil.open`. After a job, call `home()` again before moving on."""

    def __init__(
        self,
        file: DriveAxis,
        passwords: Passwords,
        on_event: Listener,
        connection: DeskConnection | None = None,
        network: canopen.Network | None = None,
    ) -> None:
        super().__init__(file, passwords, on_event, connection)
        self._network = network
        self._shared = connection is not None
        self._stack = ExitStack()
        self._machine = ExitStack()  # the simulated machine
        self._running: RunningBench | None = None

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
    def bench(self) -> Bench:
        """The simulated machine of an axis file with backend "bench", new at each `hil.open`. Raises CapabilityError on hardware."""
        self._require()
        if self._running is None:
            raise CapabilityError(f"axis {self.name} is no simulated machine in this process")
        return self._running.benches[0]

    # -- coming and going ----------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        with ExitStack() as stack:
            if self.file.drive.backend == "bench":
                from hil.machine.bench_wiring import running_bench  # noqa: PLC0415  (the simulation loads slowly)

                self._running = stack.enter_context(running_bench([self.file]))
            self._connect()
            self._machine = stack.pop_all()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._connection = None
        with self._machine:
            self._stack.__exit__(exc_type, exc, traceback)
        self._running = None

    def forget(self) -> None:
        """The connection is closed by its owner; forget it."""
        self._connection = None

    def _connect(self) -> None:
        from hil.desk.axis_thread import DeskConnection  # noqa: PLC0415  (drivers load slowly)
        from hil.machine.supervisor import Supervisor  # noqa: PLC0415
        from hil.machine.watched_axis import WatchedAxis  # noqa: PLC0415
        from hil.machine.who_is_there import naming_who_is_there  # noqa: PLC0415
        from hil.machine.wiring import connected, connected_drive  # noqa: PLC0415

        with ExitStack() as stack:
            with naming_who_is_there(self.file):
                if isinstance(self.file, AxisConfig):
                    machine = stack.enter_context(connected(self.file, self._running, network=self._network))
                    self._connection = DeskConnection(machine.session.drive, machine.session)
                else:
                    drive = stack.enter_context(connected_drive(self.file, self._running, network=self._network))
                    self._connection = DeskConnection(drive, None)
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

    # -- jobs ----------------------------------------------------------------------------------------------------------
    def doctor(self, *, move: bool = True, trust_file: bool = False, home: bool = False) -> DoctorResult:
        """Check the axis, as `hil doctor`."""
        from hil.doctor.procedure import doctor  # noqa: PLC0415  (drivers load slowly)

        self._measured_file()
        with self._job():
            checks = doctor(self._session(), move=move, trust_file=trust_file, home=home)
        return DoctorResult(self.file, None, tuple(checks))

    def calibrate(
        self, *, resume: bool = False, new_zero: bool = False, instrument_zeroed: bool = False, **how: Unpack[Measuring]
    ) -> CalibrationResult:
        """Measure, compute tables and store them, as `hil calibrate --without-proof`; `verify()` proves them."""
        from hil.calibration.job import CALIBRATE, calibration_job  # noqa: PLC0415  (loads slowly)

        axis, zero = self._measured_file(measurement=how), stated(new_zero, instrument_zeroed)
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

        axis, zero = self._measured_file(measurement=how), stated(False, instrument_zeroed)
        store = self._passwords.store(axis, writing=False) if corrected else None
        across = None
        if store is not None and axis.straightness is not None and store.load().moves_axis:
            other = load_drive_axis(axis.across().axis_file)
            across = Across(
                other, self._passwords.store(other, writing=False) if isinstance(other, AxisConfig) else None
            )
        job = verification_job(axis, corrected=corrected, seed=seed, resume=resume, zero=zero, across=across)
        verified = self._carry_out(job, store, axis)
        folder = _folder(axis, VERIFY if corrected else UNCORRECTED)
        return VerificationResult(axis, folder, verified, self._passwords)

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
        job = measuring_job(axis, lost_motion_config(axis), seed=seed, resume=resume)
        measured: ReversalResult = self._carry_out(job, opened)
        if store and measured.raw.good:
            measured = self._carry_out(store_job(axis, measured), opened)
        return measured

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

        axis, zero = self._measured_file(), stated(new_zero, instrument_zeroed)
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
        one_job: AbstractContextManager[object] = self._require().one_job()
        self._homed, self._last = False, None
        with one_job:
            yield

    def _place(self, drive: ServoDrive | None, session: AxisSession | None, store: SealedStore | None) -> Workplace:
        from hil.desk.job import Workplace  # noqa: PLC0415  (drivers load slowly)

        unseen = lambda _name, _drive, _session: None  # noqa: E731
        return Workplace(
            self.file, drive, session, self._listener, self._tell, store, RealTime(), unseen, bench=self._running
        )

    def _tell(self, note: str) -> None:
        self._listener(Event("note", note, warning=True))


def _folder(axis: AxisConfig, kind: str) -> Path | None:
    """The folder of the last campaign of a kind."""
    last = Campaign.latest(axis.store.directory, kind)
    return None if last is None else last.directory


@contextmanager
def open_axes(
    *paths: str | Path, password: str | None = None, key_password: str | None = None, on_event: Listener = silent
) -> Iterator[tuple[OpenAxis, ...]]:
    """The axes of several axis files, each with an instrument, connected together for a `with` block; arguments as for `hil.open`.

    `parameters` and straightness need an axis alone and raise CapabilityError.
    """
    files = [load_drive_axis(path) for path in paths]
    measured = [one for one in files if isinstance(one, AxisConfig)]
    if len(measured) < len(files):
        name = next(one.name for one in files if not isinstance(one, AxisConfig))
        raise CapabilityError(f"axis {name} has no instrument: several axes are opened with one each")
    from hil.desk.axis_thread import DeskConnection  # noqa: PLC0415  (drivers load slowly)
    from hil.machine.axes_wiring import connected_axes  # noqa: PLC0415

    with connected_axes(measured) as machines:
        passwords = Passwords(password, key_password)
        connections = [DeskConnection(one.session.drive, one.session) for one in machines]
        axes = [OpenAxis(file, passwords, on_event, on) for file, on in zip(measured, connections, strict=True)]
        try:
            yield tuple(axes)
        finally:
            for axis in axes:
                axis.forget()
