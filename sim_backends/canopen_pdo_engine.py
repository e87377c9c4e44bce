"""PDOs of the simulated drive: mappings that the master may change, sent and applied on SYNC or on an event (CiA-301, 7.2.2).

Communication and mapping parameters 1400h to 1BFFh as a drive obeys them. Values are read from and written to the dictionary.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_backends.canopen_dictionary import INVALID_VALUE, WRONG_STATE, Dictionary, Item, RefusedError

NOT_MAPPABLE = 0x06040041
PDO_TOO_LONG = 0x06040042
DISABLED = 0x80000000
LAST_SYNCHRONOUS = 240
SLOTS = 4

Send = Callable[[int, bytes], None]
_LETTERS = {8: "B", 16: "H", 32: "I", 64: "Q"}


@dataclass
class _Pdo:
    communication: int
    mapping: int
    transmit: bool
    cob_id: int = 0
    enabled: bool = False
    kind: int = 255
    items: list[Item] = field(default_factory=list)
    codec: struct.Struct = field(default_factory=lambda: struct.Struct("<"))
    readers: list[Callable[[], int]] = field(default_factory=list)
    masks: list[int] = field(default_factory=list)
    sync_count: int = 0
    pending: bytes | None = None  # an RPDO that waits for SYNC
    last: bytes | None = None  # a TPDO as last sent
    last_ns: int = 0

    @property
    def synchronous(self) -> bool:
        return self.kind <= LAST_SYNCHRONOUS


class PdoEngine:
    """All PDOs of one drive. send(cob_id, data) puts a frame on the bus; short_pdo() reports one of a wrong length."""

    def __init__(self, dictionary: Dictionary, send: Send, short_pdo: Callable[[], None]) -> None:
        self._dictionary = dictionary
        self._send = send
        self._short_pdo = short_pdo
        self._pdos: list[_Pdo] = []
        for slot in range(SLOTS):
            self._add(_Pdo(0x1400 + slot, 0x1600 + slot, transmit=False))
            self._add(_Pdo(0x1800 + slot, 0x1A00 + slot, transmit=True))
        self._receivers: dict[int, list[_Pdo]] = {}
        self.reload()

    def _add(self, pdo: _Pdo) -> None:
        self._pdos.append(pdo)
        writes = self._dictionary.on_write
        writes(pdo.communication, 1, lambda value: self._write_cob_id(pdo, value))
        writes(pdo.communication, 2, lambda value: self._write_kind(pdo, value))
        writes(pdo.mapping, 0, lambda value: self._write_count(pdo, value))
        for subindex in range(1, 9):
            writes(pdo.mapping, subindex, lambda value: self._write_mapping(pdo, value))

    def reload(self) -> None:
        """Take everything from the dictionary again, after a reset or a restore."""
        for pdo in self._pdos:
            if (pdo.communication, 1) not in self._dictionary.items:
                pdo.enabled = False  # a drive with fewer PDOs
                continue
            pdo.kind = self._dictionary.number(pdo.communication, 2)
            pdo.pending = pdo.last = None
            pdo.sync_count = 0
            self._map(pdo, [self._dictionary.number(pdo.mapping, sub) for sub in range(1, 9)][: self._count(pdo)])
            self._set_cob_id(pdo, self._dictionary.number(pdo.communication, 1))

    def _count(self, pdo: _Pdo) -> int:
        return self._dictionary.number(pdo.mapping, 0)

    # -- parameters --------------------------------------------------------------------------------------------------
    def _write_cob_id(self, pdo: _Pdo, value: int) -> None:
        identifier = value & 0x7FF
        if value & 0x20000000 or not 0x180 < identifier < 0x580:
            raise RefusedError(INVALID_VALUE)
        if pdo.enabled and not value & DISABLED and identifier != pdo.cob_id:
            raise RefusedError(WRONG_STATE)  # bits 0 to 29 may change only while the PDO does not exist
        self._set_cob_id(pdo, value)

    def _set_cob_id(self, pdo: _Pdo, value: int) -> None:
        pdo.cob_id = value & 0x7FF
        pdo.enabled = not value & DISABLED
        self._receivers = {}
        for other in self._pdos:
            if other.enabled and not other.transmit:
                self._receivers.setdefault(other.cob_id, []).append(other)

    def _write_kind(self, pdo: _Pdo, value: int) -> None:
        if LAST_SYNCHRONOUS < value < 254:
            raise RefusedError(INVALID_VALUE)
        pdo.kind = value

    def _write_mapping(self, pdo: _Pdo, value: int) -> None:
        if pdo.enabled or self._count(pdo):
            raise RefusedError(WRONG_STATE)
        if value:
            self._mapped_item(pdo, value)

    def _write_count(self, pdo: _Pdo, value: int) -> None:
        if pdo.enabled:
            raise RefusedError(WRONG_STATE)
        self._map(pdo, [self._dictionary.number(pdo.mapping, sub) for sub in range(1, value + 1)])

    def _mapped_item(self, pdo: _Pdo, mapping: int) -> Item:
        item = self._dictionary.item(mapping >> 16, mapping >> 8 & 0xFF)
        usable = item.readable if pdo.transmit else item.writable
        if not item.mappable or not usable or item.bits != mapping & 0xFF:
            raise RefusedError(NOT_MAPPABLE)
        return item

    def _map(self, pdo: _Pdo, mappings: list[int]) -> None:
        items = [self._mapped_item(pdo, mapping) for mapping in mappings]
        if sum(item.bits for item in items) > 64:
            raise RefusedError(PDO_TOO_LONG)
        pdo.items = items
        pdo.codec = struct.Struct("<" + "".join(_LETTERS[item.bits] for item in items))
        pdo.masks = [(1 << item.bits) - 1 for item in items]
        pdo.readers = [self._dictionary.reader(item.index, item.subindex) for item in items]

    # -- traffic -----------------------------------------------------------------------------------------------------
    def on_sync(self, now_ns: int) -> None:
        """Apply the RPDOs received for this SYNC, then send the synchronous TPDOs."""
        for pdo in self._pdos:
            if not pdo.enabled or not pdo.synchronous:
                continue
            if not pdo.transmit:
                if pdo.pending is not None:
                    self._apply(pdo, pdo.pending)
                    pdo.pending = None
            elif pdo.items:
                pdo.sync_count += 1
                data = self._encode(pdo)
                due = data != pdo.last if pdo.kind == 0 else pdo.sync_count >= pdo.kind
                if due:
                    pdo.sync_count = 0
                    self._transmit(pdo, data, now_ns)

    def on_frame(self, cob_id: int, data: bytes) -> None:
        """Handle an RPDO, if the identifier is one."""
        for pdo in self._receivers.get(cob_id, ()):
            if len(data) < pdo.codec.size:
                self._short_pdo()
            elif pdo.synchronous:
                pdo.pending = data
            else:
                self._apply(pdo, data)

    def tick(self, now_ns: int) -> None:
        """Event-driven TPDOs: on a change, no sooner than the inhibit time (100 µs units), and on the event timer (ms)."""
        for pdo in self._pdos:
            if not pdo.transmit or not pdo.enabled or pdo.synchronous or not pdo.items:
                continue
            since_ns = now_ns - pdo.last_ns
            if pdo.last is not None and since_ns < 100_000 * self._dictionary.number(pdo.communication, 3):
                continue
            timer_ns = 1_000_000 * self._dictionary.number(pdo.communication, 5)
            data = self._encode(pdo)
            if data != pdo.last or (timer_ns and since_ns >= timer_ns):
                self._transmit(pdo, data, now_ns)

    def _transmit(self, pdo: _Pdo, data: bytes, now_ns: int) -> None:
        pdo.last, pdo.last_ns = data, now_ns
        self._send(pdo.cob_id, data)

    def _encode(self, pdo: _Pdo) -> bytes:
        return pdo.codec.pack(*[read() & mask for read, mask in zip(pdo.readers, pdo.masks, strict=True)])

    def _apply(self, pdo: _Pdo, data: bytes) -> None:
        place = 0
        for item in pdo.items:
            size = item.bits // 8
            with contextlib.suppress(RefusedError):  # a PDO has no answer: a value out of range is ignored
                self._dictionary.write(item.index, item.subindex, data[place : place + size])
            place += size
