"""Object dictionaries from EDS and DCF files as vendors write them, limits included (CiA-306).

Returns a file's content as plain data. `eds_text` corrects the text; the values are read here, as the canopen package drops some of
them, takes others for what they are not, and refuses many files.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.canopen.eds_text import (
    ARRAY,
    RECORD,
    TYPES,
    Deviation,
    EdsText,
    object_number,
    parse,
    quoted,
    whole_number,
)
from drivers.canopen.pdo_lint import MappableObject
from drivers.cia402.objects import DataType, Entry
from drivers.errors import InputError
from drivers.files import read_text

Key = tuple[int, int]
WRITABLE = ("rw", "rww", "rwr", "wo")
MOST_BYTES = 1 << 24
"""Longest file: a hundred times the largest of a maker that is known here."""
MOST_DIGITS = 64
"""Most digits of a number: those of 64 bits written in binary."""
_OCTAL = re.compile(r"^[+-]?0[0-9]+$")
_HEXADECIMAL = re.compile(r"^0x|^[0-9a-f]+h$", re.IGNORECASE)


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
        return self.access in WRITABLE


@dataclass(frozen=True)
class EdsFile:
    """A file's content. notes: the deviations that were accepted; node_id is that of a DCF, else None."""

    path: str
    entries: Mapping[Key, EdsEntry]
    notes: tuple[Deviation, ...] = ()
    node_id: int | None = None
    vendor_number: int | None = None
    product_number: int | None = None

    def about(self, entry: Entry) -> EdsEntry | None:
        """What the file says of an object: type, access, limits, default, mappability. None where it does not have it."""
        return self.entries.get(entry.key)

    def limits(self, entry: Entry) -> tuple[float | None, float | None]:
        """(lowest, highest) value of an object; None where the file limits nothing, or does not have the object."""
        found = self.about(entry)
        return (None, None) if found is None else (found.low, found.high)

    def value(self, entry: Entry) -> int | float | str | bytes | None:
        """The configured value of an object, else its default; None where the file has neither."""
        found = self.about(entry)
        if found is None:
            return None
        return found.default if found.value is None else found.value

    def doubts(self, vendor: int | None, product: int | None) -> tuple[str, ...]:
        """Why this is not the file of a device with this vendor and product number (1018h), a sentence each; None: not known."""
        compared = (("vendor id", vendor, self.vendors()), ("product code", product, self.products()))
        return tuple(
            f"the maker's file (eds) is for {what} {' or '.join(f'{each:#x}' for each in sorted(named))}, this drive reports {held:#x}"
            for what, held, named in compared
            if held is not None and named and held not in named
        )

    def vendors(self) -> frozenset[int]:
        """Vendor numbers of the file: of its head, and of 1018h; empty where it names none (0 counts as none)."""
        return self._numbers(self.vendor_number, 1)

    def maker(self, reported: int | None) -> int:
        """Vendor number of the drive's maker: reported by it (1018h), else the one that the file names; 0 where neither does."""
        return reported or (min(self.vendors()) if len(self.vendors()) == 1 else 0)

    def products(self) -> frozenset[int]:
        """Product numbers of the file, as `vendors`."""
        return self._numbers(self.product_number, 2)

    def _numbers(self, head: int | None, subindex: int) -> frozenset[int]:
        found = self.entries.get((0x1018, subindex))
        numbers = (head, *(() if found is None else (found.default, found.value)))
        return frozenset(number for number in numbers if isinstance(number, int) and number)

    def mappable_objects(self) -> dict[Key, MappableObject]:
        """The entries as the PDO linter needs them."""
        return {
            key: MappableObject(found.entry.bits, found.mappable, found.readable, found.writable)
            for key, found in self.entries.items()
        }


def load_eds(path: str | Path, node_id: int | None = None) -> EdsFile:
    """Read an EDS or DCF file. node_id stands for $NODEID; None takes the DCF's own, or leaves such values out, with a note.

    Raises InputError for a file that cannot be read, holds no object at all, or a number of more than 64 digits.
    """
    text = decode_eds(Path(path))
    try:
        parsed = parse(text)
    except InputError as error:
        raise InputError(error.what, path=path) from error
    if not any(object_number(name) for name in parsed.sections):
        if text.lstrip().startswith("<"):
            what = "is XML, as XDD and XDC files are, expected EDS or DCF (CiA 306); export it in that form"
            raise InputError(what, path=path)
        raise InputError("holds no object, expected sections such as [1000]", path=path)
    commissioning = parsed.sections.get("DeviceComissioning", {})
    own_id = whole_number(commissioning.get("NodeID"))
    reader = _Reader(parsed, own_id if node_id is None else node_id, path)
    entries = {found.entry.key: found for found in reader.entries()}
    device = parsed.sections.get("DeviceInfo", {})
    return EdsFile(
        str(path),
        entries,
        tuple(parsed.notes),
        own_id,
        whole_number(device.get("VendorNumber")),
        whole_number(device.get("ProductNumber")),
    )


def decode_eds(path: Path) -> str:
    """The text of a file, also of an older encoding. Raises InputError for one that cannot be read, and for other forms (XDD)."""
    return read_text(path, MOST_BYTES, older=True, expected="EDS or DCF (CiA 306)")


