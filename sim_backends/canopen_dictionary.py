"""The object dictionary of the simulated CANopen drive: an EDS file come alive.

What may go in: typed storage with access rights and limits, values that are computed when read, and hooks that act (or refuse)
when written. Values are held as the bytes that stand on the wire. Nothing here knows what an object means.
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
    """An access that the drive answers with an SDO abort."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


@dataclass(frozen=True)
class Item:
    """What the EDS says about one entry. `codec` is None for strings and domains; low and high are None without a limit."""

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
        return self.index, self.subindex

    @property
    def bits(self) -> int:
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
    """Parsing takes a hundred times longer than copying."""
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
    """Values behind the entries. `on_read` and `on_write` give an entry a life of its own."""

    def __init__(self, items: dict[Key, Item]) -> None:
        self.items = items
        self._values = {key: item.default for key, item in items.items()}
        self._numbers: dict[Key, int] = {}  # decoded on first use
        self._readers: dict[Key, Callable[[], int]] = {}
        self._writers: dict[Key, list[Callable[[int], None]]] = {}
        self._byte_writers: dict[Key, list[Callable[[bytes], None]]] = {}
        self._indices = {index for index, _ in items}

    def on_read(self, index: int, subindex: int, reader: Callable[[], int]) -> None:
        """Compute a numeric entry whenever it is read."""
        self._readers[index, subindex] = reader

    def on_write(self, index: int, subindex: int, writer: Callable[[int], None]) -> None:
        """Act when a numeric entry is written: called with the new value *before* it is stored; RefusedError keeps the old."""
        self._writers.setdefault((index, subindex), []).append(writer)

    def on_write_bytes(self, index: int, subindex: int, writer: Callable[[bytes], None]) -> None:
        """The same for entries without a numeric type."""
        self._byte_writers.setdefault((index, subindex), []).append(writer)

    def lock(self, index: int, subindex: int) -> None:
        """The drive does not let this entry be written: "attempt to write a read only object"."""

        def refuse(_value: int) -> None:
            raise RefusedError(READ_ONLY)

        self._writers.setdefault((index, subindex), []).insert(0, refuse)

    def remove(self, index: int) -> None:
        """The drive lacks this object."""
        for key in [key for key in self.items if key[0] == index]:
            del self.items[key]
        self._indices.discard(index)

    # -- from inside the drive ---------------------------------------------------------------------------------------
    def number(self, index: int, subindex: int = 0) -> int:
        """The present value of a numeric entry."""
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
        """Set a numeric entry past its access rights and hooks, as the drive itself may."""
        codec = self.items[index, subindex].codec
        if codec is None:
            raise KeyError(f"{index:04X}h:{subindex} is not numeric")
        self.set_raw((index, subindex), codec.pack(value))

    def raw(self, key: Key) -> bytes:
        """The stored bytes, whatever a reader would compute."""
        return self._values[key]

    def set_raw(self, key: Key, data: bytes) -> None:
        """Set the stored bytes past everything."""
        self._values[key] = data
        self._numbers.pop(key, None)

    def reader(self, index: int, subindex: int) -> Callable[[], int]:
        """A function that gives the entry's present value, for use in every cycle."""
        reader = self._readers.get((index, subindex))
        return reader if reader is not None else lambda: self.number(index, subindex)

    # -- from the wire -------------------------------------------------------------------------------------------------
    def item(self, index: int, subindex: int) -> Item:
        """The entry, or RefusedError for one that does not exist."""
        item = self.items.get((index, subindex))
        if item is None:
            raise RefusedError(NO_SUBINDEX if index in self._indices else NO_OBJECT)
        return item

    def read(self, index: int, subindex: int) -> bytes:
        """What an SDO upload answers. Raises RefusedError."""
        item = self.item(index, subindex)
        if not item.readable:
            raise RefusedError(WRITE_ONLY)
        reader = self._readers.get(item.key)
        if reader is not None and item.codec is not None:
            return item.codec.pack(reader())
        return self._values[item.key]

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """What an SDO download or an RPDO does. Raises RefusedError and leaves everything as it was."""
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
