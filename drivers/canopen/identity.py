"""Identity of a CANopen node and its status objects beside the motion: read over SDO, never written."""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.canopen import cia301
from drivers.canopen.sdo import SdoClient
from drivers.cia402 import objects
from drivers.errors import AbortError, ProtocolError

PROFILE = 402
NO_PROFILE = 0
"""1000h of a device that names no profile, or lacks the object: the statusword 6041h tells a drive then."""


@dataclass(frozen=True)
class Identity:
    """Of 1018h; 0 for what the node does not show."""

    vendor_id: int
    product_code: int
    serial: int


def read_identity(sdo: SdoClient) -> Identity:
    """Identity of a servo drive. Raises ProtocolError for a node of another device profile (1000h), and as `SdoClient.read`."""
    profile = sdo.read_if_shown(cia301.DEVICE_TYPE, 0) & 0xFFFF
    if profile not in (PROFILE, NO_PROFILE):
        raise ProtocolError(f"{sdo.name}: node {sdo.node_id} has device profile {profile}, not {PROFILE}")
    try:
        sdo.read(objects.STATUSWORD)
    except AbortError as error:
        raise ProtocolError(f"{sdo.name}: node {sdo.node_id} is no drive of profile {PROFILE}: {error}") from error
    return Identity(
        sdo.read_if_shown(cia301.VENDOR_ID, 0),
        sdo.read_if_shown(cia301.PRODUCT_CODE, 0),
        sdo.read_if_shown(cia301.SERIAL_NUMBER, 0),
    )


UNIT_OBJECTS = (
    *((index, subindex) for index in (0x608F, 0x6091, 0x6092, 0x6093) for subindex in (1, 2)),
    (0x607E, 0),
    (0x60A8, 0),
)
"""Encoder resolution, gear ratio, feed constant, position factor (of drives by the older DSP 402), polarity, unit of position."""


def unit_objects(sdo: SdoClient) -> dict[str, int]:
    """The unit objects that the drive has, such as "6091h:01", as whole numbers. Raises as `SdoClient.read_bytes`."""
    found = {}
    for index, subindex in UNIT_OBJECTS:
        try:
            data = sdo.read_bytes(index, subindex)
        except AbortError:
            continue
        found[f"{index:04X}h:{subindex:02X}"] = int.from_bytes(data, "little")
    return found


def object_of(name: str) -> tuple[int, int] | None:
    """(index, subindex) of "2201h" or "2201h:01"; None for what is no object."""
    match = re.fullmatch(r"([0-9A-Fa-f]{4})h(?::([0-9A-Fa-f]{2}))?", name)
    return None if match is None else (int(match[1], 16), int(match[2] or "0", 16))
