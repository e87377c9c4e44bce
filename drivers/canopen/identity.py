"""Identity of a CANopen node and its status objects beside the motion: read over SDO, never written."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.canopen import objects
from drivers.canopen.objects import Entry
from drivers.canopen.parameters import ON_COMMAND
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError, ProtocolError

PROFILE = 402
NO_PROFILE = 0
"""1000h of a device that names no profile, or lacks the object: the statusword 6041h tells a drive then."""


@dataclass(frozen=True)
class Identity:
    """Identity objects 1018h and 1008h to 100Ah."""

    vendor_id: int
    product_code: int
    revision: int
    serial: int
    device_name: str
    hardware: str
    software: str


def read_identity(sdo: SdoClient) -> Identity:
    """Identity of a servo drive. Raises ProtocolError for a node of another device profile (1000h), and as `SdoClient.read`."""
    profile = sdo.read_if_shown(objects.DEVICE_TYPE, 0) & 0xFFFF
    if profile not in (PROFILE, NO_PROFILE):
        raise ProtocolError(f"{sdo.name}: node {sdo.node_id} has device profile {profile}, not {PROFILE}")
    try:
        sdo.read(objects.STATUSWORD)
    except AbortError as error:
        raise ProtocolError(f"{sdo.name}: node {sdo.node_id} is no drive of profile {PROFILE}: {error}") from error
    return Identity(
        sdo.read_if_shown(objects.VENDOR_ID, 0),
        sdo.read_if_shown(objects.PRODUCT_CODE, 0),
        sdo.read_if_shown(objects.REVISION, 0),
        sdo.read_if_shown(objects.SERIAL_NUMBER, 0),
        _text(sdo, objects.DEVICE_NAME),
        _text(sdo, objects.HARDWARE_VERSION),
        _text(sdo, objects.SOFTWARE_VERSION),
    )


def _text(sdo: SdoClient, entry: Entry) -> str:
    try:
        return sdo.read_text(entry)
    except AbortError:
        return ""


def stores_on_command(sdo: SdoClient) -> bool:
    """Whether 1010h:1 says that it stores on command; False for a drive that does not let it be read."""
    return bool(sdo.read_if_shown(objects.STORE_ALL, 0) & ON_COMMAND)
