"""Jobs on several drives: one task for each drive, taken through the same stages side by side."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from typing import ParamSpec, TypeVar

from drivers.clock import Clock
from drivers.errors import BridgeError
from drivers.raw_parameters import Access, Line, Pause, RawParameters, Steps
from hil.parameters.report import Ending, JobReport, ParameterVerdict, Row
from hil.parameters.transaction import DriveTask

P = ParamSpec("P")
T = TypeVar("T")
W = TypeVar("W", bound=DriveTask)
Progress = Callable[[str, str, int, int], None]
"""progress(stage, drive, done, total)"""

VERDICTS = {
    Ending.WRITTEN: ParameterVerdict.WRITTEN,
    Ending.UNCHANGED: ParameterVerdict.NOT_WRITTEN,
    Ending.PUT_BACK: ParameterVerdict.PUT_BACK,
    Ending.REFUSED: ParameterVerdict.NOT_WRITTEN,
    Ending.UNFINISHED: ParameterVerdict.UNKNOWN,
}
"""Outcome of a parameter whose old and new values differ. Others are `SAME`, unless the ending is unfinished."""


def no_progress(_stage: str, _drive: str, _done: int, _total: int) -> None:
    """No observer is registered; progress is dropped."""


def run_together(
    works: Sequence[T], drive: Callable[[T], RawParameters], steps: Callable[[T], Steps[None]]
) -> list[BridgeError | None]:
    """Run the steps of each task side by side, each line in a thread of its own; returns the BridgeError of each, None for none.

    Any other exception of a line, and KeyboardInterrupt, ends the other lines at their next transfer or pause, and is then raised.
    """
    lines = {id(drive(work).line): drive(work).line for work in works}
    jobs = [_OnLine(line, []) for line in lines.values()]
    by_line = dict(zip(lines, jobs, strict=True))
    for number, work in enumerate(works):
        by_line[id(drive(work).line)].numbers.append(number)
    results: dict[int, BridgeError | None] = {}

    def run(job: _OnLine, guard: Callable[[Steps[None]], Steps[None]]) -> None:
        outcomes = job.line.run([guard(steps(works[number])) for number in job.numbers])
        for number, outcome in zip(job.numbers, outcomes, strict=True):
            results[number] = outcome if isinstance(outcome, BridgeError) else None

    if len(jobs) == 1:
        run(jobs[0], lambda own: own)
    elif jobs:
        _in_threads([(drive(works[job.numbers[0]]).clock, partial(run, job)) for job in jobs])
    return [results[number] for number in range(len(works))]


@dataclass(frozen=True)
class _OnLine:
    """The tasks of one line, by number."""

    line: Line
    numbers: list[int]


class _EndedByAnotherError(BaseException):
    """Ends the tasks of a line because another line's were ended. It is no BridgeError, so that no task handles it."""


def _in_threads(runs: Sequence[tuple[Clock, Callable[[Callable[[Steps[None]], Steps[None]]], None]]]) -> None:
    """Run each in a thread of its own and wait for all. A second Ctrl-C ends the wait."""
    ended = threading.Event()
    outcomes: queue.SimpleQueue[BaseException | None] = queue.SimpleQueue()

    def work(run: Callable[[Callable[[Steps[None]], Steps[None]]], None]) -> None:
        try:
            run(partial(_until, ended))
        except BaseException as error:  # noqa: BLE001  raised by the thread that waits
            ended.set()
            outcomes.put(error)
        else:
            outcomes.put(None)

    clocks = {id(clock): clock for clock, _ in runs}
    for key, clock in clocks.items():
        for own in clock.side_by_side([partial(work, run) for its, run in runs if id(its) == key]):
            # a copy each: a context is entered by one thread at a time
            threading.Thread(target=copy_context().run, args=(own,), name="parameters", daemon=True).start()
    raised: list[BaseException] = []
    left = len(runs)
    while left:
        try:
            outcome = outcomes.get()
        except KeyboardInterrupt as interrupt:
            if any(isinstance(error, KeyboardInterrupt) for error in raised):
                raise
            ended.set()
            raised.insert(0, interrupt)
            continue
        left -= 1
        if outcome is not None and not isinstance(outcome, _EndedByAnotherError):
            raised.append(outcome)
    if raised:
        raise raised[0]


