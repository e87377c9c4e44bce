"""A parameter set as a TOML file, one parameter a line.

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

value is in the drive's unit, raw is the number on the wire. One of the two may be left out, and so may the hash: a person who edits a
value removes the raw form and the hash. Where both are present they must agree, and a hash must match. `hil sign` writes the builder's
signature beside the file.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from drivers.errors import InputError
from drivers.files import replace_file
from drivers.parameters import ParameterValue
from drivers.raw_parameters import DriveIdentity, RawForm
from drivers.toml_schema import Document, shown
from drivers.toml_types import Limits, SchemaError, Text, Via, not_empty, one_of

FORMAT = "hil parameter set 1"
_OBJECT = re.compile(r"^([0-9A-F]{4})h:([0-9A-F]{2})$")


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
    """A set. identity: None where the file names none (a concise DCF); hash: None where the file has none.

    foreign: written by a commissioning tool, with commands, targets and volatile values among the parameters, which are left out.
    Raises InputError for an address that occurs twice.
    """

    name: str
    identity: DriveIdentity | None
    entries: tuple[SetEntry, ...]
    hash: str | None = None
    path: Path | None = field(default=None, compare=False)
    foreign: bool = field(default=False, compare=False)

    def __post_init__(self) -> None:
        seen: dict[str, SetEntry] = {}
        for entry in self.entries:
            if entry.address in seen:
                raise InputError(f"{entry.address} is there twice, expected once", path=self.path, line=entry.line)
            seen[entry.address] = entry

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses of the entries, in order."""
        return tuple(entry.address for entry in self.entries)

    def digest(self) -> str:
        """SHA-256 over the contents, as "sha256:…"."""
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
    """The address of a CANopen object, such as "2210h:01"."""
    return f"{index:04X}h:{subindex:02X}"


def object_key(address: str) -> tuple[int, int] | None:
    """(index, subindex) of an object's address, None for a register's name."""
    match = _OBJECT.match(address)
    return None if match is None else (int(match[1], 16), int(match[2], 16))


# -- writing -----------------------------------------------------------------------------------------------------------
def write_set(path: str | Path, contents: ParameterSet) -> ParameterSet:
    """Write the file, whole or not at all, with its hash; returns the set as written. Raises InputError when it cannot be written."""
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
def _raw(value: int | str, _: Document) -> RawForm:
    if isinstance(value, str):
        bytes.fromhex(value)
    return value


@dataclass(frozen=True)
class _Entry:
    """One parameter as it is written."""

    register: Text = ""
    index: Annotated[int, Limits(ge=0, le=0xFFFF, description="0x0000 to 0xFFFF")] | None = None
    subindex: Annotated[int, Limits(ge=0, le=0xFF)] | None = None
    value: int | float | str | None = None
    raw: Annotated[RawForm | None, Via(int | str, _raw, "a whole number or hexadecimal digits")] = None
    type: str = ""
    unit: str = ""
    name: str = ""
    after: tuple[Text, ...] = ()

    def __post_init__(self) -> None:
        if self.register and object_key(self.register) is not None:
            raise SchemaError("register", f"is {self.register}, which is an object: give index and subindex")
        if self.index is None and not self.register:
            raise SchemaError("", "lacks index or register, expected one of them")
        for key in ("index", "subindex"):
            if self.register and getattr(self, key) is not None:
                raise SchemaError(key, f"stands beside register {self.register}, expected one of them")
        if self.value is None and self.raw is None:
            raise SchemaError("", f"{self.address} has neither value nor raw")

    @property
    def address(self) -> str:
        return self.register if self.index is None else object_address(self.index, self.subindex or 0)


@dataclass(frozen=True)
class _SetFile:
    format: Annotated[str, one_of(FORMAT)]
    name: Text
    parameters: Annotated[tuple[_Entry, ...], not_empty]
    hash: Annotated[
        str | None, Limits(pattern=r"\Asha256:[0-9a-f]{64}\Z", description="sha256: and 64 hexadecimal digits")
    ] = None
    identity: DriveIdentity | None = None


def read_set(path: str | Path) -> ParameterSet:
    """Read a set's TOML file. Raises InputError naming file, line, value and what was expected; also where the hash does not fit."""
    document = Document.read(path)
    file = document.load(_SetFile)
    entries = tuple(
        SetEntry(
            *(each.address, each.value, each.raw, each.type, each.unit, each.name, each.after),
            document.line(("parameters", index)),
        )
        for index, each in enumerate(file.parameters)
    )
    if file.identity is not None and file.identity.protocol not in ("canopen", "modbus"):
        raise document.fail("identity.protocol", f"is {shown(file.identity.protocol)}, expected canopen or modbus")
    contents = ParameterSet(file.name, file.identity, entries, file.hash, Path(path))
    if file.hash is not None and file.hash != contents.digest():
        what = (
            "was changed after it was written: its hash does not fit; after an edit of your own remove this line, and `raw` from each"
            " parameter whose `value` you changed"
        )
        raise InputError(what, path=path, line=document.line(("hash",)))
    return contents
