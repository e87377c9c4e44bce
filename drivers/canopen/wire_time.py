"""Bus time of frames, computed beforehand: an upper bound, with the worst stuffing (ISO 11898-1).

Predicts load and cycle times. The simulated bus computes the exact length of each frame, bit by bit, with code of its own.
"""

from __future__ import annotations

SDO_BYTES = 8
"""Data of each frame of an SDO transfer."""


def frame_bits(data_bytes: int) -> int:
    """Most bits of a base-format data frame with its interframe space: 47 + 8 n, and floor((33 + 8 n) / 4) stuff bits."""
    return 47 + 8 * data_bytes + (33 + 8 * data_bytes) // 4
