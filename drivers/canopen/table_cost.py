"""What it costs on the bus to write a drive's own correction table and read it back, counted before it is done.

What may go in: the frames of such transfers by number and length, CiA-301 7.2.4. An answer's delay in the drive comes on top.
"""

from __future__ import annotations

from drivers.canopen.sdo_transfer import MAX_BLOCK, SEGMENT
from drivers.canopen.table_map import TableMap
from drivers.canopen.wire_time import BitRange, expedited_sdo, frames
from drivers.correction_table import RawTable

_PLACES = ("origin", "step", "backlash")


def table_bits(table_map: TableMap, table: RawTable) -> BitRange:
    """Everything written, and everything read back; without the switch, and as if nothing stood there yet."""
    singles = sum(name in table_map.scalars for name in _PLACES)
    if table_map.domain is None:
        singles += 1 + len(table_map.columns) * len(table.plus)  # 1: the count
        return frames((8, 8) * (2 * singles))
    size = len(table.plus) * sum(kind.size for _, kind in table_map.record)
    total = frames((8, 8) * (2 * singles))
    for _ in range(2):
        total = total + _block_transfer(size)
    return total


def _block_transfer(size: int) -> BitRange:
    """Either way: the beginning, segments with one acknowledgement for each block, the end, and what starts or closes an upload."""
    segments = max(1, -(-size // SEGMENT))
    blocks = -(-segments // MAX_BLOCK)
    return expedited_sdo() + frames((8,) * (segments + blocks)) + expedited_sdo()
