"""Bus load of SDO transfers, computed beforehand: their frames with contents, and the bits of each.

The frames of a transfer are those of CiA-301, the bits those of ISO 11898-1. The simulated bus counts separately
(`sim_backends.can_bus_model`) and shares no code with this.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from drivers.canopen.sdo_transfer import MAX_BLOCK, SEGMENT, multiplexer
from drivers.canopen.table_map import TableMap
from drivers.canopen.wire_time import BitRange, expedited_sdo, frame, frames
from drivers.correction_table import RawTable
from drivers.raw_parameters import WireTime

Frame = tuple[bool, bytes]
"""(whether it is the server's, its data)"""
_PLACES = ("origin", "step", "backlash")

_CRC_POLYNOMIAL = 0b1100010110011001  # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
_UNSTUFFED = 10 + 3  # from the CRC delimiter to the end of frame, and the interframe space


def upload_frames(index: int, subindex: int, data: bytes) -> list[Frame]:
    """Frames of an expedited or segmented upload that brings `data`."""
    mux = multiplexer(index, subindex)
    frames: list[Frame] = [(False, b"\x40" + mux + bytes(4))]
    if 0 < len(data) <= 4:
        return [*frames, (True, bytes((0x43 | (4 - len(data)) << 2,)) + mux + data.ljust(4, b"\0"))]
    frames.append((True, b"\x41" + mux + struct.pack("<I", len(data))))
    for number, part in enumerate(_segments(data)):
        toggle, last = number % 2 << 4, (number + 1) * SEGMENT >= len(data)
        frames.append((False, bytes((0x60 | toggle,)) + bytes(7)))
        frames.append((True, bytes((toggle | (SEGMENT - len(part)) << 1 | last,)) + part.ljust(SEGMENT, b"\0")))
    return frames


def download_frames(index: int, subindex: int, data: bytes) -> list[Frame]:
    """Frames of an expedited or segmented download of `data`."""
    mux = multiplexer(index, subindex)
    taken: Frame = (True, b"\x60" + mux + bytes(4))
    if 0 < len(data) <= 4:
        return [(False, bytes((0x23 | (4 - len(data)) << 2,)) + mux + data.ljust(4, b"\0")), taken]
    frames: list[Frame] = [(False, b"\x21" + mux + struct.pack("<I", len(data))), taken]
    for number, part in enumerate(_segments(data)):
        toggle, last = number % 2 << 4, (number + 1) * SEGMENT >= len(data)
        frames.append((False, bytes((toggle | (SEGMENT - len(part)) << 1 | last,)) + part.ljust(SEGMENT, b"\0")))
        frames.append((True, bytes((0x20 | toggle,)) + bytes(7)))
    return frames


def _segments(data: bytes) -> list[bytes]:
    return [data[start : start + SEGMENT] for start in range(0, max(len(data), 1), SEGMENT)]


def wire_time(node_id: int, frames: Iterable[Frame], bitrate: int) -> WireTime:
    """The cost of frames between a node's default SDO channel and its master, at `bitrate` bit/s."""
    total = WireTime()
    for server, data in frames:
        bounds = frame(len(data))
        likely = exact_bits((0x580 if server else 0x600) + node_id, data)
        least, most = bounds.least, bounds.most
        total = total + WireTime(
            1, least, likely, most, least / bitrate, likely / bitrate, most / bitrate, answers=int(server)
        )
    return total


def table_bits(table_map: TableMap, table: RawTable) -> BitRange:
    """Bits for writing a drive's own correction table and reading it back; without the switch, and as if the table were empty before.

    The drive's processing time is not included.
    """
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
    """Bits of a block transfer in either direction: initiation, segments with one acknowledgement for each block, the end."""
    segments = max(1, -(-size // SEGMENT))
    blocks = -(-segments // MAX_BLOCK)
    return expedited_sdo() + frames((8,) * (segments + blocks)) + expedited_sdo()


def exact_bits(cob_id: int, data: bytes) -> int:
    """Length in bits of a base-format data frame with its stuff bits and the interframe space (ISO 11898-1)."""
    head = f"0{cob_id:011b}000{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    return len(_stuffed(head + f"{_remainder(head):015b}")) + _UNSTUFFED


def _remainder(bits: str) -> int:
    """Remainder of the bits as a polynomial, shifted by 15, divided by CAN's."""
    dividend = int(bits, 2) << 15
    while (excess := dividend.bit_length() - 16) >= 0:
        dividend ^= _CRC_POLYNOMIAL << excess
    return dividend


def _stuffed(bits: str) -> str:
    """The bits with the opposite bit inserted after every five equal ones."""
    sent = ""
    for bit in bits:
        if sent[-5:] == (same := sent[-1:] * 5) and same:
            sent += "1" if sent[-1] == "0" else "0"
        sent += bit
    if sent[-5:] == sent[-1] * 5:
        sent += "1" if sent[-1] == "0" else "0"
    return sent
