"""One axis and the one thread that owns it.

Nobody else touches drive, instrument and clock: with no job the thread looks at them 20 times a second, with a job it runs it.
Everybody else reads what it publishes, and asks: for a job, with the token of control, and for a stop, without.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import replace

from drivers.drive import DriveSample, DriveState, ServoDrive
from drivers.errors import BridgeError, LinkLostError, LocalError, StateError
from drivers.instrument import Reading
from hil.axis import DriveAxis
from hil.desk.connection import Connect, Connection, to_axis
from hil.desk.control import Control
from hil.desk.live import RATE_HZ, Board, Live, TracePoint, of_sample
from hil.desk.progress import Graph, JobLog, Phase, Progress
from hil.desk.roles import Rights
from hil.desk.stop import Pacing, Stop, StoppedByOperator
from hil.jobs.job import Job, Workplace
from hil.jobs.plan import Plan
from hil.procedures.session import AxisSession

RETRY_S = 2.0
"""Between two attempts to connect an axis that does not answer."""
CLOSING_S = 10.0


class BusyError(LocalError):
    """A job is running already."""


class Desk:
    """Use as a context manager: inside, the axis's thread runs.

    pace: simulated seconds per real one during a job on the bench, 0 for as fast as it goes; a real axis knows no such thing.
    """

    def __init__(self, axis: DriveAxis, *, pace: float = 1.0, connect: Connect | None = None) -> None:
        self.axis = axis
        self.control = Control()
        self.rights = Rights(axis)
        self.control.on_change = self.rights.forget
        self._connect = connect or to_axis(axis)
        self._pace = pace
        self._stop = Stop()
        self._pacing = Pacing(self._stop)
        self._board = Board()
        self._lock = threading.Lock()
        self._asked: tuple[Job, JobLog] | None = None
        self._log: JobLog | None = None
        self._last: dict[str, JobLog] = {}
        self._jobs = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"axis {axis.name}", daemon=True)

    # -- for everybody -------------------------------------------------------------------------------------------------
    @property
    def name(self) -> str:
        return self.axis.name

    @property
    def live(self) -> Live:
        """The axis as it was last seen."""
        return self._board.live

    def trace(self, since: int = 0) -> tuple[TracePoint, ...]:
        """The last minute of its signals, after the point of this number."""
        return self._board.trace(since)

    def job(self) -> Progress | None:
        """The job that is running, or ran last."""
        log = self._log
        return None if log is None else log.progress(stopping=self._stop.pressed)

    def last(self, kind: str) -> Progress | None:
        """The last job of this kind, running or over."""
        log = self._last.get(kind)
        return None if log is None else log.progress(stopping=self._stop.pressed)

    def graph(self, kind: str, since: int = 0) -> Graph:
        """The curves of the last job of this kind, after the first `since` points."""
        log = self._last.get(kind)
        return Graph(0, {}) if log is None else log.graph(since)

    def stop(self) -> None:
        """Quick stop, now, whoever asks. A running job ends; what it measured is kept."""
        self._stop.press()

    # -- for whoever holds control -------------------------------------------------------------------------------------
    def run(self, token: str | None, job: Job) -> None:
        """Start a job. Raises NotInControlError, LockedError, BusyError, StateError while the axis is not connected."""
        self.control.require(token)
        self.rights.require(locked=job.plan.locked)
        with self._lock:
            if self._log is not None and self._log.phase is Phase.RUNNING:
                raise BusyError(f"axis {self.name} is busy: {self._log.kind}")
            if not self.live.connected:
                raise StateError(f"axis {self.name} is not connected: {self.live.trouble or 'connecting'}")
            self._jobs += 1
            log = JobLog(self._jobs, job.kind, job.plan)
            self._log = self._last[job.kind] = log
            self._asked = (job, log)

    def power_off(self, token: str | None) -> None:
        """Take the power off an axis that was left enabled."""
        self.run(token, Job("power off", self._bare_plan(), lambda place: place.drive.disable()))

    def reset_fault(self, token: str | None) -> None:
        """Acknowledge a fault; the axis stays without power."""
        self.run(token, Job("reset fault", self._bare_plan(), lambda place: place.drive.reset_fault()))

    def become_builder(self, token: str | None, key_password: str, reading_password: str = "") -> None:
        """Take the builder's role, until control changes hands. Takes about a second; raises what opening the key raises."""
        self.control.require(token)
        self.rights.become_builder(key_password, reading_password)

    def read_tables(self, token: str | None, password: str) -> None:
        """Give the tables' reading password, until control changes hands. Raises what opening them raises."""
        self.control.require(token)
        self.rights.read_tables(password)

    def become_operator(self, token: str | None) -> None:
        """Give up the builder's role."""
        self.control.require(token)
        self.rights.forget()

    def _bare_plan(self) -> Plan:
        return Plan(self.axis.name, self.axis.drive.backend)

    # -- coming and going ----------------------------------------------------------------------------------------------
    def __enter__(self) -> Desk:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop whatever runs, let go of the axis, end the thread. Raises StateError where it does not end in time."""
        self._closing.set()
        self._stop.press()
        self._thread.join(CLOSING_S)
        if self._thread.is_alive():
            raise StateError(f"axis {self.name} was told to stop, and its thread is still busy after {CLOSING_S:g} s")

    # -- the axis's thread ---------------------------------------------------------------------------------------------
    def _work(self) -> None:
        while not self._closing.is_set():
            try:
                with self._connect(self._pacing) as connection:
                    self._watch(connection.drive, connection.session)
                    self._serve(connection)
            except StoppedByOperator:
                self._stop.rearm()  # pressed while it was connecting: nothing was enabled
            except (BridgeError, OSError) as error:
                self._board.publish(Live(trouble=one_line(error)))
                self._closing.wait(RETRY_S)
        self._board.publish(Live(trouble="closed"))

    def _serve(self, connection: Connection) -> None:
        while not self._closing.is_set():
            try:
                asked = self._next()
                if asked is not None:
                    self._run(*asked, connection)
                    continue
                self._look(connection)
                connection.drive.clock.sleep_s(1.0 / RATE_HZ)
            except StoppedByOperator:
                self._hold(connection.drive)

    def _next(self) -> tuple[Job, JobLog] | None:
        with self._lock:
            asked, self._asked = self._asked, None
            return asked

    def _run(self, job: Job, log: JobLog, connection: Connection) -> None:
        """One job, however it ends; then the axis is as it was found."""
        place = Workplace(self.axis, connection.drive, connection.session, log.hear, log.tell, self.rights.store)
        self._pacing.set_factor(self._pace)
        try:
            with connection.one_job():
                result = job.work(place)
            log.end(Phase.DONE, result)
        except StoppedByOperator:
            log.end(Phase.STOPPED)
        except (BridgeError, OSError) as error:
            log.end(Phase.FAILED, error=one_line(error))
        except Exception as error:  # noqa: BLE001  a mistake of ours in a job must not leave the axis without its thread
            log.end(Phase.FAILED, error=one_line(error) or type(error).__name__)
        finally:
            self._pacing.set_factor(1.0)
            self._stop.rearm()

    def _hold(self, drive: ServoDrive) -> None:
        """The stop was pressed with no job running."""
        with suppress(BridgeError):  # the next look tells what is wrong
            if drive.sample().state is DriveState.ENABLED:
                drive.quick_stop()
        self._stop.rearm()

    # -- looking -------------------------------------------------------------------------------------------------------
    def _watch(self, drive: ServoDrive, session: AxisSession | None) -> None:
        """From now on every look of any procedure is shown."""
        shown = replace(self._board.live, instrument="" if session is None else session.instrument.name)
        self._board.publish(shown)

        def looked(sample: DriveSample) -> None:
            live = of_sample(self._board.live, sample, drive.destination_load_mm)
            if session is not None:
                live = self._with_session(live, session)
            self._board.publish(live)

        drive.on_look = looked
        if session is not None:
            session.on_readings = lambda readings: self._board.heard(readings, lambda one: _in_load_frame(session, one))

    def _with_session(self, live: Live, session: AxisSession) -> Live:
        history, compensation = session.history, session.compensation
        return replace(
            live,
            instrument_age_s=self._board.instrument_age_s(session.clock.now_ns()),
            correction_um=None if history is None else (session.commanded_mm - history.position_mm) * 1000.0,
            in_force="" if compensation is None else compensation.tables.digest()[:16],
            environment=session.instrument.environment(),
        )

    def _look(self, connection: Connection) -> None:
        """With no job: look at everything, and let nothing that is seen stop the looking; only a drive that is gone does."""
        connection.drive.looked_at(connection.drive.sample())
        session = connection.session
        if session is not None and session.on_readings is not None:
            with suppress(LinkLostError):  # its readings get old, and are shown so
                session.on_readings(session.instrument.poll())


def _in_load_frame(session: AxisSession, reading: Reading) -> float | None:
    try:
        return session.load_position_mm(reading)
    except StateError:
        return None


def one_line(error: BaseException) -> str:
    """As the command line says it."""
    return " ".join(str(error).split())
