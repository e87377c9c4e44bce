"""Events of a procedure, as a terminal, a screen or a test receives them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """One point of the measurement's graph. series: name of the curve; x, y: in the units that the procedure states."""

    series: str
    x: float
    y: float


@dataclass(frozen=True)
class Measured:
    """A result, such as the lost motion of one reversal. value: in `unit`, None where it could not be determined."""

    name: str
    value: float | None
    unit: str


@dataclass(frozen=True)
class Event:
    """Progress, a message or a result.

    stage: the running step, such as "measure" or "verify, round 2"; done, total: its points (0 of 0: not countable)
    found: the point or result just measured; warning: the message is a warning
    """

    stage: str
    message: str = ""
    done: int = 0
    total: int = 0
    found: Point | Measured | None = None
    warning: bool = False


Listener = Callable[[Event], None]


def silent(_event: Event) -> None:
    """A listener that drops the event."""
