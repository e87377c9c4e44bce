"""Events of a display or gauge on a serial line, one line per value, and the protocol interface that produces them.

A protocol module turns bytes into events; `gauge` connects it to a port and a clock.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from drivers.instruments.lines import BadLine

__all__ = ["BadLine", "Fault", "Value", "ValueEvent", "ValueProtocol"]


class Value(NamedTuple):
    """A position as the instrument counts it, mm."""

    position_mm: float


class Fault(NamedTuple):
    """The instrument reports that it has no value; `reason` as text."""

    reason: str


ValueEvent = Value | Fault | BadLine


class ValueProtocol(Protocol):
    """Bytes in, events out. Raises nothing, whatever arrives, and keeps a bounded number of bytes."""

    @property
    def request(self) -> bytes:
        """The bytes that ask for one value; empty for an instrument that sends by itself."""

    def restart(self) -> None:
        """Discard what is unfinished: the wire was silent, or is another one."""

    def feed(self, data: bytes) -> list[ValueEvent]:
        """Events completed by these bytes, in order."""
