"""CanLine: keeps the SDO channels of several nodes busy at once, each with work of its own.

One node has one channel and answers one request at a time; while it prepares its answer, the bus is free for the others. `CanLine.run`
sends a node's next request as soon as its answer has come, so that many nodes are limited by the bus and not by the slowest drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from drivers.canopen.bus import CanLink
from drivers.canopen.sdo import Awaited, Running, wait_for_any
from drivers.clock import NS_PER_S, Clock
from drivers.errors import BridgeError, LinkLostError, StateError
from drivers.raw_parameters import Line, Pause, Steps

T = TypeVar("T")


class _Pausing:
    """Work that pauses."""

    def __init__(self, pause: Pause, clock: Clock) -> None:
        self._pause = pause
        self._clock = clock
        self._over = False
        self.until_ns = clock.now_ns() + round(pause.duration_s * NS_PER_S)

    @property
    def finished(self) -> bool:
        return self._over or self._pause.done()

    def expire(self) -> None:
        self._clock.sleep_until_ns(
            self.until_ns
        )  # returns at once unless waiting on the bus does not advance the clock
        self._over = True


class CanLine(Line):
    """A CAN bus. Steps on it yield `Pause`s and `Running`s, each job on another node's channel."""

    def __init__(self, link: CanLink) -> None:
        self.link = link
        self.lost = False  # this program's end of the bus

    def run(self, jobs: Sequence[Steps[T]]) -> list[T | BridgeError]:
        results: dict[int, T | BridgeError] = {}
        turns: dict[int, Awaited] = {}
        with self.link.talking:
            try:
                for number in range(len(jobs)):
                    self._advance(number, jobs, turns, results)
                while turns:
                    self._await(list(turns.values()))
                    for number in [number for number, turn in turns.items() if turn.finished]:
                        self._end(turns.pop(number))
                        self._advance(number, jobs, turns, results)
            finally:
                for turn in turns.values():  # an exception ends all of them
                    self._end(turn)
                for job in jobs:
                    job.close()
        return [results[number] for number in range(len(jobs))]

    def _advance(
        self, number: int, jobs: Sequence[Steps[T]], turns: dict[int, Awaited], results: dict[int, T | BridgeError]
    ) -> None:
        """Run one job until its next transfer or pause is in progress, or it has ended."""
        while True:
            try:
                step = next(jobs[number])
            except StopIteration as stop:
                results[number] = stop.value
                return
            except BridgeError as error:
                results[number] = error
                return
            if isinstance(step, Pause):
                turns[number] = _Pausing(step, self.link.clock)
                return
            if not isinstance(step, Running):
                raise StateError(f"{type(step).__name__} is no work for a CAN bus")
            if self._begin(step):
                turns[number] = step
                return

    def _begin(self, running: Running[Any]) -> bool:
        """Send a transfer's first frame; False when it has ended already, or not begun."""
        try:
            running.client.begin(running)
        except BridgeError as error:
            self._fail(running, error)
            return False
        if running.finished:
            running.client.end()
        return not running.finished

    @staticmethod
    def _end(turn: Awaited) -> None:
        if isinstance(turn, Running):
            turn.client.end()

    def _fail(self, running: Running[Any], error: BridgeError) -> None:
        self.lost |= isinstance(error, LinkLostError)
        running.fail(error)

    def _await(self, turns: Sequence[Awaited]) -> None:
        """Wait until one has ended. Where the bus is lost, every transfer ends."""
        try:
            wait_for_any(self.link, turns)
        except LinkLostError as error:
            for turn in turns:
                if isinstance(turn, Running):
                    self._fail(turn, error)
                else:
                    turn.expire()
