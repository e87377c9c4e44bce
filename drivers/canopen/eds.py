"""Object dictionaries from EDS and DCF files as vendors write them, limits included (CiA-306).

Returns a file's content as plain data. `eds_text` corrects the text, the canopen package interprets it, and the limits are read here
once more, as that package drops or folds some of them.
"""

from __future__ import annotations

import configparser
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary.eds import import_eds

from drivers.canopen.eds_text import TYPES, EdsText, object_number, parse, whole_number
from drivers.canopen.objects import DataType, Entry
from drivers.canopen.pdo_lint import MappableObject
from drivers.errors import InputError

Key = tuple[int, int]


@dataclass(frozen=True)
class EdsEntry:
    """One entry: its type, name and access, its limits (None: none), default and (DCF) configured value."""

    entry: Entry
    access: str
    low: float | None
    high: float | None
    default: int | float | str | bytes | None
    value: int | float | str | bytes | None
    mappable: bool

    @property
    def readable(self) -> bool:
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        return self.access in ("rw", "rww", "rwr", "wo")


@dataclass(frozen=True)
class EdsFile:
    """A file's content. notes: the deviations that were accepted; node_id and bitrate are those of a DCF, else None."""

    path: str
    entries: Mapping[Key, EdsEntry]
    notes: tuple[str, ...]
    node_id: int | None = None
    bitrate: int | None = None
    vendor_number: int | None = None
    product_number: int | None = None

    def mappable_objects(self) -> dict[Key, MappableObject]:
        """The entries as the PDO linter needs them."""
        return {
            key: MappableObject(found.entry.bits, found.mappable, found.readable, found.writable)
            for key, found in self.entries.items()
        }


def load_eds(path: str | Path, node_id: int | None = None) -> EdsFile:
    """Read an EDS or DCF file. node_id stands for $NODEID; None takes the DCF's own, or leaves such values without a default.

    Raises InputError for a file that cannot be read or holds no object at all.
    """
    text = decode_eds(Path(path))
    parsed = parse(text)
    if not any(object_number(name) for name in parsed.sections):
        raise InputError("holds no object, expected sections such as [1000]", path=path)
    commissioning = parsed.sections.get("DeviceComissioning", {})
    own_id = whole_number(commissioning.get("NodeID"))
    node_id = own_id if node_id is None else node_id
    try:
        dictionary = import_eds(io.StringIO(parsed.render()), node_id)  # type: ignore[no-untyped-call]
    except (ValueError, KeyError, configparser.Error) as error:
        raise InputError(f"is no usable EDS: {error}", path=path) from error
    entries = {}
    for variable in _variables(dictionary):
        found = _entry(variable, parsed)
        entries[found.entry.index, found.entry.subindex] = found
    kilobaud = whole_number(commissioning.get("Baudrate"))
    device = parsed.sections.get("DeviceInfo", {})
    return EdsFile(
        str(path),
        entries,
        tuple(parsed.notes),
        own_id,
        None if kilobaud is None else 1000 * kilobaud,
        whole_number(device.get("VendorNumber")),
        whole_number(device.get("ProductNumber")),
    )


def decode_eds(path: Path) -> str:
    """The text of a file in UTF-8, else Windows-1252, else Latin-1. Raises InputError for a file that cannot be read."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1")


def _variables(dictionary: Any) -> Iterable[Any]:
    for entry in dictionary.values():
        if isinstance(entry, canopen.objectdictionary.ODVariable):
            yield entry
        else:
            yield from entry.subindices.values()


def _entry(variable: Any, parsed: EdsText) -> EdsEntry:
    index, subindex = variable.index, variable.subindex
    single, member = f"{index:04X}", f"{index:04X}sub{subindex:X}"
    keys = parsed.sections.get(member) or parsed.sections.get(single, {})
    data_type = TYPES.get(variable.data_type, DataType.DOMAIN)
    low, high = (_limit(keys.get(key), data_type) for key in ("LowLimit", "HighLimit"))
    if low is not None and high is not None and low > high:
        parsed.notes.append(
            f"[{member if member in parsed.sections else single}] limits {low:g} to {high:g} hold nothing, left out"
        )
        low = high = None
    return EdsEntry(
        Entry(index, subindex, data_type, variable.name),
        variable.access_type,
        low,
        high,
        variable.default,
        getattr(variable, "value", None),
        bool(variable.pdo_mappable),
    )


def _limit(text: str | None, data_type: DataType) -> float | None:
    """A limit in the entry's own type: hexadecimal limits of signed types are two's complement; floats are kept."""
    if text is None or not text or not data_type.is_number:
        return None
    if data_type.format.endswith(("f", "d")):
        try:
            return float(text)
        except ValueError:
            return None
    number = whole_number(text)
    if number is None:
        return None
    bits = 8 * data_type.size
    if data_type.is_signed and text.lower().lstrip("-").startswith("0x") and number >= 1 << (bits - 1):
        number -= 1 << bits
    return number
