"""Bus time of frames and of SDO transfers, computed beforehand: an upper bound, with the worst stuffing (ISO 11898-1).

Predicts load and cycle times. The simulated bus computes the exact length of each frame, bit by bit, with code of its own.
"""

from __future__ import annotations

from drivers.canopen.sdo_transfer import MAX_BLOCK, SEGMENT
from drivers.canopen.table_map import TableMap
from drivers.correction_table import PLACES, RawTable
from drivers.raw_parameters import WireTime

SDO_BYTES = 8
"""Data of each frame of an SDO transfer."""


def frame_bits(data_bytes: int) -> int:
    """Most bits of a base-format data frame with its interframe space: 47 + 8 n, and floor((33 + 8 n) / 4) stuff bits."""
    return 47 + 8 * data_bytes + (33 + 8 * data_bytes) // 4


def transfer(size: int, bitrate: int) -> WireTime:
    """An upload or download of `size` bytes, expedited or segmented (CiA-301): each request has its answer. bitrate: bit/s."""
    answers = 1 if 0 < size <= 4 else 1 + max(1, -(-size // SEGMENT))
    return WireTime(2 * answers, 2 * answers * frame_bits(SDO_BYTES) / bitrate, answers)


def table_s(table_map: TableMap, table: RawTable, bitrate: int) -> float:
    """Time for writing a drive's own correction table and reading it back, s; without the switch, and as if it were empty before.

    The drive's processing time is not included. bitrate: bit/s.
    """
    singles = sum(name in table_map.scalars for name in PLACES)
    if table_map.domain is None:
        singles += 1 + len(table_map.columns) * len(table.plus)  # 1: the count
        frames = 4 * singles
    else:
        frames = 4 * singles + 2 * _block_frames(len(table.plus) * sum(kind.size for _, kind in table_map.record))
    return frames * frame_bits(SDO_BYTES) / bitrate


def _block_frames(size: int) -> int:
    """Frames of a block transfer in either direction: initiation, segments with one acknowledgement for each block, the end."""
    segments = max(1, -(-size // SEGMENT))
    return 4 + segments + -(-segments // MAX_BLOCK)
