"""What a display or gauge on a serial line says, one line a value: the events, and what makes them.

A protocol file turns bytes into these; `gauge` joins one to a port and a clock.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from drivers.instruments.lines import BadLine

__all__ = ["BadLine", "Fault", "Value", "ValueEvent", "ValueProtocol"]


class Value(NamedTuple):
    """A position as the instrument counts it, in mm."""

    position_mm: float


class Fault(NamedTuple):
    """The instrument says that it has no value; `reason` for a person."""

    reason: str


ValueEvent = Value | Fault | BadLine


class ValueProtocol(Protocol):
    """Bytes in, events out; raises nothing, whatever arrives, and keeps a bounded number of bytes."""

    @property
    def request(self) -> bytes:
        """What asks for one value; empty for an instrument that sends by itself."""

    def restart(self) -> None:
        """Forget what is unfinished: the wire was silent, or is another one."""

    def feed(self, data: bytes) -> list[ValueEvent]:
        """Events that are complete with these bytes, in order."""