@dataclass(frozen=True)
class _Reader:
    """Interprets the values of a file's sections by their types. A value that is none of its type is left out with a note."""

    parsed: EdsText
    node_id: int | None
    path: str | Path

    def entries(self) -> Iterator[EdsEntry]:
        """The entry of every variable and member, ascending."""
        for name, keys in self.parsed.sections.items():
            number = object_number(name)
            if number is None:
                continue
            index, subindex = number
            if subindex is None and whole_number(keys.get("ObjectType", "7")) in (ARRAY, RECORD):
                continue
            yield self._entry(name, keys, index, subindex or 0)

    def _entry(self, name: str, keys: Mapping[str, str], index: int, subindex: int) -> EdsEntry:
        data_type = TYPES.get(whole_number(keys["DataType"]) or 0, DataType.DOMAIN)
        low, high = (self._limit(name, keys, key, data_type) for key in ("LowLimit", "HighLimit"))
        if low is not None and high is not None and low > high:
            self.parsed.note(
                f"[{name}]", "limits hold nothing, left out", "LowLimit and HighLimit", f"{low:g} to {high:g}"
            )
            low = high = None
        access = keys["AccessType"]
        if access in WRITABLE and low == high == 0:
            self.parsed.note(f"[{name}]", "limits of 0 are none, left out", "LowLimit and HighLimit", "0 to 0")
            low = high = None
        return EdsEntry(
            Entry(index, subindex, data_type, keys["ParameterName"]),
            access,
            low,
            high,
            self._value(name, keys, "DefaultValue", data_type),
            self._value(name, keys, "ParameterValue", data_type),
            bool(whole_number(keys.get("PDOMapping"))),
        )

    def _limit(self, name: str, keys: Mapping[str, str], key: str, data_type: DataType) -> float | None:
        """A limit; one beyond its type is kept, as it limits nothing."""
        text = keys.get(key, "")
        if not text or not data_type.is_number:
            return None
        return self._number(name, key, text, data_type)

    def _value(
        self, name: str, keys: Mapping[str, str], key: str, data_type: DataType
    ) -> int | float | str | bytes | None:
        if data_type.is_text:
            return keys.get(key)
        text = keys.get(key, "").split(";", 1)[0].strip()
        if not text:
            return None
        if not data_type.is_number:
            return self._bytes(name, key, text, data_type)
        number = self._number(name, key, text, data_type)
        if number is None or data_type.is_real:
            return number
        low, high = data_type.range
        if not low <= number <= high:
            self.parsed.note(f"[{name}]", "does not fit its type, left out", key, text)
            return None
        return number

    def _bytes(self, name: str, key: str, text: str, data_type: DataType) -> bytes | None:
        try:
            data = bytes.fromhex(text)
        except ValueError:
            data = b""
        if not data or (data_type.size and len(data) != data_type.size):
            self.parsed.note(f"[{name}]", f"is no {data_type.name} in hexadecimal digits, left out", key, text)
            return None
        return data

    def _number(self, name: str, key: str, text: str, data_type: DataType) -> int | float | None:
        """A number as it is meant: $NODEID added, hexadecimal digits of a signed type as two's complement, of a REAL as its bits."""
        digits = sum(each.isalnum() for each in text)
        if digits > MOST_DIGITS:
            raise InputError(
                f"[{name}] {key} {quoted(text)} has {digits} digits, expected a number of 64 bits", path=self.path
            )
        if "$NODEID" in text.upper():
            return self._relative(name, key, text)
        if data_type.is_real:
            return self._real(name, key, text, data_type)
        number = whole_number(text)
        if number is None:
            self.parsed.note(f"[{name}]", "is no number, left out", key, text)
            return None
        if _OCTAL.match(text) and number > 7:
            self.parsed.note(f"[{name}]", "has a leading zero, read as decimal, not octal", key, text)
        if data_type.is_signed and number > data_type.range[1] and _HEXADECIMAL.match(text):
            bits = 8 * data_type.size
            return number - (1 << bits) if number < 1 << bits else number
        return number

    def _relative(self, name: str, key: str, text: str) -> int | None:
        left, plus, right = (part.strip() for part in text.partition("+"))
        offset_text = (right if left.upper() == "$NODEID" else left) if plus else "0"
        offset = whole_number(offset_text)
        if offset is None or (plus and "$NODEID" not in (left.upper(), right.upper())):
            self.parsed.note(f"[{name}]", "is no number, left out", key, text)
            return None
        if self.node_id is None:
            self.parsed.note(f"[{name}]", "depends on the node id, which is not given, left out", key, text)
            return None
        return self.node_id + offset

    def _real(self, name: str, key: str, text: str, data_type: DataType) -> float | None:
        try:
            if text.lower().startswith("0x"):
                data = int(text, 16).to_bytes(data_type.size, "little")
                value: float = struct.unpack(data_type.format, data)[0]
            else:
                value = float(text)
        except (ValueError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            self.parsed.note(f"[{name}]", "is no number, left out", key, text)
            return None
        return value
