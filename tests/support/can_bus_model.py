"""Duration of CAN frames: exact bit counts with stuffing and CRC (ISO 11898-1, base format), bus load, wire time.

Pure functions; written apart from `drivers.canopen.wire_time`, which predicts the same.
"""

from __future__ import annotations

from functools import lru_cache

CRC15 = 0x4599
TAIL_BITS = 1 + 2 + 7  # CRC delimiter, ACK slot and delimiter, end of frame: never stuffed
INTERFRAME_BITS = 3


def _frame_head(identifier: int, data: bytes) -> list[int]:
    """The bits to which stuffing applies, before the CRC: SOF, identifier, RTR, IDE, r0, DLC, data."""
    bits = [0]
    bits += [identifier >> place & 1 for place in range(10, -1, -1)]
    bits += [0, 0, 0]
    bits += [len(data) >> place & 1 for place in range(3, -1, -1)]
    for byte in data:
        bits += [byte >> place & 1 for place in range(7, -1, -1)]
    return bits


def crc15(bits: list[int]) -> int:
    """CAN's CRC over unstuffed bits: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, start 0 (ISO 11898-1)."""
    register = 0
    for bit in bits:
        feed = bit ^ (register >> 14)
        register = register << 1 & 0x7FFF
        if feed:
            register ^= CRC15
    return register


def stuff_bits(bits: list[int]) -> int:
    """Number of bits that stuffing inserts: one after each five equal ones, inserted ones included."""
    inserted = 0
    previous, run = -1, 0
    for bit in bits:
        if bit == previous:
            run += 1
        else:
            previous, run = bit, 1
        if run == 5:
            inserted += 1
            previous, run = 1 - bit, 1
    return inserted


@lru_cache(maxsize=65536)
def frame_bits(identifier: int, data: bytes) -> int:
    """Exact length of a base-format frame on the wire in bits, with the interframe space."""
    head = _frame_head(identifier, data)
    crc = crc15(head)
    covered = head + [crc >> place & 1 for place in range(14, -1, -1)]
    return len(covered) + stuff_bits(covered) + TAIL_BITS + INTERFRAME_BITS


def wire_time_ns(identifier: int, data: bytes, bitrate: int) -> int:
    """Time on the bus, ns, at `bitrate` bit/s."""
    return frame_bits(identifier, data) * 1_000_000_000 // bitrate
