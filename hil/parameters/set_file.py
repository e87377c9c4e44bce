"""A parameter set as a file a person can read, compare and edit: TOML, one parameter a line.

    format = "hil parameter set 1"
    name = "X, 2026-03-02"
    hash = "sha256:…"               # over everything below by its meaning; blanks and comments are free
    parameters = [
      { index = 0x2210, subindex = 1, value = 1000, raw = 1000, type = "U32", name = "Proportional gain" },
      { register = "torque_limit", value = 250.0, raw = 2500, type = "u16", unit = "percent", after = ["gear_numerator"] },
    ]
    [identity]                      # whose parameters these are
    protocol = "canopen"
    model = { vendor_id = 0x1234, product_code = 0x0001 }

value is in the drive's unit, raw what stands on the wire; one of the two may be left out, and so may the hash: whoever edits a value
removes the other and the hash. Where both are there they must agree, and a hash must fit. `hil sign` puts the builder's signature
beside the file.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from drivers.parameters import ParameterValue
from drivers.raw_parameters import DriveIdentity, RawForm
from hil.axis import reader
from hil.axis.axis_file import read_toml
from hil.axis.reader import Table
from hil.records.files import read_text, replace_file

FORMAT = "hil parameter set 1"
_OBJECT = re.compile(r"^([0-9A-F]{4})h:([0-9A-F]{2})$")
_ENTRY_KEYS = ("index", "subindex", "register", "value", "raw", "type", "unit", "name", "after")


@dataclass(frozen=True)
class SetEntry:
    """One parameter of a set. address: "2210h:01", or a register's name. line: where it stands in its file.

    value: in the drive's unit, bytes as hexadecimal digits; raw: as on the wire. At least one of the two is there.
    after: addresses of the set that have to be written before it.
    """

    address: str
    value: ParameterValue | None = None
    raw: RawForm | None = None
    type: str = ""
    unit: str = ""
    name: str = ""
    after: tuple[str, ...] = ()
    line: int | None = field(default=None, compare=False)


@dataclass(frozen=True)
class ParameterSet:
    """A set. identity None: the file does not say whose it is (a concise DCF); hash None: the file has none."""

    name: str
    identity: DriveIdentity | None
    entries: tuple[SetEntry, ...]
    hash: str | None = None
    path: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        seen: dict[str, SetEntry] = {}
        for entry in self.entries:
            if entry.address in seen:
                raise InputError(f"{entry.address} is there twice, expected once", path=self.path, line=entry.line)
            seen[entry.address] = entry

    @property
    def addresses(self) -> tuple[str, ...]:
        return tuple(entry.address for entry in self.entries)

    def digest(self) -> str:
        """What the hash of these contents is."""
        identity = self.identity
        content = {
            "name": self.name,
            "identity": None
            if identity is None
            else [identity.protocol, dict(identity.model), dict(identity.version), dict(identity.unit)],
            "parameters": [
                [entry.address, entry.value, entry.raw, entry.type, entry.unit, entry.name, list(entry.after)]
                for entry in self.entries
            ],
        }
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def object_address(index: int, subindex: int) -> str:
    """The address of a CANopen object as sets have it."""
    return f"{index:04X}h:{subindex:02X}"


def object_key(address: str) -> tuple[int, int] | None:
    """(index, subindex) of such an address, None for a register's name."""
    match = _OBJECT.match(address)
    return None if match is None else (int(match[1], 16), int(match[2], 16))


# -- writing -----------------------------------------------------------------------------------------------------------
def write_set(path: str | Path, contents: ParameterSet) -> ParameterSet:
    """Write the file, whole or not at all, with its hash; what was written."""
    written = replace(contents, hash=contents.digest(), path=Path(path))
    replace_file(path, render_set(written).encode())
    return written


def render_set(contents: ParameterSet) -> str:
    """The file's text."""
    lines = [f"format = {_toml(FORMAT)}", f"name = {_toml(contents.name)}", f"hash = {_toml(contents.digest())}"]
    lines += ["", "parameters = [", *(f"  {_line(entry)}," for entry in contents.entries), "]"]
    if contents.identity is not None:
        identity = contents.identity
        lines += ["", "[identity]", f"protocol = {_toml(identity.protocol)}"]
        for name in ("model", "version", "unit"):
            lines.append(f"{name} = {_inline(getattr(identity, name), hexadecimal=('vendor_id', 'product_code'))}")
    return "\n".join(lines) + "\n"


def _line(entry: SetEntry) -> str:
    key = object_key(entry.address)
    place = {"register": entry.address} if key is None else {"index": key[0], "subindex": key[1]}
    rest = {
        name: value
        for name in ("value", "raw", "type", "unit", "name", "after")
        if (value := getattr(entry, name)) not in (None, "", ())
        or (name in ("value", "raw") and getattr(entry, name) is not None)
    }
    return _inline({**place, **rest}, hexadecimal=("index",))


