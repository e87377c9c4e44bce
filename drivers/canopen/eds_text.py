"""Correction of the text of an EDS or DCF file: vendors' deviations from the standard (CiA-306).

Works on sections, keys and numbers as text: letter case, duplicates, stray lines, missing keys, orphans and compact arrays are
corrected here, and each deviation leaves a note. `eds` interprets the values.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from drivers.cia402.objects import DataType
from drivers.errors import InputError

TYPES = {data_type.code: data_type for data_type in DataType}
OBJECT = re.compile(r"^([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?$", re.IGNORECASE)
CANONICAL = {
    key.lower(): key
    for key in (
        "ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "ParameterValue", "LowLimit", "HighLimit",
        "PDOMapping", "SubNumber", "CompactSubObj", "StorageLocation", "NrOfEntries", "NodeID", "Baudrate", "VendorName",
        "VendorNumber", "ProductName", "ProductNumber", "RevisionNumber", "OrderCode", "Factor", "Unit", "Description",
    )
}  # fmt: skip
TYPE_NAMES = {"BOOLEAN": 0x01, "REAL32": 0x08, "REAL64": 0x11, "VISIBLE_STRING": 0x09, "OCTET_STRING": 0x0A} | {
    f"{name}{8 * kind.size}": kind.code
    for kind in DataType
    if kind.is_number and not kind.is_real and kind is not DataType.BOOLEAN
    for name in (("INTEGER" if kind.is_signed else "UNSIGNED"),)
}
ARRAY, RECORD = 0x08, 0x09
MAX_COMPACT = 254
MOST_MEMBERS = 1 << 14
"""Most members of all compact arrays of a file: 25 bytes of text make 254 of them."""
VALUES = ("DefaultValue", "ParameterValue")
LONGEST_SHOWN = 40
"""Longest text of a file that a note repeats, characters."""
PLACES_SHOWN = 3
"""Number of places that the summary names of each kind of deviation."""


@dataclass(frozen=True)
class Deviation:
    """One place where a file deviates from the standard. kind: what was made of it, in the same words for all of its kind; key: the
    key concerned, "" for the whole section or line."""

    place: str
    key: str
    shown: str
    kind: str

    def __str__(self) -> str:
        return f"{self.where} {self.kind}"

    @property
    def where(self) -> str:
        """Place, key and the text that stands there."""
        return " ".join(part for part in (self.place, self.key, self.shown) if part)


def summary(notes: Iterable[Deviation]) -> tuple[str, ...]:
    """One line for each kind of deviation, with its number and the first places."""
    kinds: dict[str, list[Deviation]] = {}
    for note in notes:
        kinds.setdefault(note.kind, []).append(note)
    lines = []
    for kind, found in kinds.items():
        more = f" and {len(found) - PLACES_SHOWN} more" if len(found) > PLACES_SHOWN else ""
        lines.append(", ".join(note.where for note in found[:PLACES_SHOWN]) + f"{more}: {kind}")
    return tuple(lines)


def quoted(text: str) -> str:
    """A text of the file as a note repeats it."""
    return repr(text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…")


@dataclass
class EdsText:
    """The file as sections of keys, in canonical spelling and order, with notes on the corrections."""

    sections: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[Deviation] = field(default_factory=list)

    def note(self, place: str, kind: str, key: str = "", shown: str | None = None) -> None:
        """Add a note; shown: the file's text there."""
        self.notes.append(Deviation(place, key, "" if shown is None else quoted(shown), kind))


def parse(text: str) -> EdsText:
    """Read any text; each deviation leaves a note. Raises InputError where compact arrays have more than `MOST_MEMBERS` members."""
    parsed = _parse(text)
    _complete(parsed)
    return parsed


def object_number(section: str) -> tuple[int, int | None] | None:
    """(index, sub-index or None) of an object's section, None for another section."""
    match = OBJECT.match(section)
    if match is None:
        return None
    return int(match.group(1), 16), None if match.group(2) is None else int(match.group(2), 16)


def _parse(text: str) -> EdsText:
    """Sections and keys of an INI-like text, nothing refused. Values keep what stands behind a semicolon: it may belong to a text."""
    parsed = EdsText()
    section: dict[str, str] | None = None
    where = ""
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        line = line.strip()  # noqa: PLW2901 - the unstripped line is not needed
        if not line or line[0] in ";#":
            continue
        if line.startswith("["):
            where = _section_name(line.split(";", 1)[0].strip("[] \t"))
            if where in parsed.sections:
                parsed.note(f"[{where}]", "stands there again, taken together")
            section = parsed.sections.setdefault(where, {})
            continue
        key, equals, value = line.partition("=")
        if not equals or section is None:
            parsed.note(f"line {number}", "is neither section nor key, skipped", shown=line)
            continue
        key = CANONICAL.get(key.strip().lower(), key.strip())
        value = value.strip() if key in VALUES else value.split(";", 1)[0].strip()
        if key in section and section[key] != value:
            parsed.note(f"[{where}]", "stands there again, the last one counts", key)
        section[key] = value
    return parsed


def _section_name(name: str) -> str:
    match = OBJECT.match(name.replace(" ", ""))
    if match is None:
        known = {"devicecomissioning": "DeviceComissioning", "devicecommissioning": "DeviceComissioning"}
        known |= {"deviceinfo": "DeviceInfo", "fileinfo": "FileInfo", "comments": "Comments"}
        compact = re.match(r"^([0-9a-f]{4})(name|value)$", name, re.IGNORECASE)
        if compact is not None:
            return f"{compact[1].upper()}{compact[2].capitalize()}"
        return known.get(name.lower(), name)
    index, subindex = match.groups()
    return index.upper() if subindex is None else f"{index.upper()}sub{int(subindex, 16):X}"


