"""The parameters of a drive as a list for a person, and the set that changes one of them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime

from drivers.errors import InputError
from drivers.parameters import ParameterInfo, ParameterKind, ParameterValue
from drivers.raw_parameters import DriveIdentity
from hil.parameters.report import shown
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.snapshot import Backup


def titled(address: str, name: str) -> str:
    """A parameter by its address and its name, which for a register are one."""
    return " ".join(filter(None, dict.fromkeys((address, name))))


@dataclass(frozen=True)
class ListedParameter:
    """One parameter. entry: as it was read, without a value where it could not be read; error: why; refusal: why it is never written,
    "" for one that may be."""

    entry: SetEntry
    info: ParameterInfo
    refusal: str = ""
    error: str = ""

    @property
    def title(self) -> str:
        """Address and name."""
        return titled(self.entry.address, self.info.name)

    @property
    def value(self) -> str:
        """The value as text; bytes as hexadecimal digits."""
        return shown(self.entry.raw if self.entry.value is None else self.entry.value)

    @property
    def limits(self) -> str:
        """The allowed range as text, "" without limits."""
        low, high = (shown(end) if end is not None else "" for end in (self.info.low, self.info.high))
        return f"{low} … {high}" if low or high else ""

    def has(self, words: str) -> bool:
        """Whether address, name, value or unit contain each of the words, in capitals or not."""
        own = " ".join((self.entry.address, self.info.name, self.value, self.entry.unit)).casefold()
        return all(word in own for word in words.casefold().split())


@dataclass(frozen=True)
class Listing:
    """All parameters that a drive shows, in its order. at: when they were read."""

    at: datetime
    identity: DriveIdentity | None
    parameters: tuple[ListedParameter, ...]


def listing_of(backup: Backup) -> Listing:
    """The list of a complete backup (`everything`). Raises InputError for one that failed."""
    drive, contents, unreadable = backup.drive, backup.contents, backup.unreadable or {}
    if contents is None:
        raise InputError(f"the parameters of drive {drive.name} cannot be listed: {backup.error}")
    read = {entry.address: entry for entry in contents.entries}
    listed = []
    for address, parameter in drive.entries.items():
        empty = SetEntry(address, None, None, parameter.type, drive.unit_of(parameter), parameter.info.name)
        entry = read.get(address, empty)
        listed.append(ListedParameter(entry, parameter.info, parameter.refusal or "", unreadable.get(address, "")))
    return Listing(datetime.now().astimezone(), contents.identity, tuple(listed))


def changed(listing: Listing, parameter: ListedParameter, typed: str) -> ParameterSet:
    """The set that gives one parameter a typed value, for the drive that was listed.

    Whether the value fits type and limits is checked by the download. Raises InputError for a parameter that is not written, and for
    what is no value of its kind.
    """
    entry, name = parameter.entry, parameter.title
    if parameter.refusal:
        raise InputError(f"{name}: {parameter.refusal}")
    value = _value(parameter.info.kind, typed.strip())
    if value is None:
        raise InputError(f"{name} is to be {typed.strip()!r}, expected a {parameter.info.kind.value}")
    new = SetEntry(entry.address, value, None, entry.type, entry.unit, entry.name)
    return ParameterSet(name, listing.identity, (new,))


def _value(kind: ParameterKind, typed: str) -> ParameterValue | None:
    """None for what is no value of this kind. A whole number may be hexadecimal."""
    if kind in (ParameterKind.TEXT, ParameterKind.BYTES):
        return typed
    with suppress(ValueError):
        return int(typed, 0)
    with suppress(ValueError):
        return float(typed) if kind is ParameterKind.NUMBER else None
    return None