def _inline(values: Mapping[str, Any], *, hexadecimal: tuple[str, ...] = ()) -> str:
    parts = (
        f"{name} = {f'0x{value:04X}' if name in hexadecimal and isinstance(value, int) else _toml(value)}"
        for name, value in values.items()
    )
    inside = ", ".join(parts)
    return f"{{ {inside} }}" if inside else "{}"


def _toml(value: Any) -> str:
    if isinstance(value, float):
        return _float(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, tuple | list):
        return f"[{', '.join(_toml(each) for each in value)}]"
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")


def _float(value: float) -> str:
    if not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    text = repr(value)
    return text if re.search(r"[.e]", text) else f"{text}.0"


# -- reading -----------------------------------------------------------------------------------------------------------
def read_set(path: str | Path) -> ParameterSet:
    """Read a set's TOML file. Raises InputError naming file, line, value and what was expected; also where the hash does not fit."""
    text, root = read_text(path), read_toml(path)
    root.take("format", reader.choice(FORMAT), FORMAT)
    name = root.take("name", reader.text, "a name")
    stated = root.take("hash", _hash, "sha256: and 64 hexadecimal digits", None)
    identity = _identity(root.child("identity")) if "identity" in root.keys_left() else None
    listed = root.take("parameters", _list, "a list of parameters")
    root.finish(("format", "name", "hash", "identity", "parameters"))
    entries = tuple(
        _entry(Path(path), values, line) for values, line in zip(listed, _lines(text, len(listed)), strict=True)
    )
    contents = ParameterSet(name, identity, entries, stated, Path(path))
    if stated is not None and stated != contents.digest():
        raise InputError(
            "was changed after it was written: its hash does not fit; if you changed it yourself, remove the line",
            path=path,
            line=next(
                (n for n, line in enumerate(text.split("\n"), start=1) if line.lstrip().startswith("hash")), None
            ),
        )
    return contents


def _identity(table: Table) -> DriveIdentity:
    protocol = table.take("protocol", reader.choice("canopen", "modbus"), "canopen or modbus")
    parts = [table.take(name, _facts, "a table of numbers and texts", {}) for name in ("model", "version", "unit")]
    table.finish(("protocol", "model", "version", "unit"))
    return DriveIdentity(protocol, *parts)


def _entry(path: Path, values: Any, line: int | None) -> SetEntry:
    try:
        table = Table(path, "", "parameters", values)
        if "register" in table.keys_left():
            address = table.take("register", reader.text, "a register's name")
            if object_key(address) is not None:
                raise table.fail("register", f"is {address}, which is an object: give index and subindex")
        else:
            index = table.take("index", reader.whole(0, 0xFFFF), "0x0000 to 0xFFFF")
            address = object_address(index, table.take("subindex", reader.whole(0, 0xFF), "0 to 255", 0))
        entry = SetEntry(
            address,
            table.take("value", _value, "a number or a text", None),
            table.take("raw", _raw, "a whole number or hexadecimal digits", None),
            table.take("type", _plain_text, "a text", ""),
            table.take("unit", _plain_text, "a text", ""),
            table.take("name", _plain_text, "a text", ""),
            table.take("after", _addresses, "a list of addresses", ()),
            line,
        )
        table.finish(_ENTRY_KEYS)
    except InputError as error:
        raise InputError(error.what, path=path, line=line) from error
    if entry.value is None and entry.raw is None:
        raise InputError(f"{address} has neither value nor raw", path=path, line=line)
    return entry


def _lines(text: str, count: int) -> list[int | None]:
    """The lines of a list's members, as far as each has one of its own."""
    found = [
        number
        for number, line in enumerate(text.split("\n"), start=1)
        if re.match(r"\s*(parameters\s*=\s*\[\s*)?\{|\s*\[\[\s*parameters\s*\]\]", line)
    ]
    return list(found) if len(found) == count else [None] * count


def _hash(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"sha256:[0-9a-f]{64}", value):
        raise ValueError
    return value


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise ValueError
    return value


def _facts(value: Any) -> dict[str, int | str]:
    if not isinstance(value, dict) or not all(type(each) in (int, str) for each in value.values()):
        raise ValueError
    return value


def _value(value: Any) -> ParameterValue:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TypeError
    return value


def _raw(value: Any) -> RawForm:
    if isinstance(value, str):
        bytes.fromhex(value)
        return value
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError
    return value


def _plain_text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _addresses(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise TypeError
    return tuple(reader.text(each) for each in value)
