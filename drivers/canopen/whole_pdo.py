"""One PDO of a node as a single parameter: communication and mapping parameters read, compared and written as a whole.

`write_pdo` is the only writer of mappings: entry by entry a drive would refuse it, or exchange a half-written PDO. The bytes of a PDO
in a parameter set are those of a concise DCF.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

from drivers.canopen.abort_codes import ABORT_GENERAL, ABORT_READ_ONLY, ABORT_VALUE
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
    PdoSpec,
    pdo_entry,
    pdo_of,
)
from drivers.canopen.sdo import SdoClient
from drivers.cia402.objects import Entry
from drivers.cia402.wire import OBJECT_MISSING
from drivers.errors import AbortError, InputError, NoAnswerError, ProtocolError
from drivers.raw_parameters import Steps

_ADDRESS = re.compile(r"^(1[4-7][0-9A-F]{2}|1[89AB][0-9A-F]{2})h PDO$")
MOST_ENTRIES = 64
_TEXT_ENTRIES = 8
KEPT = (ABORT_READ_ONLY, ABORT_VALUE)
"""A COB-ID that is read-only, or whose bit 31 a drive does not know (invalid value)."""


def pdo_at(address: str) -> Pdo | None:
    """The PDO of an address in a set, None for another parameter."""
    match = _ADDRESS.match(address)
    return None if match is None else pdo_of(int(match[1], 16))


@dataclass(frozen=True)
class PdoImage:
    """Parameters of one PDO, or some of them, as a node shows them or as they are meant.

    items: ((index, sub-index), bytes) in the order of writing."""

    items: tuple[tuple[Key, bytes], ...]

    @classmethod
    def of(cls, items: Iterable[tuple[Key, bytes]]) -> PdoImage:
        """The block of objects as they come; where one is repeated (disabled, filled, enabled) its last value counts."""
        return cls(tuple(dict(items).items()))

    @classmethod
    def unpack(cls, data: bytes) -> PdoImage:
        """Read the bytes of a set. Raises InputError for objects of more than one PDO, or sizes that are none."""
        block = cls.of(unpack_concise(data))
        if len({pdo_of(index) for (index, _), _ in block.items}) != 1:
            raise InputError("expected the objects of one PDO")
        for (index, subindex), value in block.items:
            if len(value) != pdo_entry(index, subindex).type.size:
                raise InputError(f"{index:04X}h:{subindex:02X} has {len(value)} bytes")
        return block

    def pack(self) -> bytes:
        return pack_concise(self.items)

    @property
    def pdo(self) -> Pdo:
        """Whose they are."""
        return Pdo(self.items[0][0][0] & ~0x200)

    @cached_property
    def numbers(self) -> dict[tuple[bool, int], int]:
        """(whether it is of the mapping, sub-index) -> value."""
        return {(bool(index & 0x200), sub): int.from_bytes(data, "little") for (index, sub), data in self.items}

    @property
    def cob_id(self) -> int | None:
        return self.numbers.get((False, COB_ID))

    @property
    def exists(self) -> bool:
        """Whether it is in force, by its COB-ID."""
        return not self.numbers[False, COB_ID] & EXISTS_NOT

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

    def holds(self, meant: PdoImage) -> bool:
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
    block = PdoImage.unpack(data)
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


def wanted_image(spec: PdoSpec) -> PdoImage:
    """The parameters that a spec asks for."""
    values = [
        (spec.pdo.setting(COB_ID), spec.cob_id_entry),
        (spec.pdo.setting(KIND), spec.kind),
        (spec.pdo.mapped(0), len(spec.entries)),
        *((spec.pdo.mapped(sub), entry.mapping) for sub, entry in enumerate(spec.entries, start=1)),
    ]
    return PdoImage.of((entry.key, entry.pack(value)) for entry, value in values)


# -- in a node ---------------------------------------------------------------------------------------------------------
def read_pdo(sdo: SdoClient, pdo: Pdo, settings: Iterable[int] = tuple(SETTINGS), entries: int = 0) -> Steps[PdoImage]:
    """Its parameters; times that the node does not have are left out. settings: sub-indices of the communication parameter.

    entries: number of mapping entries to be read, also behind those that are mapped, as far as the node shows them
    Raises ProtocolError for an impossible count, and what the transfers raise."""
    items: list[tuple[Key, bytes]] = []

    def get(entry: Entry) -> Steps[int]:
        value = yield from sdo.getting(entry)
        items.append((entry.key, entry.pack(value)))
        return value

    for sub in settings:
        try:
            yield from get(pdo.setting(sub))
        except AbortError as error:
            if sub <= KIND or error.code not in OBJECT_MISSING:
                raise
    count = yield from get(pdo.mapped(0))
    if count > MOST_ENTRIES:
        raise ProtocolError(f"{sdo.name}: {pdo.name} says that it maps {count} objects")
    for sub in range(1, count + 1):
        yield from get(pdo.mapped(sub))
    with suppress(AbortError):
        for sub in range(count + 1, entries + 1):
            yield from get(pdo.mapped(sub))
    return PdoImage(tuple(items))


def write_pdo(
    sdo: SdoClient, present: PdoImage, meant: PdoImage, *, beyond: bool = False, tried: list[Entry] | None = None
) -> Steps[None]:
    """Bring a node's PDO from `present` to what is meant: disable, clear, map, set, read back, enable (CiA 301, 7.5.2.36).

    What is so already, or not given, stays as it is. beyond: the entries behind the mapped ones are written too, as far as the node
    lets them; tried: filled with the entries that were to be written, empty while the mapping is read back. Raises ProtocolError for a
    node that has accepted a mapping and shows another, its PDO still disabled; what the transfers raise; AbortError too for a node
    that answers a read of an entry and neither of two writes.
    """
    pdo, now = present.pdo, present.numbers[False, COB_ID]
    cob_id = now if meant.cob_id is None else meant.cob_id

    def put(entry: Entry, value: int) -> Steps[None]:
        if tried is not None:
            tried.append(entry)
        return _put(sdo, entry, value)

    off, fixed = now | EXISTS_NOT, False
    if now != off:
        try:
            yield from put(pdo.setting(COB_ID), off)
        except AbortError as error:
            if error.code not in KEPT or (now ^ cob_id) & ~NO_RTR:
                raise
            fixed = True  # its COB-ID is the wanted one: it is changed with a count of 0 alone
    behind = {(of, sub): value for (of, sub), value in meant.numbers.items() if of and sub > len(meant.mapped or ())}
    overwritten = beyond and any(present.numbers.get(place) != value for place, value in behind.items())
    remapped = meant.mapped is not None and (meant.mapped != present.mapped or overwritten)
    if meant.mapped is not None and remapped:
        yield from put(pdo.mapped(0), 0)
        for sub, value in enumerate(meant.mapped, start=1):
            yield from put(pdo.mapped(sub), value)
        for (_, sub), value in behind.items() if beyond else ():
            with suppress(AbortError):  # a node may refuse what cannot be mapped
                yield from sdo.putting(pdo.mapped(sub), value)
        yield from put(pdo.mapped(0), len(meant.mapped))
    for sub in (KIND, INHIBIT, EVENT_TIMER, SYNC_START):
        wanted = meant.numbers.get((False, sub))
        if wanted is not None and wanted != present.numbers.get((False, sub)):
            yield from put(pdo.setting(sub), wanted)
    if remapped:
        if tried is not None:
            tried.clear()
        shown = yield from read_pdo(sdo, pdo, settings=())
        if shown.mapped != meant.mapped:
            raise read_otherwise(sdo, shown, meant)
    if cob_id != off and not fixed:
        yield from put(pdo.setting(COB_ID), cob_id)


def _put(sdo: SdoClient, entry: Entry, value: int) -> Steps[None]:
    """Write an entry, a second time where the node did not answer and still has the old value: that changes no other."""
    for again in (False, True):
        try:
            yield from sdo.putting(entry, value)
            return
        except NoAnswerError as error:
            yield from sdo.getting(entry)  # a node that does not answer at all ends it
            if again:
                raise AbortError(f"{sdo.name}: a write to {entry} is not answered", ABORT_GENERAL) from error


def read_otherwise(sdo: SdoClient, shown: PdoImage, meant: PdoImage) -> ProtocolError:
    """The error of a node that accepted a PDO and shows another."""
    texts = [described(image.pack()) for image in (shown, meant)]
    return ProtocolError(f"{sdo.name}: {meant.pdo.name} reads back {texts[0]}; written was {texts[1]}")


def wholes(items: Sequence[tuple[Key, bytes]]) -> dict[Pdo, PdoImage]:
    """The PDOs among objects in their order of writing, each with its parameters. The number of sub-indices is left out."""
    found: dict[Pdo, list[tuple[Key, bytes]]] = {}
    for (index, subindex), data in items:
        pdo = pdo_of(index)
        if pdo is not None and (index & 0x200 or subindex in SETTINGS):
            found.setdefault(pdo, []).append(((index, subindex), data))
    return {pdo: PdoImage.of(parts) for pdo, parts in found.items()}
