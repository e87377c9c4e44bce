"""The thread that owns an axis: it connects the axis, samples it 20 times a second, and runs its jobs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import copy_context
from dataclasses import dataclass, replace
from functools import partial

from drivers.cia402.words import window
from drivers.clock import NS_PER_S, Waiting, WallClock
from drivers.drive import DriveSample, DriveState, ServoDrive
from drivers.errors import BridgeError, LinkLostError, StateError
from drivers.instrument import Reading
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.correction.store import SealedStore
from hil.desk.asking import Asking
from hil.desk.error_log import ERRORS, ErrorLog
from hil.desk.job import Job, Question, Workplace
from hil.desk.live import RATE_HZ, Board, Live, SignalLimits, of_sample
from hil.desk.progress import JobLog, Phase
from hil.desk.stop import MeasuredStop, Pacing, Stop, StoppedByOperator
from hil.machine.computing import watched
from hil.machine.session import AxisSession
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected, connected_drive
from hil.records.rows import UM_PER_MM


@dataclass(frozen=True)
class DeskConnection:
    """A connected axis; session: None for an axis without an instrument."""

    drive: ServoDrive
    session: AxisSession | None

    def one_job(self) -> AbstractContextManager[object]:
        """Around a job: an error stops the axis, and at the end it is disabled unless it was enabled before."""
        if self.session is None:
            return Supervisor([WatchedAxis(self.drive)])
        return self.session.one_job()


Connect = Callable[[Waiting], AbstractContextManager[DeskConnection]]


def to_axis(axis: DriveAxis) -> Connect:
    """Connects the axis of an axis file, with its instrument where it has one."""

    @contextmanager
    def connect(waiting: Waiting) -> Iterator[DeskConnection]:
        if isinstance(axis, AxisConfig):
            with connected(axis, waiting=waiting) as machine:
                yield DeskConnection(machine.session.drive, machine.session)
        else:
            with connected_drive(axis, waiting=waiting) as drive:
                yield DeskConnection(drive, None)

    return connect


def limits_of(drive: ServoDrive) -> SignalLimits:
    """What an open drive says that it allows, by its parameters `max_torque` (6072h) and `following_error_window` (6065h)."""

    def read(name: str, units: Mapping[str, float]) -> float | None:
        try:
            per = units.get(drive.parameters.describe(name).unit)
            value = drive.parameters.read(name)
        except LinkLostError:
            raise
        except BridgeError:  # it has no parameters, not this one, or refuses it
            return None
        allowed = window(value) if isinstance(value, int | float) else None
        return per * allowed if per is not None and allowed else None

    um_per_count = UM_PER_MM / abs(drive.scaling.counts_per_load_mm)
    return SignalLimits(
        read("max_torque", {"0.1 %": 0.1, "%": 1.0, "percent": 1.0}),
        read("following_error_window", {"counts": um_per_count}),
    )


RETRY_S = 2.0
"""Interval between two attempts to connect an axis, s."""
CLOSING_S = 10.0
"""Time limit for the thread to end, and to release its axis, s."""
LOOK_NS = round(NS_PER_S / RATE_HZ)


@dataclass(frozen=True)
class JobRequest:
    """A job to be run. store: of the person who requested it, None if not opened; lent: threads whose axes the job connects itself."""

    job: Job
    log: JobLog
    store: SealedStore | None
    lent: tuple[AxisThread, ...] = ()


class AxisThread:
    """The thread of one axis. Methods below "in the thread" run in it, the others in any thread. pace: of jobs, as for `Pacing`."""

    def __init__(self, axis: DriveAxis, connect: Connect, pace: float) -> None:
        self.axis = axis
        self.stop = Stop()
        self.standstill = MeasuredStop()
        self.board = Board()
        self.asking = Asking()
        self.errors = ErrorLog(axis.store.directory / ERRORS)
        self.on_lost: Callable[[str], None] = lambda _said: None  # called in the thread when a connected axis is lost
        self._connect = connect
        self._pace = pace
        self._pacing = Pacing(self.stop)
        self._limits = SignalLimits()
        self._lock = threading.Lock()
        self._asked: JobRequest | None = None
        self._borrowed: tuple[AxisThread, ...] = ()  # of the job that runs
        self._lent = threading.Event()
        self._let_go = threading.Event()
        self._closing = threading.Event()
        work = copy_context()  # with the drives that a signal stops
        self._thread = threading.Thread(target=work.run, args=(self._work,), name=f"axis {axis.name}", daemon=True)

    # -- for any thread ------------------------------------------------------------------------------------------------
    def start(self) -> None:
        self._thread.start()

    def press_stop(self) -> None:
        """Stop at the thread's next wait, and measure how its axis, and those lent to its job, come to rest."""
        for thread in (self, *self._borrowed):
            thread.standstill.pressed(self._pacing.now_ns())
        self.stop.press()

    def close(self) -> None:
        """Stop the running job, disconnect the axis, end the thread. Raises StateError when it does not end in `CLOSING_S`."""
        self._closing.set()
        self.stop.press()
        self._thread.join(CLOSING_S)
        if self._thread.is_alive():
            raise StateError(f"axis {self.axis.name}: its thread is still busy {CLOSING_S:g} s after its stop")

    def ask(self, asked: JobRequest) -> None:
        """Run this job next. The desk requests one at a time. A stop before its begin cancels it."""
        with self._lock:
            self._asked = asked

    def lend(self) -> None:
        """Disconnect the axis, for a job of another thread."""
        self._lent.set()
        self._let_go.clear()

    def take_back(self) -> None:
        """Connect the axis again, after that job, whose last sample no longer counts."""
        self.board.forget()
        self._lent.clear()

    def wait_let_go(self) -> None:
        """Wait until the axis is disconnected. Raises StateError after `CLOSING_S`."""
        if not self._let_go.wait(CLOSING_S):
            raise StateError(f"axis {self.axis.name} was not disconnected within {CLOSING_S:g} s")

    # -- in the thread: connecting -------------------------------------------------------------------------------------
    def _work(self) -> None:
        while not self._closing.is_set():
            if self._lent.is_set():
                self._stay_away()
                continue
            try:
                with self._connect(self._pacing) as connection:
                    self._limits = limits_of(connection.drive)
                    self._watch(connection.drive, connection.session)
                    self._serve(connection)
                self._run_connecting()
            except StoppedByOperator:  # pressed while connecting or disconnecting: nothing is enabled
                self._cancel(Phase.STOPPED)
                self.stop.rearm()
            except Exception as error:  # noqa: BLE001  the axis is connected again, and the error is shown
                self._lose(error)
        self._cancel(Phase.STOPPED)
        self.board.forget("closed")

    def _stay_away(self) -> None:
        """Wait while another thread has the axis."""
        self.board.forget()
        while self._lent.is_set() and not self._closing.is_set():
            self._let_go.set()  # repeatedly: the next borrower may wait before the end of the last loan was seen here
            self._closing.wait(1.0 / RATE_HZ)

    def _lose(self, error: Exception) -> None:
        """The connection is lost: show the error, cancel a requested job, wait before the next attempt."""
        said = self.errors.line_of(error)
        if self.board.live.connected:
            self.on_lost(said)
        self.board.forget(said)
        self._cancel(Phase.FAILED, said)
        self.stop.rearm()  # the error may have come while a stop was carried out
        self._closing.wait(RETRY_S)

    def _take(self) -> JobRequest | None:
        with self._lock:
            asked, self._asked = self._asked, None
            return asked

    def _cancel(self, phase: Phase, error: str = "") -> None:
        """Cancel a requested job that has not begun."""
        asked = self._take()
        if asked is not None:
            for other in asked.lent:
                other.take_back()
            asked.log.end(phase, error=error)

    def _serve(self, connection: DeskConnection) -> None:
        """Sample the axis and run jobs until it is to be disconnected: for a job that connects by itself, another thread, or the
        end."""
        due_ns = connection.drive.clock.now_ns()
        while not (self._closing.is_set() or self._lent.is_set()):
            try:
                asked = self._asked
                if asked is not None and asked.job.connects:
                    return
                if asked is not None:
                    self._run(connection)
                    continue
                clock = connection.drive.clock
                due_ns = max(due_ns + LOOK_NS, clock.now_ns())
                self._look(connection)
                clock.sleep_until_ns(due_ns)
            except StoppedByOperator:
                self._hold(connection.drive)

    # -- in the thread: jobs -------------------------------------------------------------------------------------------
    def _run(self, connection: DeskConnection) -> None:
        """Run the requested job on the connected axis."""
        self.stop.check()
        asked = self._take()
        if asked is None:
            return

        def work() -> object:
            known = len(connection.drive.notes)
            try:
                with connection.one_job():
                    return asked.job.work(self._place(asked, connection.drive, connection.session))
            finally:
                session, drive = connection.session, connection.drive
                for note in drive.notes[known:] if session is None else session.untold_notes():
                    asked.log.tell(note)

        self._carried_out(work, asked)()

    def _run_connecting(self) -> None:
        """Run the requested job if it connects by itself. This axis is disconnected; lent axes are waited for."""
        self.stop.check()
        asked = self._take() if self._asked is not None and self._asked.job.connects else None
        if asked is None:
            return

        def work() -> object:
            for other in asked.lent:
                other.wait_let_go()
            return asked.job.work(self._place(asked, None, None))

        self._borrowed = asked.lent
        self.board.forget()  # the job may show the axis by `Workplace.watch`
        try:
            record_end = self._carried_out(work, asked)
        finally:
            self._borrowed = ()
            self.board.forget()
            for other in asked.lent:
                other.take_back()
        record_end()  # last: whoever sees the end may lend the axes again

    def _place(self, asked: JobRequest, drive: ServoDrive | None, session: AxisSession | None) -> Workplace:
        threads = {one.axis.name: one for one in (self, *asked.lent)}

        def watch(name: str, drive: ServoDrive, session: AxisSession | None) -> None:
            if name in threads:
                threads[name]._watch(drive, session)

        def ask(question: Question) -> bool | None:
            clock = WallClock(self._pacing) if drive is None else drive.clock
            return self.asking.ask(question, clock, clock.sleep_s if session is None else session.watch)

        heard = asked.log
        return Workplace(
            self.axis, drive, session, heard.hear, heard.tell, asked.store, self._pacing, watch, ask, watched
        )

    def _carried_out(self, work: Callable[[], object], asked: JobRequest) -> Callable[[], None]:
        """Run a job's work; returns what records how it ended. `one_job` has put the axis back before."""
        log = asked.log
        self._pacing.set_factor(self._pace)
        for thread in (self, *self._borrowed):
            thread.standstill.forget()
        try:
            result = work()
            return partial(log.end, Phase.DONE if asked.job.reached(result) else Phase.WITHOUT_RESULT, result)
        except StoppedByOperator:
            return partial(log.end, Phase.STOPPED)
        except Exception as error:  # noqa: BLE001  a program error in a job must not end the thread
            return partial(log.end, Phase.FAILED, error=self.errors.line_of(error), raised=error)
        finally:
            self._pacing.set_factor(1.0)
            self.stop.rearm()

    def _hold(self, drive: ServoDrive) -> None:
        """Carry out a stop while no job runs; a requested job is cancelled."""
        try:
            self._cancel(Phase.STOPPED)
            with suppress(BridgeError):  # the next sample shows the error
                if drive.sample().state is DriveState.ENABLED:
                    drive.quick_stop()
        finally:
            self.stop.rearm()

    # -- in the thread: looking ----------------------------------------------------------------------------------------
    def _watch(self, drive: ServoDrive, session: AxisSession | None) -> None:
        """From now on show every sample of the drive and every reading."""

        def looked(sample: DriveSample) -> None:
            self.standstill.look(sample)
            live = replace(of_sample(self.board.live, sample, drive.destination_load_mm), limits=self._limits)
            self.board.publish(live if session is None else self._with_session(live, session))

        drive.on_look = looked
        if session is not None:
            session.axis.on_readings = lambda readings: self.board.heard(
                readings, lambda one: _in_load_frame(session, one)
            )

    def _with_session(self, live: Live, session: AxisSession) -> Live:
        history, compensation = session.history, session.compensation
        return replace(
            live,
            instrument=session.instrument.name,
            instrument_age_s=self.board.instrument_age_s(session.clock.now_ns()),
            correction_um=None if history is None else (session.commanded_mm - history.position_mm) * 1000.0,
            in_force="" if compensation is None else compensation.tables.digest()[:16],
            environment=session.instrument.environment(),
        )

    def _look(self, connection: DeskConnection) -> None:
        """Sample drive and instrument while no job runs. Only a lost drive raises; faults and old readings are shown."""
        connection.drive.looked_at(connection.drive.sample())
        session = connection.session
        if session is not None and session.axis.on_readings is not None:
            with suppress(LinkLostError):  # the age of the last reading is shown
                session.axis.on_readings(session.instrument.poll())


def _in_load_frame(session: AxisSession, reading: Reading) -> float | None:
    try:
        return session.load_position_mm(reading)
    except StateError:
        return None
