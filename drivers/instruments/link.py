"""ByteLink: what an instrument needs of its wire, bytes that have arrived, without waiting. `SerialLink` implements it."""

from __future__ import annotations

from typing import Protocol

from drivers.clock import NS_PER_S, Clock
from drivers.errors import LinkLostError

RETRY_S = 0.5
"""Interval at which a lost port is tried again, s."""


class ByteLink(Protocol):
    """A wire that is polled and never waited for."""

    def open(self) -> None:
        """Open it. Raises LinkLostError when it cannot be opened."""

    def close(self) -> None:
        """Never raises."""

    def read_waiting(self) -> bytes:
        """The bytes that have arrived, possibly none. Raises LinkLostError when the wire is lost."""


class AskedLink(ByteLink, Protocol):
    """A wire that also takes requests."""

    def write(self, data: bytes) -> None:
        """Send bytes. Raises LinkLostError when the wire is lost."""


class PatientLink:
    """A wire that may be unplugged and plugged in again: every access raises LinkLostError until it has been opened again.

    The reader learns of the gap from that error; it then has to discard unfinished data and to expect another zero.
    """

    def __init__(self, link: AskedLink, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._lost: LinkLostError | None = None
        self._retry_ns = 0

    def open(self) -> None:
        self._link.open()
        self._lost = None

    def close(self) -> None:
        self._link.close()
        self._lost = None

    def read_waiting(self) -> bytes:
        if self._lost is not None:
            self._look_for_it(self._lost)
        try:
            return self._link.read_waiting()
        except LinkLostError as error:
            raise self._gone(error) from error

    def write(self, data: bytes) -> None:
        if self._lost is not None:
            raise self._lost
        try:
            self._link.write(data)
        except LinkLostError as error:
            raise self._gone(error) from error

    def _gone(self, error: LinkLostError) -> LinkLostError:
        self._link.close()
        self._lost = LinkLostError(str(error))
        self._retry_ns = self._clock.now_ns() + round(RETRY_S * NS_PER_S)
        return self._lost

    def _look_for_it(self, lost: LinkLostError) -> None:
        now_ns = self._clock.now_ns()
        if now_ns < self._retry_ns:
            raise lost
        self._retry_ns = now_ns + round(RETRY_S * NS_PER_S)
        try:
            self._link.open()
        except LinkLostError:
            raise lost from None
        self._lost = None
