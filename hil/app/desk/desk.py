"""One axis's desk: what everybody may see and do, and what only whoever holds control.

Behind it one thread owns the axis (`AxisThread`). Everybody else reads what it publishes, and asks: for a job, with the token of
control, and for a stop, without.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any

from drivers.errors import LocalError, StateError
from hil.app.desk.asking import Pending
from hil.app.desk.axis_thread import Asked, AxisThread, Connect, to_axis
from hil.app.desk.control import Control
from hil.app.desk.live import Live, TracePoint
from hil.app.desk.progress import Graph, JobLog, Phase, Progress
from hil.app.desk.roles import Rights
from hil.app.desk.standstill import CameToRest
from hil.app.desk.worker_process import Aside, Computed
from hil.app.jobs.job import Job
from hil.app.jobs.plan import Plan
from hil.axis.axis_file import DriveAxis
from hil.probe.machine_file import ProbeMachineConfig


class BusyError(LocalError):
    """A job is running already."""


class Desk:
    """Use as a context manager: inside, the axis's thread runs.

    pace: simulated seconds per real one during a job on the bench, 0 for as fast as it goes; a real axis knows no such thing.
    numbers: of jobs, in the order they are asked for; desks whose jobs are to be put in order share one.
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
        self.control = Control()
        self.rights = Rights(axis)
        self.control.on_change = self.rights.forget
        self._thread = AxisThread(axis, connect or to_axis(axis), pace)
        self.errors = self._thread.errors
        self._aside = Aside(axis.path, self.errors)
        self._lock = threading.Lock()
        self._log: JobLog | None = None
        self._last: dict[str, JobLog] = {}
        self._borrower: tuple[Desk, JobLog] | None = None

    # -- for everybody -------------------------------------------------------------------------------------------------
    @property
    def name(self) -> str:
        return self.axis.name

    @property
    def live(self) -> Live:
        """The axis as it was last seen."""
        return self._thread.board.live

    def trace(self, since: int = 0) -> tuple[TracePoint, ...]:
        """The last minute of its signals, after the point of this number."""
        return self._thread.board.trace(since)

    def job(self) -> Progress | None:
        """The job that is running, or ran last; another desk's while that has our axis."""
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
        """What the running job asks somebody at the machine."""
        borrower = self._borrowing()
        return self._thread.asking.pending if borrower is None else borrower.question

    @property
    def computed(self) -> Computed:
        """What is being computed of stored campaigns, or was last."""
        return self._aside.computed

    def stop(self) -> None:
        """Quick stop, now, whoever asks. A running job ends; what it measured is kept."""
        borrower = self._borrowing()
        if borrower is not None:
            borrower.stop()
        else:
            self._thread.press_stop()

    @property
    def came_to_rest(self) -> CameToRest | None:
        """How the axis did after the last stop of a job in motion; None before, and since another job began."""
        return self._thread.standstill.found

    # -- for whoever holds control -------------------------------------------------------------------------------------
    def run(self, token: str | None, job: Job, lent: Mapping[Desk, str | None] | None = None) -> None:
        """Start a job. lent: other desks whose axes the job connects by itself, with their tokens.

        Raises NotInControlError, LockedError, BusyError, and StateError while an axis is not connected.
        """
        self.control.require(token)
        self.rights.require(locked=job.plan.locked, of_probe=job.plan.of_probe)
        log = JobLog(next(self._numbers), job.kind, job.plan)
        with ExitStack() as undo:
            for other, its_token in (lent or {}).items():
                other._lend(its_token, self, log)
                undo.callback(other._take_back)
            with self._lock:
                self._require_free()
                self._log = self._last[job.kind] = log
                threads = tuple(other._thread for other in lent or ())
                self._thread.ask(Asked(job, log, self.rights.store, threads))
            undo.pop_all()

    def answer(self, token: str | None, number: int, *, yes: bool) -> None:
        """Answer the question of this number, if it is still asked."""
        self.control.require(token)
        (self._borrowing() or self)._thread.asking.answer(number, yes)

    def power_off(self, token: str | None) -> None:
        """Take the power off an axis that was left enabled."""
        self.run(token, Job("power off", self._bare_plan(), lambda place: place.drive.disable()))

    def reset_fault(self, token: str | None) -> None:
        """Acknowledge a fault; the axis stays without power."""
        self.run(token, Job("reset fault", self._bare_plan(), lambda place: place.drive.reset_fault()))

    def compute(self, token: str | None, request: Mapping[str, Any]) -> None:
        """Have something made of stored campaigns (`hil.app.jobs.worker_process.request`), whatever the axis does.

        Raises ComputingError.
        """
        self.control.require(token)
        self._aside.start(request)

    def cancel_computing(self, token: str | None) -> None:
        """Give up what is being computed."""
        self.control.require(token)
        self._aside.cancel()

    def become_builder(self, token: str | None, key_password: str, reading_password: str = "") -> None:
        """Take the builder's role, until control changes hands. Takes about a second; raises what opening the key raises."""
        self.control.require(token)
        self.rights.become_builder(key_password, reading_password)
        self._forget_unless_held(token)

    def read_tables(self, token: str | None, password: str) -> None:
        """Give the tables' reading password, until control changes hands. Raises what opening them raises."""
        self.control.require(token)
        self.rights.read_tables(password)
        self._forget_unless_held(token)

    def open_probe(
        self, token: str | None, config: ProbeMachineConfig, reading_password: str, key_password: str = ""
    ) -> None:
        """Give the passwords of the probe's sealed run-out, until control changes hands. Raises what opening it raises."""
        self.control.require(token)
        self.rights.open_probe(config, reading_password, key_password)
        self._forget_unless_held(token)

    def become_operator(self, token: str | None) -> None:
        """Give up the builder's role."""
        self.control.require(token)
        self.rights.forget()

    def _forget_unless_held(self, token: str | None) -> None:
        """Control may have changed hands while a key was being opened."""
        if not self.control.holds(token):
            self.rights.forget()
            self.control.require(token)

    def _bare_plan(self) -> Plan:
        return Plan(self.axis.name, self.axis.drive.backend)

    # -- one job at a time ---------------------------------------------------------------------------------------------
    def _require_free(self) -> None:
        if self._log is not None and self._log.phase is Phase.RUNNING:
            raise BusyError(f"axis {self.name} is busy: {self._log.kind}")
        borrower = self._borrowing()
        if borrower is not None:
            raise BusyError(f"axis {self.name} is lent to a job of axis {borrower.name}")
        if not self.live.connected:
            raise StateError(f"axis {self.name} is not connected: {self.live.trouble or 'connecting'}")

    def _borrowing(self) -> Desk | None:
        """The desk whose running job has our axis."""
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
        """Stop whatever runs, let go of the axis. Raises StateError where it does not end in time."""
        self.stop()
        try:
            self._aside.close()
        finally:
            self._thread.close()
