"""The SDO channels of several nodes kept busy at once, each with work of its own.

One node has one channel and answers one request at a time; while it thinks, the bus is free for the others. `CanLine.run` sends a
node's next request the moment its answer has come, so that many nodes are limited by the bus and not by the slowest drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from drivers.canopen.bus import CanLink
from drivers.canopen.sdo import Running
from drivers.clock import NS_PER_S
from drivers.errors import BridgeError, LinkLostError, StateError
from drivers.raw_parameters import Line, Steps

T = TypeVar("T")


@dataclass
class _Turn:
    """A transfer under way. seen: frames heard when its time was last set; until_ns: when that is over."""

    running: Running[Any]
    seen: int
    until_ns: int


class CanLine(Line):
    """A CAN bus. Steps on it yield `Running`s, each of another node's channel than those of the others."""

    def __init__(self, link: CanLink) -> None:
        self.link = link
        self.lost = False  # our own end of the bus

    def run(self, jobs: Sequence[Steps[T]]) -> list[T | BridgeError]:
        results: dict[int, T | BridgeError] = {}
        turns: dict[int, _Turn] = {}
        try:
            for number in range(len(jobs)):
                self._advance(number, jobs, turns, results)
            while turns:
                self._await(turns)
                for number in [number for number, turn in turns.items() if turn.running.finished]:
                    turns.pop(number).running.client.end()
                    self._advance(number, jobs, turns, results)
        finally:
            for turn in turns.values():  # somebody interrupted us
                turn.running.client.end()
        return [results[number] for number in range(len(jobs))]

    def _advance(
        self, number: int, jobs: Sequence[Steps[T]], turns: dict[int, _Turn], results: dict[int, T | BridgeError]
    ) -> None:
        """Let one job go on until its next transfer is under way, or it has ended."""
        while True:
            try:
                running = next(jobs[number])
            except StopIteration as stop:
                results[number] = stop.value
                return
            except BridgeError as error:
                results[number] = error
                return
            if not isinstance(running, Running):
                raise StateError(f"{type(running).__name__} is no work for a CAN bus")
            if self._begin(running):
                turns[number] = _Turn(running, running.client.progress, self._deadline_ns(running))
                return

    def _begin(self, running: Running[Any]) -> bool:
        """Send a transfer's first frame; False when it has ended already."""
        try:
            running.client.begin(running)
        except BridgeError as error:
            self._fail(running, error)
        if running.finished:
            running.client.end()
        return not running.finished

    def _fail(self, running: Running[Any], error: BridgeError) -> None:
        self.lost |= isinstance(error, LinkLostError)
        running.error, running.finished = error, True

    def _deadline_ns(self, running: Running[Any]) -> int:
        return self.link.clock.now_ns() + round(running.timeout_s * NS_PER_S)

    def _await(self, turns: dict[int, _Turn]) -> None:
        """Wait until a transfer has ended; those that were silent for too long are ended."""
        waiting = [turn.running for turn in turns.values()]

        def ended() -> bool:
            return any(running.finished for running in waiting)

        first_ns = min(turn.until_ns for turn in turns.values())
        left_ns = first_ns - self.link.clock.now_ns()
        try:
            if left_ns <= 0:
                self.link.poll()  # somebody kept us, and answers may lie there
            if self.link.wait(ended, max(0, left_ns) / NS_PER_S):
                return
        except LinkLostError as error:
            for running in waiting:
                self._fail(running, error)
            return
        now_ns = max(first_ns, self.link.clock.now_ns())  # it was waited for, even where the clock is not the bus's own
        for turn in turns.values():
            if now_ns < turn.until_ns:
                continue
            if turn.running.client.progress != turn.seen:  # it moves: segments, or somebody was waited for meanwhile
                turn.seen, turn.until_ns = turn.running.client.progress, self._deadline_ns(turn.running)
                continue
            turn.running.client.end()  # tells the server, and leaves a NoAnswerError
