"""Abort codes of SDO transfers and their meanings (CiA 301, table 22)."""

from __future__ import annotations

ABORT_TEXTS: dict[int, str] = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "SDO protocol timed out",
    0x05040001: "command specifier not valid or unknown",
    0x05040002: "invalid block size",
    0x05040003: "invalid sequence number",
    0x05040004: "CRC error",
    0x05040005: "out of memory",
    0x06010000: "unsupported access to an object",
    0x06010001: "attempt to read a write-only object",
    0x06010002: "attempt to write a read-only object",
    0x06020000: "object does not exist",
    0x06040041: "object cannot be mapped to the PDO",
    0x06040042: "mapped objects would exceed the PDO length",
    0x06040043: "general parameter incompatibility",
    0x06040047: "general internal incompatibility in the device",
    0x06060000: "access failed due to a hardware error",
    0x06070010: "data type does not match, length of parameter does not match",
    0x06070012: "data type does not match, parameter too long",
    0x06070013: "data type does not match, parameter too short",
    0x06090011: "sub-index does not exist",
    0x06090030: "invalid value for parameter",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x06090036: "maximum is less than minimum",
    0x060A0023: "resource not available: SDO connection",
    0x08000000: "general error",
    0x08000020: "data cannot be transferred or stored",
    0x08000021: "data cannot be transferred or stored because of local control",
    0x08000022: "data cannot be transferred or stored because of the present device state",
    0x08000023: "no object dictionary is present",
    0x08000024: "no data available",
}
ABORT_TOGGLE = 0x05030000
ABORT_TIMEOUT = 0x05040000
ABORT_COMMAND = 0x05040001
ABORT_SEQUENCE = 0x05040003
ABORT_CRC = 0x05040004
ABORT_MEMORY = 0x05040005
ABORT_READ_ONLY = 0x06010002
ABORT_LENGTH = 0x06070010
ABORT_VALUE = 0x06090030
ABORT_GENERAL = 0x08000000


def abort_text(code: int) -> str:
    """Meaning and number of an abort code (CiA-301, table 22)."""
    return f"{ABORT_TEXTS.get(code, 'unknown abort code')} (0x{code:08X})"
