"""Device configurations: the DCF of CiA-306, an EDS with the values of one device, and the concise DCF of CiA-302.

A DCF is read like an EDS (`eds.load_eds`), whose entries then carry a `value`. The concise form (object 1F22h) is a set of objects as
one block of bytes, little endian: u32 number of entries; of each u16 index, u8 sub-index, u32 size, and that many bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.canopen.eds import Key, decode_eds, load_eds
from drivers.canopen.eds_text import parse
from drivers.errors import InputError

_COUNT, _HEAD = struct.Struct("<I"), struct.Struct("<HBI")  # of the concise form


def render_dcf(
    eds: Path,
    values: Sequence[tuple[Key, bytes]],
    node_id: int | None,
    *,
    model: Mapping[str, int | str] | None = None,
) -> str:
    """The text of a DCF: every section of the EDS as it was read, with ParameterValue where a value (as on the wire) is given.

    model: vendor_id and product_code of the device whose values these are; they stand in its head and in 1018h, whatever the EDS says.
    Raises InputError for an object that the EDS does not have, or a value that is not of its type.
    """
    entries = load_eds(eds, node_id).entries
    sections = parse(decode_eds(eds)).sections
    for key, data in values:
        found = entries.get(key)
        if found is None:
            raise InputError(f"has no object {key[0]:04X}h:{key[1]:02X}", path=eds)
        section = sections.get(f"{key[0]:04X}sub{key[1]:X}") or sections.get(f"{key[0]:04X}")
        if section is None:
            raise InputError(f"has no section of {found.entry}", path=eds)
        value = found.entry.unpack(data)
        section["ParameterValue"] = (
            str(int(value)) if isinstance(value, bool) else value.hex() if isinstance(value, bytes) else str(value)
        )
    for number, (name, written) in enumerate(
        (("vendor_id", "VendorNumber"), ("product_code", "ProductNumber")), start=1
    ):
        told = None if model is None else model.get(name)
        if isinstance(told, int):
            sections.setdefault("DeviceInfo", {})[written] = f"0x{told:X}"
            if (0x1018, number) in entries:
                sections[f"1018sub{number}"]["ParameterValue"] = f"0x{told:X}"
    commissioning = sections.setdefault("DeviceComissioning", {})  # the standard's spelling
    if node_id is not None:
        commissioning["NodeID"] = str(node_id)
    lines = []
    for name, keys in sections.items():
        lines += [f"[{name}]", *(f"{key}={value}" for key, value in keys.items()), ""]
    return "\n".join(lines)


def pack_concise(objects: Sequence[tuple[Key, bytes]]) -> bytes:
    """Concise DCF of objects in the order in which they are to be written."""
    parts = [_COUNT.pack(len(objects))]
    for (index, subindex), data in objects:
        parts.append(_HEAD.pack(index, subindex, len(data)) + data)
    return b"".join(parts)


def unpack_concise(data: bytes) -> list[tuple[Key, bytes]]:
    """The objects of a concise DCF, in order. Raises InputError for a block that is cut short or too long."""
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
