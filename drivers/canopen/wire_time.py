"""Bus time of frames, computed beforehand: the range without and with the worst stuffing (ISO 11898-1).

Predicts load and cycle times. The simulated bus computes the exact length of each frame, bit by bit, with code of its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class BitRange:
    """Number of bits on the wire, least and most."""

    least: int
    most: int

    def __add__(self, other: BitRange) -> BitRange:
        return BitRange(self.least + other.least, self.most + other.most)

    def time_ns(self, bitrate: int) -> tuple[int, int]:
        """(least, most) duration in ns at `bitrate` bit/s."""
        return self.least * NS_PER_S // bitrate, self.most * NS_PER_S // bitrate


def frame(data_bytes: int) -> BitRange:
    """A base-format data frame with its interframe space: 47 + 8 n bits, up to floor((33 + 8 n) / 4) stuff bits more."""
    plain = 47 + 8 * data_bytes
    return BitRange(plain, plain + (33 + 8 * data_bytes) // 4)


def frames(sizes: Iterable[int]) -> BitRange:
    """Several frames of the given numbers of data bytes."""
    total = BitRange(0, 0)
    for size in sizes:
        total = total + frame(size)
    return total


def expedited_sdo() -> BitRange:
    """Request and answer of one expedited transfer."""
    return frames((8, 8))
