"""The concise device configuration of CiA-302 (object 1F22h): a set of objects as one block of bytes.

Little endian: u32 number of entries; of each u16 index, u8 sub-index, u32 size, and that many bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.canopen.eds import Key
from drivers.errors import InputError

_COUNT, _HEAD = struct.Struct("<I"), struct.Struct("<HBI")


def pack_concise(objects: Sequence[tuple[Key, bytes]]) -> bytes:
    """Objects in the order in which they are to be written."""
    parts = [_COUNT.pack(len(objects))]
    for (index, subindex), data in objects:
        parts.append(_HEAD.pack(index, subindex, len(data)) + data)
    return b"".join(parts)


def unpack_concise(data: bytes) -> list[tuple[Key, bytes]]:
    """Raises InputError for a block that is cut short, or goes on behind its last entry."""
    if len(data) < _COUNT.size:
        raise InputError(f"is {len(data)} bytes, expected a concise DCF, which begins with four")
    (count,) = _COUNT.unpack_from(data)
    place = _COUNT.size
    objects: list[tuple[Key, bytes]] = []
    for number in range(1, count + 1):
        if place + _HEAD.size > len(data):
            raise InputError(f"is cut short in entry {number} of {count}")
        index, subindex, size = _HEAD.unpack_from(data, place)
        place += _HEAD.size
        if place + size > len(data):
            raise InputError(f"is cut short in entry {number} of {count}, {index:04X}h:{subindex:02X}")
        objects.append(((index, subindex), data[place : place + size]))
        place += size
    if place != len(data):
        raise InputError(f"has {len(data) - place} bytes behind its {count} entries")
    return objects
