"""A device configuration file (CiA-306): the maker's EDS with the values of one device.

What may go in: writing one. It is read like an EDS (`eds.load_eds`), whose entries then carry a `value`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from drivers.canopen.eds import Key, decode_eds, load_eds
from drivers.canopen.eds_text import parse
from drivers.errors import InputError


def render_dcf(eds: Path, values: Sequence[tuple[Key, bytes]], node_id: int | None, bitrate: int | None = None) -> str:
    """The text of a DCF: every section of the EDS as it was read, with ParameterValue where a value (as on the wire) is given.

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
    commissioning = sections.setdefault("DeviceComissioning", {})  # the standard's spelling
    if node_id is not None:
        commissioning["NodeID"] = str(node_id)
    if bitrate is not None:
        commissioning["Baudrate"] = str(bitrate // 1000)
    lines = []
    for name, keys in sections.items():
        lines += [f"[{name}]", *(f"{key}={value}" for key, value in keys.items()), ""]
    return "\n".join(lines)
