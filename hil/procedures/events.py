"""One stream of events from every procedure; a terminal, a screen or a test listens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Event:
    """Something a person watching would want to know.

    stage: the step now running, such as "measure" or "verify, round 2"; done and total count its points (0 of 0: not countable)
    """

    stage: str
    message: str = ""
    done: int = 0
    total: int = 0


Listener = Callable[[Event], None]


def silent(_event: Event) -> None:
    """A listener that does not listen."""
