"""Objects that are no parameters: targets, commands, volatile values, and what is set up as a whole; told by a dictionary alone.

A target or command acts when it is written, so that a download of it would move the axis, zero a position or erase a store. Makers'
commands are told by write-only access, by the words of their EDS, and by a list with sources where words do not tell.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from drivers.canopen.eds import EdsEntry
from drivers.canopen.table_map import TableMap
from drivers.cia402.objects import DataType, Entry


class Kind(Enum):
    """What an object is instead of a parameter, in the plural of a list."""

    TARGET = "targets"
    COMMAND = "commands"
    VOLATILE = "volatile objects"
    READ_ONLY = "read-only objects"
    NODE = "objects that go with the node id"
    DOMAIN = "domains"
    TABLE = "objects of the drive's correction table"
    CHANNEL = "SDO channels"
    PDO = "PDO parameters"


@dataclass(frozen=True)
class Refusal:
    """Why an object is not written as a parameter. why: a sentence whose subject is the object."""

    kind: Kind
    why: str


MOTION_TARGETS: dict[int, str] = {
    0x6040: "controlword",
    0x6042: "target velocity of the velocity mode",
    0x6060: "mode of operation",
    0x6071: "target torque",
    0x607A: "target position",
    0x60B0: "position offset",
    0x60B1: "velocity offset",
    0x60B2: "torque offset",
    0x60B8: "touch probe function",
    0x60C1: "interpolation data",
    0x60FE: "digital outputs",
    0x60FF: "target velocity",
}
NOT_PARAMETERS: dict[int, str] = {
    0x1003: "error history",
    0x1010: "store parameters",
    0x1011: "restore parameters",
    0x1013: "high resolution time stamp",
    0x1014: "COB-ID EMCY, which goes with the node id",
    0x1020: "verify configuration",
    0x1023: "OS command",
    0x1024: "OS command mode",
    0x1025: "OS debugger interface",
    0x1026: "OS prompt",
    0x1F25: "configuration request",
    0x1F50: "program data",
    0x1F51: "program control",
    0x1F82: "request NMT",
    0x1F83: "request guarding",
}
_KINDS = {0x1003: Kind.VOLATILE, 0x1013: Kind.VOLATILE, 0x1020: Kind.VOLATILE, 0x1014: Kind.NODE}
SET_UP_AS_A_WHOLE: dict[range, tuple[Kind, str]] = {
    range(0x1200, 0x1300): (Kind.CHANNEL, "is the channel that parameters come by"),
    range(0x1400, 0x1C00): (Kind.PDO, "belongs to the PDO mapping, which is set up as a whole"),
}
MAKERS = range(0x2000, 0x6000)
"""The area that CiA 301 leaves to makers: only there an object's name decides."""
_AXIS = 0x800  # CiA 402-2: objects of the n-th axis in a node stand n · 800h behind those of the first, up to 9FFFh

COMMAND_WORDS = re.compile(
    r"""
      \bpreset\b(?!\ (value|mode|source|position|counter)\b)      # P-PRESET execution, ZSG-PRESET
    | \btrigger$                                                  # not: trigger mode, trigger level, trigger 1
    | ^clear(?=[A-Z\ _])| \bclear$                                # Clear alarm history, ClearIItExceededFlag
    | \breset\b(?!.*\b(time|delay|mode|option|level|condition|config\w*|source|value|input|type|after|behaviou?r)\b)
    | _reset$ | ^reset_
    | \bcommand\b(?!.*\b(source|filter|time|delay|mode|type|offset|gain|limit|scal\w*|smooth\w*|unit|select\w*)\b)
    | ^cmd_ | \bcontrol\ ?word\b | \bself[- ]?test$
    | \bexecut(e|ion)\b(?!\ (time|period))
    | ^(save|store|restore|load|erase|format|factory|default|initiali[sz]e)\b
      .*\b(all|param\w*|settings?|config\w*|defaults?|data|memory|reset)\b
    | \breboot\b(?!.*\b(time|delay)\b)
    | ^(\w{1,3}_)?start(?=[A-Z_])                                 # start_brake_test, Eu_StartFindPointFlag
    | \bjog\b(?!.*\b(speed|velocity|accel\w*|decel\w*|torque|limit|time|ramp|rate|mode|distance|travel|steps?|data|current)\b)
    """,
    re.VERBOSE | re.IGNORECASE,
)
BY_NAME: dict[tuple[range, str], Kind] = {
    # Oriental Motor BLV-R, source: EDS BLVD-KRD V200. 40C0h to 40D8h are its maintenance commands; the operation data of a direct data
    # operation start the motor once 4033h names them as its trigger (lowest value -7).
    (range(0x40C0, 0x40D9), "configuration"): Kind.COMMAND,
    (range(0x402C, 0x4033), "direct data operation"): Kind.TARGET,
    (range(0x4034, 0x4035), "direct data operation"): Kind.TARGET,
    (range(0x403D, 0x403E), "net selection data number"): Kind.COMMAND,
    # Nanotec, source: EDS of CL4/PD4 and N5; 2300h bit 0 starts the user's program.
    (range(0x2300, 0x2301), "nanoj control"): Kind.COMMAND,
}
"""(indices, beginning of the name in small letters) -> what it is."""


def why_not_written(found: EdsEntry, table: TableMap | None = None) -> str | None:
    """The sentence of `refusal` with the object's name; None for an entry that may be written."""
    refused = refusal(found, table)
    return None if refused is None else f"{found.entry} {refused.why}"


def refusal(found: EdsEntry, table: TableMap | None = None) -> Refusal | None:
    """Why an entry is not written as a parameter; None for one that may be. table: map of the drive's own correction table."""
    reason = _read_only(found) or _standards(found.entry) or _tables(found.entry, table) or _unreadable(found)
    reason = reason or _makers(found)
    return None if reason is None else Refusal(*reason)


Reason = tuple[Kind, str]


def _read_only(found: EdsEntry) -> Reason | None:
    return None if found.writable else (Kind.READ_ONLY, "is read only")


def _standards(entry: Entry) -> Reason | None:
    """By the standards' objects alone."""
    index = entry.index
    of_first_axis = index - (index - 0x6000) // _AXIS * _AXIS if 0x6000 <= index < 0xA000 else index
    if of_first_axis in MOTION_TARGETS:
        return Kind.TARGET, "moves the axis and is no parameter"
    if index in NOT_PARAMETERS:
        return _KINDS.get(index, Kind.COMMAND), "is a command, not a parameter"
    return None


def _tables(entry: Entry, table: TableMap | None) -> Reason | None:
    if table is not None and table.holds(entry.index, entry.subindex):
        return Kind.TABLE, "belongs to the drive's correction table, which is written as a whole (hil params table)"
    return next((reason for indices, reason in SET_UP_AS_A_WHOLE.items() if entry.index in indices), None)


def _unreadable(found: EdsEntry) -> Reason | None:
    if not found.readable:
        return Kind.COMMAND, "is write-only: a command, not a parameter, and it cannot be read back"
    if found.entry.type is DataType.DOMAIN:
        return Kind.DOMAIN, "is a domain, which is not read back as a parameter"
    return None


def _makers(found: EdsEntry) -> Reason | None:
    entry = found.entry
    if entry.index not in MAKERS:
        return None
    for (indices, begins), kind in BY_NAME.items():
        if entry.index in indices and entry.name.lower().startswith(begins):
            return kind, "is a command of its maker, not a parameter"
    if COMMAND_WORDS.search(entry.name):
        return Kind.COMMAND, "is a command by its name, not a parameter"
    return None
