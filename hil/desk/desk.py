"""The desk of one axis: its state and stop for everyone, its jobs for the person in control.

One thread owns the axis (`AxisThread`). Other threads read what it publishes and request jobs, with the token of control, or a stop,
without a token.
"""

from __future__ import annotations

import itertools
import logging
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack

from drivers.errors import DriveFaultError, LocalError, MeasurementLostError, SafetyError, StateError, TransportError
from hil.axis.axis_file import DriveAxis
from hil.correction.sealed.errors import WrongPasswordError
from hil.desk.asking import Pending
from hil.desk.axis_thread import AxisThread, Connect, JobRequest, to_axis
from hil.desk.backoff import BackOff
from hil.desk.control import DeskControl
from hil.desk.event_log import EVENTS, EventLog, LogKind
from hil.desk.job import Job
from hil.desk.live import Live, Silence, TracePoint
from hil.desk.plan import Plan
from hil.desk.progress import Graph, JobLog, Phase, Progress
from hil.desk.roles import LockedError, OpenedStore, Rights
from hil.desk.stop import CameToRest
from hil.desk.unfinished import UnfinishedWork, discard
from hil.desk.worker_process import Computed, Passes, Work, WorkerProcess

_LOG = logging.getLogger("hil.panel")


_REMEDIES: tuple[tuple[type[BaseException], str], ...] = (
    (TransportError, "link"),
    (DriveFaultError, "fault"),
    (MeasurementLostError, "instrument"),
    (SafetyError, "motion"),
    (LocalError, "input"),
)


def _remedy(raised: BaseException | None) -> str:
    """Key of what to do after an error, by its kind."""
    return next((key for kind, key in _REMEDIES if isinstance(raised, kind)), "other")


class BusyError(LocalError):
    """Another job is running."""


