"""One PDO of a node as a single parameter: communication and mapping parameters read, compared and written as a whole.

A PDO is written in the order of CiA 301 (7.5.2.36): disabled, count 0, entries, count, transmission parameters, then enabled as
wanted; entry by entry a drive would refuse it, or exchange a half-written PDO. Its bytes in a set are those of a concise DCF.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from drivers.canopen.dcf import pack_concise, unpack_concise
from drivers.canopen.eds import Key
from drivers.canopen.pdo import (
    COB_ID,
    EVENT_TIMER,
    EXISTS_NOT,
    INHIBIT,
    KIND,
    NO_RTR,
    SETTINGS,
    SYNC_START,
    Pdo,
    pdo_entry,
    pdo_of,
)
from drivers.cia402.objects import Entry
from drivers.cia402.wire import OBJECT_MISSING
from drivers.errors import AbortError, InputError, ProtocolError
from drivers.raw_parameters import Steps

_ADDRESS = re.compile(r"^(1[4-7][0-9A-F]{2}|1[89AB][0-9A-F]{2})h PDO$")
MOST_ENTRIES = 64
_TEXT_ENTRIES = 8


def pdo_at(address: str) -> Pdo | None:
    """The PDO of an address in a set, None for another parameter."""
    match = _ADDRESS.match(address)
    return None if match is None else pdo_of(int(match[1], 16))


@dataclass(frozen=True)
class Block:
    """Parameters of one PDO, or some of them. items: ((index, sub-index), bytes) in the order of writing."""

    items: tuple[tuple[Key, bytes], ...]

    @classmethod
    def of(cls, items: Iterable[tuple[Key, bytes]]) -> Block:
        """The block of objects as they come; where one is repeated (disabled, filled, enabled) its last value counts."""
        return cls(tuple(dict(items).items()))

    @classmethod
    def unpack(cls, data: bytes) -> Block:
        """Read the bytes of a set. Raises InputError for objects of more than one PDO, or sizes that are none."""
        block = cls.of(unpack_concise(data))
        if len({pdo_of(index) for (index, _), _ in block.items}) != 1:
            raise InputError("expected the objects of one PDO")
        for (index, subindex), value in block.items:
            if len(value) != pdo_entry(index, subindex).type.size:
                raise InputError(f"{index:04X}h:{subindex:02X} has {len(value)} bytes")
        return block

    def pack(self) -> bytes:
        """The bytes of a set."""
        return pack_concise(self.items)

    @cached_property
    def numbers(self) -> dict[tuple[bool, int], int]:
        """(whether it is of the mapping, sub-index) -> value."""
        return {(bool(index & 0x200), sub): int.from_bytes(data, "little") for (index, sub), data in self.items}

    @property
    def cob_id(self) -> int | None:
        return self.numbers.get((False, COB_ID))

    @property
    def mapped(self) -> tuple[int, ...] | None:
        """The objects mapped; None where the block says nothing of the mapping. Entries beyond the count are not mapped."""
        given = {sub: value for (mapping, sub), value in self.numbers.items() if mapping}
        if not given:
            return None
        count = given.get(0, max(given))
        return tuple(given.get(sub, 0) for sub in range(1, min(count, MOST_ENTRIES) + 1))

    def objection(self) -> str | None:
        """Why this cannot be a PDO, None where it can be one."""
        mapped = self.mapped
        if mapped is None:
            return None
        count = self.numbers.get((True, 0), len(mapped))
        if count > MOST_ENTRIES:
            return f"maps {count} objects, at most {MOST_ENTRIES} are possible"
        if 0 in mapped:
            return f"counts {count} mapped objects, entry {mapped.index(0) + 1} is missing"
        bits = sum(value & 0xFF for value in mapped)
        return f"maps {bits} bits, at most 64 fit" if bits > 64 else None

    def holds(self, meant: Block) -> bool:
        """Whether this one, read from a node, is as meant. Bit 30 of the COB-ID is left out: nodes may ignore it."""
        if meant.mapped is not None and self.mapped != meant.mapped:
            return False
        for (mapping, sub), value in meant.numbers.items():
            ignored = NO_RTR if sub == COB_ID else 0
            if not mapping and sub and self.numbers.get((mapping, sub), -1) & ~ignored != value & ~ignored:
                return False
        return True


def described(data: bytes) -> str:
    """A PDO as text: COB-ID, transmission type, times, mapped objects."""
    block = Block.unpack(data)
    words = []
    if block.cob_id is not None:
        words.append(f"{block.cob_id & 0x1FFFFFFF:03X}h{' off' if block.cob_id & EXISTS_NOT else ''}")
    for sub, name in ((KIND, "type"), (INHIBIT, "inhibit"), (EVENT_TIMER, "event"), (SYNC_START, "from SYNC")):
        if (False, sub) in block.numbers:
            words.append(f"{name} {block.numbers[False, sub]}")
    if block.mapped is not None:
        shown = [f"{value >> 16:04X}h:{value >> 8 & 0xFF:02X}" for value in block.mapped]
        words.append(" ".join(shown[:_TEXT_ENTRIES]) or "nothing mapped")
    return ", ".join(words)


@dataclass(frozen=True)
class WholePdo:
    """A PDO in a node. upload, download: one object's transfer, as steps."""

    pdo: Pdo
    upload: Callable[[Entry], Steps[bytes]]
    download: Callable[[Entry, bytes], Steps[None]]

    def read(self) -> Steps[Block]:
        """All its parameters; times that the node does not have are left out. Raises ProtocolError for an impossible count, and what
        the transfers raise."""
        items: list[tuple[Key, bytes]] = []
        for sub in SETTINGS:
            entry = self.pdo.setting(sub)
            try:
                data = yield from self.upload(entry)
            except AbortError as error:
                if sub <= KIND or error.code not in OBJECT_MISSING:
                    raise
                continue
            items.append((entry.key, data[: entry.type.size]))
        count_entry = self.pdo.mapped(0)
        data = yield from self.upload(count_entry)
        count = int(count_entry.unpack(data))
        if count > MOST_ENTRIES:
            raise ProtocolError(f"{self.pdo.name} says it maps {count} objects")
        items.append((count_entry.key, data[:1]))
        for sub in range(1, count + 1):
            entry = self.pdo.mapped(sub)
            items.append((entry.key, (yield from self.upload(entry))[: entry.type.size]))
        return Block(tuple(items))

    def write(self, meant: Block) -> Steps[None]:
        """Bring the node's PDO to what is meant, parameters not given stay as they are. Nothing is written where it is so already.

        Raises what the transfers raise.
        """
        present = yield from self.read()
        if present.holds(meant):
            return
        now = present.cob_id or 0
        cob_id = now if meant.cob_id is None else meant.cob_id
        if not now & EXISTS_NOT:
            yield from self._put(self.pdo.setting(COB_ID), now | EXISTS_NOT)
        if meant.mapped is not None and meant.mapped != present.mapped:
            yield from self._put(self.pdo.mapped(0), 0)
            for sub, value in enumerate(meant.mapped, start=1):
                yield from self._put(self.pdo.mapped(sub), value)
            yield from self._put(self.pdo.mapped(0), len(meant.mapped))
        for sub in (KIND, INHIBIT, EVENT_TIMER, SYNC_START):
            wanted = meant.numbers.get((False, sub))
            if wanted is not None and wanted != present.numbers.get((False, sub)):
                yield from self._put(self.pdo.setting(sub), wanted)
        if (cob_id ^ (now | EXISTS_NOT)) & ~NO_RTR:
            yield from self._put(self.pdo.setting(COB_ID), cob_id)

    def _put(self, entry: Entry, value: int) -> Steps[None]:
        yield from self.download(entry, entry.pack(value))


def wholes(items: Sequence[tuple[Key, bytes]]) -> dict[Pdo, Block]:
    """The PDOs among objects in their order of writing, each with its parameters. The number of sub-indices is left out."""
    found: dict[Pdo, list[tuple[Key, bytes]]] = {}
    for (index, subindex), data in items:
        pdo = pdo_of(index)
        if pdo is not None and (index & 0x200 or subindex in SETTINGS):
            found.setdefault(pdo, []).append(((index, subindex), data))
    return {pdo: Block.of(parts) for pdo, parts in found.items()}
