"""Work spread over processes of this computer, or over the workers of a Dask scheduler, behind one
`concurrent.futures` executor."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from drivers.errors import InputError, StateError

Task = TypeVar("Task")
Result = TypeVar("Result")

TIMES = 3
"""How often a task is given to a new local worker after one died with it; Dask's own default is 3 too
(allowed-failures)."""
AHEAD = 3
"""Tasks submitted per worker: one at work, and others so that it never waits; more would only fill the memory with
results."""
CONNECT_S = 10.0
"""Longest time in which a scheduler answers."""


@contextmanager
def workers(scheduler: str | None = None, processes: int | None = None) -> Iterator[tuple[Executor, int]]:
    """An executor, and how many tasks to keep submitted.

    scheduler: address of a Dask scheduler, such as tcp://HOST:8786, None for processes of this computer; processes:
    how many, None for one per core. Raises InputError where no scheduler answers or the package is missing.
    """
    if scheduler is not None:
        with _dask(scheduler) as found:
            yield found
        return
    count = processes or cores()
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _leave_interrupts)
    try:
        yield pool, AHEAD * count
    finally:
        pool.shutdown(cancel_futures=True)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def _leave_interrupts() -> None:
    """Ctrl-C reaches the whole group; the process that asked ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _dask(scheduler: str) -> Iterator[tuple[Executor, int]]:
    try:
        from distributed import Client  # noqa: PLC0415  (an extra, and slow to import)
    except ImportError as error:
        raise InputError("--scheduler needs the fleet extra: pip install 'hil[fleet]'") from error
    try:
        client: Any = Client(scheduler, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at {scheduler}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"the Dask scheduler at {scheduler} has no workers")
        yield client.get_executor(pure=False), AHEAD * threads


def completed(
    work: Callable[[Task], Result], tasks: Iterable[Task], *, scheduler: str | None = None, processes: int | None = None
) -> Iterator[tuple[Task, Result]]:
    """Each task with its result, as they are done, in any order. work: a function of a module, with a result that
    can be pickled.

    A task whose worker died is given to another. Raises what `work` raises, and StateError where a task was lost
    `TIMES` times.
    """
    left = list(tasks)
    tried: dict[int, int] = {}
    while left:
        lost: list[Task] = []
        with workers(scheduler, min(processes or cores(), len(left))) as (pool, most):
            yield from _while_alive(pool, most, work, left, lost)
        for one in lost:
            tried[id(one)] = tried.get(id(one), 0) + 1
            if tried[id(one)] >= TIMES:
                raise StateError(f"a worker died {TIMES} times at the same task; what the others did is kept")
        left = lost


def _while_alive(
    pool: Executor, most: int, work: Callable[[Task], Result], tasks: list[Task], lost: list[Task]
) -> Iterator[tuple[Task, Result]]:
    """Yields until all is done, or the pool broke: then what was not done is in `lost`, first what was at work."""
    waiting = iter(tasks)
    running: dict[Future[Result], Task] = {}
    broken = False
    while True:
        while not broken and len(running) < most and (task := next(waiting, None)) is not None:
            try:
                running[pool.submit(work, task)] = task
            except BrokenProcessPool:
                broken = True
                lost.append(task)
        if not running:
            break
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            task = running.pop(future)
            try:
                result = future.result()
            except BrokenProcessPool:
                broken = True
                lost.append(task)
                continue
            except CancelledError as error:
                raise StateError(
                    "the connection to the scheduler was lost; finished work is kept, and the same command continues"
                ) from error
            yield task, result
    lost += waiting