class Desk:
    """A context manager: the axis's thread runs inside.

    pace: simulated seconds per real second during a job on the bench, 0 for as fast as possible; without effect on a real axis
    numbers: job numbers in the order of the requests, shared by the desks of one server
    """

    def __init__(
        self,
        axis: DriveAxis,
        *,
        pace: float = 1.0,
        connect: Connect | None = None,
        numbers: Iterator[int] | None = None,
    ) -> None:
        self.axis = axis
        self._numbers = itertools.count(1) if numbers is None else numbers
        self.control = DeskControl()
        self.rights = Rights(axis)
        self.control.on_change = self.rights.forget
        self._thread = AxisThread(axis, connect or to_axis(axis), pace)
        self.errors = self._thread.errors
        self.events = EventLog(axis.store.directory / EVENTS, axis.name)
        self._thread.on_lost = self._lost
        self._worker = WorkerProcess(axis.path, self.errors)
        self.backoff = BackOff()
        self._lock = threading.Lock()
        self._log: JobLog | None = None
        self._last: dict[str, JobLog] = {}
        self._borrower: tuple[Desk, JobLog] | None = None
        self._told_lost = self._stopped_something = False

    # -- for everybody -------------------------------------------------------------------------------------------------
    @property
    def name(self) -> str:
        """The axis's name."""
        return self.axis.name

    @property
    def live(self) -> Live:
        """The last state of the axis."""
        return self._thread.board.live

    @property
    def silence(self) -> Silence:
        """How long ago its drive and instrument were last heard."""
        return self._thread.board.silence()

    def trace(self, since: int = 0) -> tuple[TracePoint, ...]:
        """Its signals of the last minute, after the point number `since`."""
        return self._thread.board.trace(since)

    def job(self) -> Progress | None:
        """The running or last job; another desk's job while that has this axis."""
        borrower = self._borrowing()
        if borrower is not None:
            return borrower.job()
        log = self._log
        return None if log is None else log.progress(stopping=self._thread.stop.pressed)

    def last(self, kind: str) -> Progress | None:
        """The last job of this kind, running or over."""
        log = self._last.get(kind)
        return None if log is None else log.progress(stopping=self._thread.stop.pressed)

    def last_of(self, kinds: Iterable[str]) -> Progress | None:
        """The last job of any of these kinds."""
        return max(filter(None, map(self.last, kinds)), key=lambda job: job.number, default=None)

    def graph(self, kind: str, since: int = 0) -> Graph:
        """The curves of the last job of this kind, after the first `since` points."""
        log = self._last.get(kind)
        return Graph(0, {}) if log is None else log.graph(since)

    @property
    def question(self) -> Pending | None:
        """The running job's question to the operator, None for none."""
        borrower = self._borrowing()
        return self._thread.asking.pending if borrower is None else borrower.question

    @property
    def computed(self) -> Computed:
        """The running or last computation on stored campaigns."""
        return self._worker.computed

    def stop(self) -> None:
        """Quick stop, without a token. A running job ends; its rows are kept."""
        job = self.job()
        self._stopped_something = self.live.moving or (job is not None and job.running and not job.stopping)
        borrower = self._borrowing()
        if borrower is not None:
            borrower.stop()
        else:
            self._thread.press_stop()

    def told_stop(self, who: str) -> None:
        """Log the last stop, if anything moved or ran, with the name of the browser that pressed it."""
        stopped, self._stopped_something = self._stopped_something, False
        if stopped:
            self.events.add(LogKind.STOP, "stop", who=who)

    @property
    def came_to_rest(self) -> CameToRest | None:
        """How the axis came to rest after the last stop in motion; None before, and after the begin of another job."""
        return self._thread.standstill.found

    # -- for the person in control -------------------------------------------------------------------------------------
    def run(
        self, token: str | None, job: Job, lent: Mapping[Desk, str | None] | None = None, changes: Iterable[str] = ()
    ) -> None:
        """Start a job. lent: other desks whose axes the job connects itself, with their tokens; changes: what it writes, for the log.

        Raises NotInControlError for a wrong token, LockedError without the role that the job needs, BusyError while another job runs,
        and StateError while an axis is not connected.
        """
        self.control.require(token)
        self.rights.require(locked=job.plan.locked, store=job.plan.store)
        log = JobLog(next(self._numbers), job.kind, job.plan, changes=tuple(changes), on_end=self._ended)
        log.who = self._holder_name()
        with ExitStack() as undo:
            for other, its_token in (lent or {}).items():
                other._lend(its_token, self, log)
                undo.callback(other._take_back)
            with self._lock:
                self._require_free()
                self._log = self._last[job.kind] = log
                self.events.add(LogKind.JOB, "started", who=log.who, job=job.kind)
                threads = tuple(other._thread for other in lent or ())
                self._thread.ask(JobRequest(job, log, self.rights.store, threads))
            undo.pop_all()

    def take_control(self, who: str, *, over: bool = False) -> str:
        """Take control, or take it over from a silent holder; returns the token. Raises ControlHeldError."""
        token = self.control.take_over(who) if over else self.control.take(who)
        self.events.add(LogKind.CONTROL, "taken_over" if over else "taken", who=who)
        return token

    def release_control(self, token: str | None, who: str) -> None:
        """Release control. Raises NotInControlError."""
        self.control.release(token)
        self.events.add(LogKind.CONTROL, "released", who=who)

    def answer(self, token: str | None, number: int, *, yes: bool) -> None:
        """Answer the question of this number, if it is still asked. Raises NotInControlError."""
        self.control.require(token)
        (self._borrowing() or self)._thread.asking.answer(number, yes)

    def power_off(self, token: str | None) -> None:
        """Disable an axis that was left enabled. Raises as `run`."""
        self.run(token, Job("power off", self._bare_plan(), lambda place: place.drive.disable()))

    def reset_fault(self, token: str | None) -> None:
        """Acknowledge a fault; the axis stays disabled. Raises as `run`."""
        self.run(token, Job("reset fault", self._bare_plan(), lambda place: place.drive.reset_fault()))

    def compute(self, token: str | None, work: Work, campaigns: Sequence[Passes] = ()) -> None:
        """Start a computation on stored campaigns, independent of the axis.

        Raises NotInControlError, and ComputingError while another runs.
        """
        self.control.require(token)
        self._worker.start(work.request(campaigns))

    def cancel_computing(self, token: str | None) -> None:
        """Cancel the computation. Raises NotInControlError."""
        self.control.require(token)
        self._worker.cancel()

    def discard(self, token: str | None, work: UnfinishedWork) -> None:
        """Give up an interrupted campaign. Raises NotInControlError, BusyError while a job runs, and as `unfinished.discard`."""
        self.control.require(token)
        with self._lock:
            self._require_idle()
            discard(self.axis, work)
        since = "" if work.since is None else work.since.strftime("%Y-%m-%d %H:%M")
        figures = {"job": work.kind, "since": since, "rows": str(work.rows)}
        self.events.add(LogKind.WRITE, "discarded", who=self._holder_name(), **figures)

    def become_builder(self, token: str | None, key_password: str, reading_password: str = "") -> None:
        """Take the builder's role, until control changes. Takes about a second. Raises NotInControlError, and as `Rights`."""
        self.control.require(token)
        self._opened(lambda: self.rights.become_builder(key_password, reading_password))
        self._forget_unless_held(token)

    def read_tables(self, token: str | None, password: str) -> None:
        """Open the tables for reading, until control changes. Raises NotInControlError, and as `Rights`."""
        self.control.require(token)
        self._opened(lambda: self.rights.read_tables(password))
        self._forget_unless_held(token)

    def open_other(self, token: str | None, name: str, opening: Callable[[], OpenedStore]) -> None:
        """Open a sealed store beside the axis's, until control changes. Raises NotInControlError, and as `Rights`."""
        self.control.require(token)
        self._opened(lambda: self.rights.open_other(name, opening))
        self._forget_unless_held(token)

    def become_operator(self, token: str | None) -> None:
        """Return to the operator's role and forget all passwords. Raises NotInControlError."""
        self.control.require(token)
        self.rights.forget()

    def _opened(self, opening: Callable[[], None]) -> None:
        """Open with a password. Raises LockedError during the back-off after wrong ones, and what `opening` raises."""
        wait_s = self.backoff.wait_s(self.name)
        if wait_s > 0.0:
            raise LockedError(f"after wrong passwords the next one is looked at in {math.ceil(wait_s)} s")
        try:
            opening()
        except WrongPasswordError:
            count = self.backoff.wrong(self.name)
            _LOG.warning("wrong password at axis %s, %d in a row", self.name, count)
            raise
        self.backoff.right(self.name)

    def _forget_unless_held(self, token: str | None) -> None:
        """Undo an opening if control has changed meanwhile. Raises NotInControlError then."""
        if not self.control.holds(token):
            self.rights.forget()
            self.control.require(token)

    def _holder_name(self) -> str:
        holder = self.control.holder()
        return "" if holder is None else holder.name

    def _ended(self, log: JobLog, raised: BaseException | None) -> None:
        """Log how a job ended, and what it wrote."""
        figures = {"job": log.kind}
        if log.phase is Phase.DONE:
            for change in log.changes:
                self.events.add(LogKind.WRITE, "wrote", who=log.who, change=change, **figures)
            self.events.add(LogKind.JOB, "done", who=log.who, **figures)
        elif log.phase in (Phase.STOPPED, Phase.WITHOUT_RESULT):
            self.events.add(LogKind.JOB, log.phase.value, who=log.who, **figures)
        else:
            self.events.add(LogKind.ALARM, "failed", who=log.who, cause=log.error, remedy=_remedy(raised), **figures)
            self._told_lost = isinstance(raised, TransportError)

    def _lost(self, said: str) -> None:
        """An axis that was connected is lost. That of a job is told by the job's own alarm."""
        told, self._told_lost = self._told_lost, False
        if not told:
            self.events.add(LogKind.ALARM, "lost", cause=said, remedy="link")

    def _bare_plan(self) -> Plan:
        return Plan(self.axis.name, self.axis.drive.backend)

    # -- one job at a time ---------------------------------------------------------------------------------------------
    def _require_idle(self) -> None:
        if self._log is not None and self._log.phase is Phase.RUNNING:
            raise BusyError(f"axis {self.name} is busy: {self._log.kind}")
        borrower = self._borrowing()
        if borrower is not None:
            raise BusyError(f"axis {self.name} is lent to a job of axis {borrower.name}")

    def _require_free(self) -> None:
        self._require_idle()
        if not self.live.connected:
            raise StateError(f"axis {self.name} is not connected: {self.live.trouble or 'connecting'}")

    def _borrowing(self) -> Desk | None:
        """The desk whose running job has this axis."""
        borrower = self._borrower
        return None if borrower is None or borrower[1].phase is not Phase.RUNNING else borrower[0]

    def _lend(self, token: str | None, borrower: Desk, log: JobLog) -> None:
        self.control.require(token)
        with self._lock:
            self._require_free()
            self._borrower = (borrower, log)
            self._thread.lend()

    def _take_back(self) -> None:
        self._borrower = None
        self._thread.take_back()

    # -- coming and going ----------------------------------------------------------------------------------------------
    def __enter__(self) -> Desk:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the running job and disconnect the axis. Raises StateError when the thread does not end in time."""
        self.stop()
        try:
            self._worker.close()
        finally:
            self._thread.close()
