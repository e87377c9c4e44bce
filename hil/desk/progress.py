"""The state of a job as the screen shows it: its events, in memory of fixed size."""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from hil.desk.plan import Plan
from hil.machine.events import Event, Measured, Point

KEPT_POINTS, KEPT_SERIES, KEPT_FIGURES, KEPT_MESSAGES = 2000, 40, 200, 100


_LOOP = (("measure",), ("round",), ("before",), ("diagnose", "next"), ("after",))
_MOTION = (("motion-before",), ("diagnose",), ("motion-after",))
_WRITING = (("look",), ("write",))
_CORRECTING = (("measure",), ("round",), ("verify",))
"""As found, with the tables, verified: the last one is a job of its own."""
_STEPS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "calibrate": _CORRECTING,
    "verify": _CORRECTING,
    "lost motion": (("strokes",), ("fit",), ("before",), ("after",)),
    "circle": (("circle, uncorrected",), ("circle, tables",), ("circle, corrected",)),
    "straightness": (("measure",), ("before",), ("after",)),
    "close-loop": _LOOP,
    "parameters download": _WRITING,
    "parameters restore": _WRITING,
}
"""Steps of each kind of job, by the names that its stages begin with. The last ones of a loop are there with passes in motion only."""
_RUN = re.compile(r"run (\d+) of (\d+)\b")
"""A stage that states its number itself."""


def steps_of(kind: str, plan: Plan) -> tuple[tuple[str, ...], ...]:
    """The steps of a job in their order, () for a job without."""
    in_motion = kind == "close-loop" and any(move.what.startswith("feeds") for move in plan.moves)
    return _STEPS.get(kind, ()) + (_MOTION if in_motion else ())


class Phase(Enum):
    """State of a job."""

    RUNNING = "running"
    DONE = "done"
    WITHOUT_RESULT = "without_result"  # carried out, but what it was for was not reached
    STOPPED = "stopped"  # by the operator
    FAILED = "failed"


@dataclass(frozen=True)
class Progress:
    """The state of a job.

    number: of the job, counted over all desks; figures: results in the order of time; result: of a job that was carried out
    error: of a job that failed, one line; stopping: the stop was pressed and is not yet carried out
    step: number of the step that runs, from 1, and how many there are, None where they are not numbered
    began_s, ended_s: by `time.monotonic`; left_s: estimate of the time left in the step that runs, by its pace so far, None for none
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
    began_s: float = 0.0
    ended_s: float | None = None
    left_s: float | None = None
    step: tuple[int, int] | None = None

    @property
    def elapsed_s(self) -> float:
        """Time since its begin, or that it took, s of real time."""
        return (time.monotonic() if self.ended_s is None else self.ended_s) - self.began_s

    @property
    def running(self) -> bool:
        """Whether the job has not ended."""
        return self.phase is Phase.RUNNING

    @property
    def carried_out(self) -> bool:
        """Whether the job came to its end by itself, with a result or without."""
        return self.phase in (Phase.DONE, Phase.WITHOUT_RESULT)

    @property
    def share(self) -> float:
        """How far the job is, 0 to 1, as far as its steps can be counted; 1 once it was carried out, whatever its last event said."""
        if self.carried_out:
            return 1.0
        return min(1.0, self.done / self.total) if self.total else 0.0


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
    who: str = ""  # started it
    changes: tuple[str, ...] = ()  # what it writes, old and new
    on_end: Callable[[JobLog, BaseException | None], None] = lambda _log, _error: None
    began_s: float = field(default_factory=time.monotonic)
    ended_s: float | None = None
    _step_s: float = field(default_factory=time.monotonic)  # begin of the step that runs
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _event: Event = field(default_factory=lambda: Event(""))
    _figures: deque[Measured] = field(default_factory=lambda: deque(maxlen=KEPT_FIGURES))
    _messages: deque[str] = field(default_factory=lambda: deque(maxlen=KEPT_MESSAGES))
    _series: dict[str, deque[tuple[int, float, float]]] = field(default_factory=dict)
    _points: int = 0
    _step: tuple[int, int] | None = None

    def hear(self, event: Event) -> None:
        """Take an event; the listener of procedures."""
        with self._lock:
            if (event.stage, event.total) != (self._event.stage, self._event.total):
                self._step_s = time.monotonic()
            if event.stage != self._event.stage:
                self._count_steps(event.stage)
            self._event = event
            if event.warning:
                self._messages.append(event.message)
            if isinstance(event.found, Measured):
                self._figures.append(event.found)
            elif isinstance(event.found, Point):
                self._add(event.found)

    def _count_steps(self, stage: str) -> None:
        """Note the number of the step; one that is over does not come again."""
        steps = steps_of(self.kind, self.plan)
        if match := _RUN.match(stage):
            self._step = int(match[1]), int(match[2])
            return
        for number in range(1 if self._step is None else self._step[0], len(steps) + 1):
            if any(stage == name or stage.startswith((f"{name}-", f"{name} ")) for name in steps[number - 1]):
                self._step = number, len(steps)
                return

    def _add(self, point: Point) -> None:
        if point.series not in self._series:
            if len(self._series) == KEPT_SERIES:
                del self._series[next(iter(self._series))]
            self._series[point.series] = deque(maxlen=KEPT_POINTS)
        self._points += 1
        self._series[point.series].append((self._points, point.x, point.y))

    def tell(self, text: str) -> None:
        with self._lock:
            self._messages.append(text)

    def end(self, phase: Phase, result: object = None, error: str = "", raised: BaseException | None = None) -> None:
        """Note that the job has ended. raised: what ended a job that failed."""
        with self._lock:
            self.ended_s = time.monotonic()
            self.phase, self.result, self.error = phase, result, error
        self.on_end(self, raised)

    def _left_s(self) -> float | None:
        event = self._event
        if not event.total or not 0 < event.done <= event.total:
            return None
        return (time.monotonic() - self._step_s) / event.done * (event.total - event.done)

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
                *(self.began_s, self.ended_s, self._left_s(), self._step),
            )

    def graph(self, since: int = 0) -> Graph:
        """The points after the first `since` of all points."""
        with self._lock:
            series = {name: [(x, y) for n, x, y in points if n > since] for name, points in self._series.items()}
            return Graph(self._points, series)
