"""The state of a job as the screen shows it: its events, in memory of fixed size."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from hil.app.jobs.plan import Plan
from hil.machine.events import Event, Measured, Point

KEPT_POINTS, KEPT_SERIES, KEPT_FIGURES, KEPT_MESSAGES = 2000, 40, 200, 100


class Phase(Enum):
    """State of a job."""

    RUNNING = "running"
    DONE = "done"
    STOPPED = "stopped"  # by the operator
    FAILED = "failed"


@dataclass(frozen=True)
class Progress:
    """The state of a job.

    number: of the job, counted over all desks; figures: results in the order of time; result: of a job that is done
    error: of a job that failed, one line; stopping: the stop was pressed and is not yet carried out
    """

    number: int
    kind: str
    plan: Plan
    phase: Phase
    stage: str = ""
    message: str = ""
    done: int = 0
    total: int = 0
    figures: tuple[Measured, ...] = ()
    messages: tuple[str, ...] = ()
    result: object = None
    error: str = ""
    stopping: bool = False

    @property
    def running(self) -> bool:
        """Whether the job has not ended."""
        return self.phase is Phase.RUNNING


@dataclass(frozen=True)
class Graph:
    """Points (x, y) of a job's curves, by name. points: number of points so far, for the next request."""

    points: int
    series: Mapping[str, list[tuple[float, float]]]


@dataclass
class JobLog:
    """Collects a job's events in the axis's thread; any thread reads."""

    number: int
    kind: str
    plan: Plan
    phase: Phase = Phase.RUNNING
    result: object = None
    error: str = ""
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _event: Event = field(default_factory=lambda: Event(""))
    _figures: deque[Measured] = field(default_factory=lambda: deque(maxlen=KEPT_FIGURES))
    _messages: deque[str] = field(default_factory=lambda: deque(maxlen=KEPT_MESSAGES))
    _series: dict[str, deque[tuple[int, float, float]]] = field(default_factory=dict)
    _points: int = 0

    def hear(self, event: Event) -> None:
        """Take an event; the listener of procedures."""
        with self._lock:
            self._event = event
            if event.warning:
                self._messages.append(event.message)
            if isinstance(event.found, Measured):
                self._figures.append(event.found)
            elif isinstance(event.found, Point):
                self._add(event.found)

    def _add(self, point: Point) -> None:
        if point.series not in self._series:
            if len(self._series) == KEPT_SERIES:
                del self._series[next(iter(self._series))]
            self._series[point.series] = deque(maxlen=KEPT_POINTS)
        self._points += 1
        self._series[point.series].append((self._points, point.x, point.y))

    def tell(self, text: str) -> None:
        """Keep a message."""
        with self._lock:
            self._messages.append(text)

    def end(self, phase: Phase, result: object = None, error: str = "") -> None:
        """Note that the job has ended."""
        with self._lock:
            self.phase, self.result, self.error = phase, result, error

    def progress(self, *, stopping: bool = False) -> Progress:
        """The present state. stopping: the stop was pressed."""
        with self._lock:
            event = self._event
            return Progress(
                *(self.number, self.kind, self.plan, self.phase, event.stage, event.message, event.done, event.total),
                tuple(self._figures),
                tuple(self._messages),
                self.result,
                self.error,
                stopping and self.phase is Phase.RUNNING,
            )

    def graph(self, since: int = 0) -> Graph:
        """The points after the first `since` of all points."""
        with self._lock:
            series = {name: [(x, y) for n, x, y in points if n > since] for name, points in self._series.items()}
            return Graph(self._points, series)
