"""The object dictionary of the simulated CANopen drive, made from an EDS file.

Typed storage with access rights and limits, values that are computed when read, and hooks that act (or refuse)
when written. Values are held as their bytes on the wire. The meaning of the objects is in `canopen_profile`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import canopen
from canopen.objectdictionary import datatypes

from drivers.errors import InputError

Key = tuple[int, int]

NO_OBJECT = 0x06020000
NO_SUBINDEX = 0x06090011
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
WRONG_LENGTH = 0x06070010
TOO_LONG = 0x06070012
TOO_SHORT = 0x06070013
TOO_HIGH = 0x06090031
TOO_LOW = 0x06090032
INVALID_VALUE = 0x06090030
WRONG_STATE = 0x08000022

_FORMATS = {
    datatypes.BOOLEAN: "<?",
    datatypes.INTEGER8: "<b",
    datatypes.INTEGER16: "<h",
    datatypes.INTEGER32: "<i",
    datatypes.INTEGER64: "<q",
    datatypes.UNSIGNED8: "<B",
    datatypes.UNSIGNED16: "<H",
    datatypes.UNSIGNED32: "<I",
    datatypes.UNSIGNED64: "<Q",
}


class RefusedError(Exception):
    """An access that the drive answers with an SDO abort; `code` is the abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


@dataclass(frozen=True)
class Item:
    """One entry as the EDS describes it. `codec` is None for strings and domains; low and high are None without a limit."""

    index: int
    subindex: int
    name: str
    access: str
    codec: struct.Struct | None
    low: int | None
    high: int | None
    mappable: bool
    default: bytes

    @property
    def key(self) -> Key:
        """(index, subindex)."""
        return self.index, self.subindex

    @property
    def bits(self) -> int:
        """Length in bits, 0 for strings and domains."""
        return 0 if self.codec is None else 8 * self.codec.size

    @property
    def readable(self) -> bool:
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        return self.access in ("rw", "rww", "rwr", "wo")


def load_items(path: Path, node_id: int) -> dict[Key, Item]:
    """The entries of an EDS file for one node id. Raises InputError naming the file."""
    try:
        changed_ns = path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    return dict(_load_items(path, node_id, changed_ns))


