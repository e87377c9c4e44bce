"""Correction of the text of an EDS or DCF file: vendors' deviations from the standard (CiA-306).

Works on sections, keys and numbers as text: letter case, duplicates, stray lines, missing keys, orphans and compact arrays are
corrected here, and each deviation leaves a note. `eds` interprets the text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from drivers.canopen.objects import DataType

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
ARRAY, RECORD = 0x08, 0x09
MAX_COMPACT = 254


@dataclass
class EdsText:
    """The file as sections of keys, in canonical spelling and order, with notes on the corrections."""

    sections: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def render(self) -> str:
        """A text that strict readers accept; limits are left out, as not all readers get them right."""
        return _render(self)


def parse(text: str) -> EdsText:
    """Read any text; nothing is refused, each deviation leaves a note."""
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
    """Sections and keys of an INI-like text, nothing refused."""
    parsed = EdsText()
    section: dict[str, str] | None = None
    where = ""
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()  # noqa: PLW2901 - the unstripped line is not needed
        if not line or line[0] in ";#":
            continue
        if line.startswith("["):
            where = _section_name(line.strip("[] \t"))
            if where in parsed.sections:
                parsed.notes.append(f"line {number}: section [{where}] again, taken together")
            section = parsed.sections.setdefault(where, {})
            continue
        key, equals, value = line.partition("=")
        if not equals or section is None:
            parsed.notes.append(f"line {number}: {line[:40]!r} is neither section nor key, skipped")
            continue
        key = CANONICAL.get(key.strip().lower(), key.strip())
        value = value.split(";", 1)[0].strip()
        if key in section and section[key] != value:
            parsed.notes.append(f"line {number}: [{where}] {key} again, the last one counts")
        section[key] = value
    return parsed


def _section_name(name: str) -> str:
    match = OBJECT.match(name.replace(" ", ""))
    if match is None:
        known = {"devicecomissioning": "DeviceComissioning", "devicecommissioning": "DeviceComissioning"}
        known |= {"deviceinfo": "DeviceInfo", "fileinfo": "FileInfo", "comments": "Comments"}
        return known.get(name.lower(), name)
    index, subindex = match.groups()
    return index.upper() if subindex is None else f"{index.upper()}sub{int(subindex, 16):X}"


def _complete(parsed: EdsText) -> None:
    """Give every object section what the interpreter needs, expand compact arrays, drop orphans."""
    for name in list(parsed.sections):
        match = OBJECT.match(name)
        if match is None:
            continue
        keys = parsed.sections[name]
        if match.group(2) is not None and match.group(1) not in parsed.sections:
            parsed.sections[match.group(1)] = {"ParameterName": match.group(1), "ObjectType": "0x9"}
            parsed.notes.append(f"[{name}] has no [{match.group(1)}], one was assumed")
        keys.setdefault("ParameterName", name)
        has_members = any(other.startswith(f"{name}sub") for other in parsed.sections)
        kind = whole_number(keys.get("ObjectType"))
        if kind not in (ARRAY, RECORD) and match.group(2) is None and has_members:
            keys["ObjectType"] = "0x9"
            parsed.notes.append(f"[{name}] has sub-indices but is no record, taken as one")
        elif "ObjectType" in keys and kind is None:
            parsed.notes.append(f"[{name}] ObjectType {keys['ObjectType']!r} is no number, taken as variable")
            keys["ObjectType"] = "0x7"
        _expand(name, keys, parsed)
        if whole_number(keys.get("ObjectType", "7")) not in (ARRAY, RECORD):
            _complete_variable(name, keys, parsed)
    # a member has to come after its object
    ordered = sorted(parsed.sections, key=lambda name: (OBJECT.match(name) is not None, _order(name)))
    parsed.sections = {name: parsed.sections[name] for name in ordered}


def _order(name: str) -> tuple[int, int]:
    match = OBJECT.match(name)
    if match is None:
        return -1, -1
    return int(match.group(1), 16), -1 if match.group(2) is None else int(match.group(2), 16)


def _expand(name: str, keys: dict[str, str], parsed: EdsText) -> None:
    """CompactSubObj=n: n members like the array itself (CiA-306, 4.5.2.4)."""
    count = whole_number(keys.pop("CompactSubObj", None))
    if not count or count > MAX_COMPACT:
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
            section["DefaultValue"] = values[str(member)]
        parsed.sections.setdefault(f"{name}sub{member:X}", section)
        _complete_variable(f"{name}sub{member:X}", parsed.sections[f"{name}sub{member:X}"], parsed)


def _complete_variable(name: str, keys: dict[str, str], parsed: EdsText) -> None:
    if whole_number(keys.get("DataType")) is None:
        parsed.notes.append(f"[{name}] has no data type, taken as a domain")
        keys["DataType"] = "0x000F"
    access = keys.get("AccessType", "").lower()
    if access not in ("ro", "wo", "rw", "rwr", "rww", "const"):
        parsed.notes.append(f"[{name}] has access type {access!r}, taken as read only")
        keys["AccessType"] = "ro"
    for key in ("PDOMapping", "ObjectType", "SubNumber"):
        if key in keys:
            keys[key] = str(whole_number(keys[key]) or 0)
    data_type = TYPES.get(whole_number(keys["DataType"]) or 0)
    for key in ("DefaultValue", "ParameterValue"):
        value = keys.get(key)
        if value is None or data_type is None or not data_type.is_number:
            continue
        if not value:
            del keys[key]
        elif "$NODEID" not in value.upper() and not data_type.format.endswith(("f", "d")):
            number = whole_number(value)
            if number is None:
                parsed.notes.append(f"[{name}] {key} {value!r} is no number, left out")
                del keys[key]
            else:
                keys[key] = str(number)


def _render(parsed: EdsText) -> str:
    lines = []
    for name, keys in parsed.sections.items():
        if name in ("Comments", "DummyUsage") or (
            name not in ("FileInfo", "DeviceComissioning") and not OBJECT.match(name)
        ):
            continue
        lines.append(f"[{name}]")
        lines += [f"{key}={value}" for key, value in keys.items() if key not in ("LowLimit", "HighLimit")]
    return "\n".join(["[DeviceInfo]", *lines]) + "\n"


def whole_number(text: str | None) -> int | None:
    """A whole number in any of the spellings met: decimal with leading zeros, 0x…, …h, with blanks. None for anything else."""
    if text is None:
        return None
    text = text.replace(" ", "").replace("_", "").lower()
    try:
        if text.startswith(("0x", "-0x")):
            return int(text, 16)
        if text.endswith("h"):
            return int(text[:-1], 16)
        return int(text, 10)
    except ValueError:
        return None
