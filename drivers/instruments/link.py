"""What an instrument needs of its wire: bytes that have arrived, without waiting. `SerialLink` is one; tests bring their own."""

from __future__ import annotations

from typing import Protocol


class ByteLink(Protocol):
    """A wire that is only ever looked at."""

    def open(self) -> None:
        """Raises LinkLostError when there is none."""

    def close(self) -> None:
        """Never raises."""

    def read_waiting(self) -> bytes:
        """What has arrived, possibly nothing. Raises LinkLostError when the wire is gone."""
