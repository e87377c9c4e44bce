"""One stream of events from every procedure; a terminal, a screen or a test listens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """One point of the measurement's graph. series: the curve it belongs to; x, y: as the procedure states them"""

    series: str
    x: float
    y: float


@dataclass(frozen=True)
class Measured:
    """A figure that stands from now on, such as the lost motion of one reversal. None: it could not be had"""

    name: str
    value: float | None
    unit: str


@dataclass(frozen=True)
class Event:
    """Something a person watching would want to know.

    stage: the step now running, such as "measure" or "verify, round 2"; done and total count its points (0 of 0: not countable)
    found: what has just been measured; warning: the message is one that nobody may miss
    """

    stage: str
    message: str = ""
    done: int = 0
    total: int = 0
    found: Point | Measured | None = None
    warning: bool = False


Listener = Callable[[Event], None]


def silent(_event: Event) -> None:
    """A listener that does not listen."""