def _complete(parsed: EdsText) -> None:
    """Give every object section what the interpreter needs, expand compact arrays, add the objects of orphans."""
    if sum(_compact_members(keys.get("CompactSubObj")) for keys in parsed.sections.values()) > MOST_MEMBERS:
        raise InputError(f"holds compact arrays of more than {MOST_MEMBERS} members in all")
    with_members = {match.group(1) for match in map(OBJECT.match, parsed.sections) if match and match.group(2)}
    for name in list(parsed.sections):
        match = OBJECT.match(name)
        if match is None:
            continue
        keys = parsed.sections[name]
        if match.group(2) is not None and match.group(1) not in parsed.sections:
            parsed.sections[match.group(1)] = {"ParameterName": match.group(1), "ObjectType": "0x9"}
            parsed.note(f"[{name}]", "has no object, one was assumed")
        keys.setdefault("ParameterName", name)
        kind = whole_number(keys.get("ObjectType"))
        if kind not in (ARRAY, RECORD) and match.group(2) is None and name in with_members:
            keys["ObjectType"] = "0x9"
            parsed.note(f"[{name}]", "has sub-indices but is no record, taken as one")
        elif "ObjectType" in keys and kind is None:
            if keys["ObjectType"]:
                parsed.note(f"[{name}]", "is no number, taken as a variable", "ObjectType", keys["ObjectType"])
            keys["ObjectType"] = "0x7"
        _expand(name, keys, parsed)
        if whole_number(keys.get("ObjectType", "7")) not in (ARRAY, RECORD) or match.group(2) is not None:
            _complete_variable(name, keys, parsed)
    # a member has to come after its object
    ordered = sorted(parsed.sections, key=lambda name: (OBJECT.match(name) is not None, _order(name)))
    parsed.sections = {name: parsed.sections[name] for name in ordered}


def _order(name: str) -> tuple[int, int]:
    match = OBJECT.match(name)
    if match is None:
        return -1, -1
    return int(match.group(1), 16), -1 if match.group(2) is None else int(match.group(2), 16)


def _compact_members(text: str | None) -> int:
    """Number of members of a compact array; one too many counts as the most there can be, no such number as none."""
    count = whole_number(text) or 0
    return MAX_COMPACT if count == MAX_COMPACT + 1 else count if 0 < count <= MAX_COMPACT else 0


def _expand(name: str, keys: dict[str, str], parsed: EdsText) -> None:
    """CompactSubObj=n: n members like the array itself (CiA-306, 4.5.2.4); values in [iiiiValue] are those of the device."""
    text = keys.pop("CompactSubObj", None)
    if not whole_number(text):
        return
    count = _compact_members(text)
    if whole_number(text) == MAX_COMPACT + 1:
        parsed.note(f"[{name}]", f"is one too many, {MAX_COMPACT} were assumed", "CompactSubObj", text)
    if not count:
        parsed.note(f"[{name}]", "is no number of members, left out", "CompactSubObj", text)
        return
    names = parsed.sections.pop(f"{name}Name", {})
    values = parsed.sections.pop(f"{name}Value", {})
    shared = {key: value for key, value in keys.items() if key not in ("SubNumber", "ObjectType", "ParameterName")}
    parsed.sections.setdefault(
        f"{name}sub0",
        {"ParameterName": "NrOfObjects", "DataType": "0x0005", "AccessType": "ro", "DefaultValue": str(count)},
    )
    for member in range(1, count + 1):
        section = {**shared, "ParameterName": names.get(str(member), f"{keys['ParameterName']}{member}")}
        if str(member) in values:
            section["ParameterValue"] = values[str(member)]
        parsed.sections.setdefault(f"{name}sub{member:X}", section)
        _complete_variable(f"{name}sub{member:X}", parsed.sections[f"{name}sub{member:X}"], parsed)
    if whole_number(keys.get("ObjectType")) not in (ARRAY, RECORD):
        keys["ObjectType"] = "0x8"


def _complete_variable(name: str, keys: dict[str, str], parsed: EdsText) -> None:
    kind = keys.get("DataType", "")
    if whole_number(kind) is None:
        named = TYPE_NAMES.get(kind.upper())
        keys["DataType"] = f"0x{DataType.DOMAIN.code if named is None else named:04X}"
        if named is None:
            parsed.note(f"[{name}]", "has no data type, taken as a domain", shown=kind or None)
        else:
            parsed.note(f"[{name}]", "is a name, its code is meant", "DataType", kind)
    elif whole_number(kind) not in TYPES:
        parsed.note(f"[{name}]", "is no basic type, taken as a domain", "DataType", kind)
    access = keys.get("AccessType", "").lower()
    if access not in ("ro", "wo", "rw", "rwr", "rww", "const"):
        parsed.note(f"[{name}]", "is no access type, taken as read only", "AccessType", access)
        keys["AccessType"] = access = "ro"
    keys["AccessType"] = access
    for key in ("PDOMapping", "ObjectType", "SubNumber"):
        if key in keys:
            keys[key] = str(whole_number(keys[key]) or 0)


NUMBER = re.compile(r"^([+-]?)(?:0x([0-9a-f]+)(?:u?l{0,2})|([0-9a-f]+)h|([0-9]+)(?:u?l{0,2}))$")


def whole_number(text: str | None) -> int | None:
    """A whole number in any of the spellings met: decimal with leading zeros, 0x…, …h, with blanks, with a suffix of C. None for
    anything else, and beyond 4096 bits."""
    if text is None or len(text) > 1024:
        return None
    match = NUMBER.match(text.replace(" ", "").replace("_", "").lower())
    if match is None:
        return None
    sign, prefixed, suffixed, decimal = match.groups()
    number = int(decimal) if decimal else int(prefixed or suffixed, 16)
    return -number if sign == "-" else number