@lru_cache(maxsize=256)
def _load_items(path: Path, node_id: int, _changed_ns: int) -> dict[Key, Item]:
    """As `load_items`, cached by the file's time: parsing takes a hundred times longer than copying."""
    try:
        source = canopen.import_od(str(path), node_id)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"is no usable EDS: {error}", path=path) from error
    items: dict[Key, Item] = {}
    for entry in source.values():
        members = [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else list(entry.values())
        for variable in members:
            item = _item(variable)
            items[item.key] = item
    return items


def _item(variable: canopen.objectdictionary.ODVariable) -> Item:
    layout = _FORMATS.get(variable.data_type or 0)
    codec = struct.Struct(layout) if layout else None
    default: bytes
    if codec is not None:
        default = codec.pack(int(variable.default or 0))
    elif isinstance(variable.default, bytes):
        default = variable.default
    else:
        default = str(variable.default or "").encode("latin-1")
    return Item(
        variable.index,
        variable.subindex,
        variable.name,
        variable.access_type,
        codec,
        variable.min,
        variable.max,
        variable.pdo_mappable,
        default,
    )


class Dictionary:
    """Values of the entries. `on_read` and `on_write` connect an entry to the drive."""

    def __init__(self, items: dict[Key, Item]) -> None:
        self.items = items
        self._values = {key: item.default for key, item in items.items()}
        self._numbers: dict[Key, int] = {}  # decoded at first use
        self._readers: dict[Key, Callable[[], int]] = {}
        self._writers: dict[Key, list[Callable[[int], None]]] = {}
        self._byte_writers: dict[Key, list[Callable[[bytes], None]]] = {}
        self._indices = {index for index, _ in items}

    def on_read(self, index: int, subindex: int, reader: Callable[[], int]) -> None:
        """Compute a numeric entry at each read."""
        self._readers[index, subindex] = reader

    def on_write(self, index: int, subindex: int, writer: Callable[[int], None]) -> None:
        """Call `writer` when a numeric entry is written, with the new value *before* it is stored; RefusedError keeps the old one."""
        self._writers.setdefault((index, subindex), []).append(writer)

    def on_write_bytes(self, index: int, subindex: int, writer: Callable[[bytes], None]) -> None:
        """As `on_write`, for entries without a numeric type."""
        self._byte_writers.setdefault((index, subindex), []).append(writer)

    def lock(self, index: int, subindex: int) -> None:
        """Refuse writes to this entry: "attempt to write a read only object"."""

        def refuse(_value: int) -> None:
            raise RefusedError(READ_ONLY)

        self._writers.setdefault((index, subindex), []).insert(0, refuse)

    def remove(self, index: int) -> None:
        """Remove the object: the drive does not have it."""
        for key in [key for key in self.items if key[0] == index]:
            del self.items[key]
        self._indices.discard(index)

    # -- access by the drive -----------------------------------------------------------------------------------------
    def number(self, index: int, subindex: int = 0) -> int:
        """The present value of a numeric entry. Raises KeyError for another one."""
        key = (index, subindex)
        reader = self._readers.get(key)
        if reader is not None:
            return reader()
        known = self._numbers.get(key)
        if known is not None:
            return known
        codec = self.items[key].codec
        if codec is None:
            raise KeyError(f"{index:04X}h:{subindex} is not numeric")
        value = self._numbers[key] = int(codec.unpack(self._values[key])[0])
        return value

    def set_number(self, index: int, subindex: int, value: int) -> None:
        """Set a numeric entry without access rights and hooks, as the drive itself does. Raises KeyError for another one."""
        codec = self.items[index, subindex].codec
        if codec is None:
            raise KeyError(f"{index:04X}h:{subindex} is not numeric")
        self.set_raw((index, subindex), codec.pack(value))

    def raw(self, key: Key) -> bytes:
        """The stored bytes, without computed values."""
        return self._values[key]

    def set_raw(self, key: Key, data: bytes) -> None:
        """Set the stored bytes without any check."""
        self._values[key] = data
        self._numbers.pop(key, None)

    def reader(self, index: int, subindex: int) -> Callable[[], int]:
        """A function that returns the entry's present value, for use in every cycle."""
        reader = self._readers.get((index, subindex))
        return reader if reader is not None else lambda: self.number(index, subindex)

    # -- access over the wire ------------------------------------------------------------------------------------------
    def item(self, index: int, subindex: int) -> Item:
        """The entry. Raises RefusedError for one that does not exist."""
        item = self.items.get((index, subindex))
        if item is None:
            raise RefusedError(NO_SUBINDEX if index in self._indices else NO_OBJECT)
        return item

    def read(self, index: int, subindex: int) -> bytes:
        """The answer to an SDO upload. Raises RefusedError."""
        item = self.item(index, subindex)
        if not item.readable:
            raise RefusedError(WRITE_ONLY)
        reader = self._readers.get(item.key)
        if reader is not None and item.codec is not None:
            return item.codec.pack(reader())
        return self._values[item.key]

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write by SDO download or RPDO. Raises RefusedError and changes nothing then."""
        item = self.item(index, subindex)
        if not item.writable:
            raise RefusedError(READ_ONLY)
        if item.codec is None:
            for act in self._byte_writers.get(item.key, ()):
                act(data)
            self.set_raw(item.key, data)
            return
        if len(data) != item.codec.size:
            raise RefusedError(TOO_LONG if len(data) > item.codec.size else TOO_SHORT)
        value = int(item.codec.unpack(data)[0])
        if item.high is not None and value > item.high:
            raise RefusedError(TOO_HIGH)
        if item.low is not None and value < item.low:
            raise RefusedError(TOO_LOW)
        for act_on in self._writers.get(item.key, ()):
            act_on(value)
        self.set_raw(item.key, data)