def _until(ended: threading.Event, steps: Steps[None]) -> Steps[None]:
    """The same steps, ended at the first one after `ended` is set. A pause is cut short, a transfer is not."""
    with closing(steps):
        while True:
            if ended.is_set():
                raise _EndedByAnotherError
            try:
                step = next(steps)
            except StopIteration:
                return
            yield Pause(step.duration_s, partial(_over, ended, step)) if isinstance(step, Pause) else step


def _over(ended: threading.Event, pause: Pause) -> bool:
    return ended.is_set() or pause.done()


def serialized(told: Callable[P, T]) -> Callable[P, T]:
    """The function with a lock around it, for callbacks from the threads of several lines."""
    lock = threading.Lock()

    def tell(*args: P.args, **kwargs: P.kwargs) -> T:
        with lock:
            return told(*args, **kwargs)

    return tell


def stage(
    works: Sequence[W],
    name: str,
    total: Callable[[W], int],
    steps: Callable[[W], Steps[None]],
    progress: Progress = no_progress,
) -> None:
    """Take every task through a stage. A BridgeError becomes the task's error. total: number of accesses, for the progress."""
    progress = serialized(progress)
    for work in works:
        work.tell = counted(progress, name, work.drive, max(1, total(work)))
    errors = run_together(works, lambda work: work.drive, partial(_timed, steps))
    for work, error in zip(works, errors, strict=True):
        if error is not None:
            work.fail(error)


def _timed(steps: Callable[[W], Steps[None]], work: W) -> Steps[None]:
    """Run the steps and set `seconds`, the time until this drive was done."""
    try:
        yield from steps(work)
    finally:
        work.seconds = (work.drive.clock.now_ns() - work.began_ns) * 1e-9


def counted(progress: Progress, name: str, drive: RawParameters, total: int) -> Callable[[Sequence[Access]], None]:
    """A listener of one drive's accesses that reports how many of them are done in a stage."""
    done = 0

    def tell(accesses: Sequence[Access]) -> None:
        nonlocal done
        done += len(accesses)
        progress(name, drive.name, min(done, total), total)

    return tell


def reports_of(works: Sequence[DriveTask]) -> list[JobReport]:
    failed = [work.drive.name for work in works if work.error or work.objections]
    return [_report(work, [name for name in failed if name != work.drive.name]) for work in works]


def _report(work: DriveTask, others: Sequence[str]) -> JobReport:
    ending = work.ending or Ending.UNFINISHED
    notes = list(work.notes)
    if others and not work.error and not work.objections and not ending.good:
        notes.append(f"because of {', '.join(others)}")
    return JobReport(
        work.drive.name,
        ending,
        tuple(_row(work, address, ending) for address in work.new if address in work.old),
        work.stored,
        work.error,
        tuple(work.objections),
        tuple(notes),
        work.seconds,
        str(work.noted.path) if work.noted is not None and ending is Ending.UNFINISHED else "",
        work.meant_back,
        work.audited,
        tuple(work.lost),
    )


def _row(work: DriveTask, address: str, ending: Ending) -> Row:
    parameter = work.parameters[address]
    same = work.drive.shows(address, work.old[address], work.new[address])
    return Row(
        address,
        parameter.info.name,
        work.drive.unit_of(parameter),
        work.drive.decode(parameter, work.old[address]),
        work.drive.decode(parameter, work.new[address]),
        ParameterVerdict.SAME if same and ending is not Ending.UNFINISHED else VERDICTS[ending],
        work.read_s.get(address),
        work.write_s.get(address),
    )
