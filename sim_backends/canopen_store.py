"""Non-volatile memory of the simulated drive: 1010h store and 1011h restore (CiA-301, 7.5.2.13).

Like many real drives it stores every writable entry, targets included; writing takes time, and a supply that fails meanwhile leaves an
incomplete image, which the next start finds and discards.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from sim_backends.canopen_dictionary import WRONG_STATE, Dictionary, Key, RefusedError

SAVE, LOAD = 0x65766173, 0x64616F6C  # "save", "load" as numbers, least significant byte first
CANNOT_STORE = 0x08000020
STORAGE_ERROR = 0x5530  # EMCY: EEPROM fault
COMMUNICATION = range(0x1000, 0x2000)
GROUPS: dict[int, Callable[[int], bool]] = {
    1: lambda index: True,
    2: lambda index: index in COMMUNICATION,
    3: lambda index: index not in COMMUNICATION,
}
NEVER = (0x1003, 0x1010, 0x1011)


@dataclass
class Flash:
    """The memory itself: pass the same one to a restarted drive. writes: number of write cycles."""

    image: dict[Key, bytes] = field(default_factory=dict)
    checksum: int = 0
    writes: int = 0

    def sealed(self) -> int:
        """Checksum over the present image."""
        return zlib.crc32(repr(sorted(self.image.items())).encode())

    @property
    def intact(self) -> bool:
        """Whether the image equals the one that was last written completely."""
        return not self.image or self.checksum == self.sealed()


_WRITE_NS = 150_000_000
"""Duration of writing the memory, ns."""


class ParameterStore:
    """1010h and 1011h of one drive.

    may_store(): whether the drive's state allows it. The SDO is answered when the memory is written.
    """

    def __init__(self, dictionary: Dictionary, flash: Flash, may_store: Callable[[], bool]) -> None:
        self._od = dictionary
        self.flash = flash
        self._may_store = may_store
        self._factory = {key: dictionary.raw(key) for key in dictionary.items}
        self._pending: Iterator[tuple[Key, bytes]] | None = None
        self._left = 0
        self._total = 0
        self._done_ns = 0
        self._started_ns = 0
        self._restore: set[int] = set()
        self._now_ns = 0
        for group in GROUPS:
            dictionary.on_write(0x1010, group, lambda value, group=group: self._store(group, value))  # type: ignore[misc]
            dictionary.on_write(0x1011, group, lambda value, group=group: self._load(group, value))  # type: ignore[misc]
            dictionary.on_read(0x1010, group, lambda: 1)  # stores on command
            dictionary.on_read(0x1011, group, lambda: 1)

    @property
    def busy(self) -> bool:
        """Whether writing is in progress: the store command is not answered yet."""
        return self._pending is not None

    def due_ns(self) -> int | None:
        """Time at which writing is done, ns; None when nothing is written."""
        return self._done_ns if self.busy else None

    # -- commands ------------------------------------------------------------------------------------------------------
    def _kept(self, group: int) -> list[Key]:
        belongs = GROUPS[group]
        return [
            key for key, item in self._od.items.items() if item.writable and belongs(key[0]) and key[0] not in NEVER
        ]

    def _store(self, group: int, signature: int) -> None:
        if signature != SAVE:
            raise RefusedError(CANNOT_STORE)
        if not self._may_store() or self.busy:
            raise RefusedError(WRONG_STATE)
        entries = [(key, self._od.raw(key)) for key in self._kept(group)]
        self._pending, self._total, self._left = iter(entries), len(entries), len(entries)
        self._started_ns, self._done_ns = self._now_ns, self._now_ns + _WRITE_NS
        self.flash.writes += 1

    def _load(self, group: int, signature: int) -> None:
        if signature != LOAD:
            raise RefusedError(CANNOT_STORE)
        self._restore.add(group)  # takes effect at the next start

    # -- time ----------------------------------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        """Write as much as the time since the command allows."""
        self._now_ns = now_ns
        if self._pending is None:
            return
        share = min(1.0, (now_ns - self._started_ns) / _WRITE_NS)
        while self._left > round((1.0 - share) * self._total):
            key, data = next(self._pending)
            self.flash.image[key] = data
            self._left -= 1
        if share >= 1.0:
            self.flash.checksum = self.flash.sealed()
            self._pending = None

    def power_lost(self) -> None:
        """The supply failed: an image in progress stays incomplete."""
        self._pending = None

    def start(self) -> int:
        """At every start: load defaults, then the stored values. Returns an error code, 0 without an error."""
        error = 0
        self._pending = None
        for group in self._restore:
            for key in self._kept(group):
                self.flash.image.pop(key, None)
            self.flash.checksum = self.flash.sealed()
        self._restore.clear()
        if not self.flash.intact:
            self.flash.image.clear()
            error = STORAGE_ERROR
        for key, data in self._factory.items():
            self._od.set_raw(key, self.flash.image.get(key, data))
        return error
