"""Process data objects as data: their parameters in the dictionary, mapped objects, packing.

`whole_pdo` reads and writes one in a drive, `pdo_setup` those that a drive is opened with; `pdo_lint` checks a set of them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

from drivers.cia402.objects import DataType, Entry
from drivers.errors import InputError

EXISTS_NOT = 0x80000000
NO_RTR = 0x40000000
ID_MASK = 0x7FF
SYNC_EVERY = 1  # transmission type: at each SYNC
EVENT = 255
MAKERS_EVENT = 254
RPDOS, TPDOS = 0x1400, 0x1800
"""Index of the first communication parameter of each direction (CiA 301, 7.5.2.35 and 7.5.2.37)."""
COB_ID, KIND, INHIBIT, EVENT_TIMER, SYNC_START = 1, 2, 3, 5, 6
"""Sub-indices of a communication parameter (the same clauses)."""
SETTINGS = {
    COB_ID: (DataType.U32, "COB-ID"),
    KIND: (DataType.U8, "transmission type"),
    INHIBIT: (DataType.U16, "inhibit time"),
    EVENT_TIMER: (DataType.U16, "event timer"),
    SYNC_START: (DataType.U8, "SYNC start value"),
}
"""Type and name of each."""


@dataclass(frozen=True)
class Pdo:
    """A PDO by the index of its communication parameter, 1400h to 15FFh or 1800h to 19FFh."""

    communication: int

    @classmethod
    def numbered(cls, number: int, *, transmit: bool) -> Pdo:
        """The PDO of a number, which counts from 1, in one direction."""
        return cls((TPDOS if transmit else RPDOS) + number - 1)

    @property
    def transmit(self) -> bool:
        """Whether the drive sends it."""
        return self.communication >= TPDOS

    @property
    def number(self) -> int:
        """Its number, which counts from 1."""
        return self.communication - (TPDOS if self.transmit else RPDOS) + 1

    @property
    def mapping(self) -> int:
        """Index of its mapping parameter."""
        return self.communication + 0x200

    @property
    def name(self) -> str:
        """Such as "TPDO 1"."""
        return f"{'TPDO' if self.transmit else 'RPDO'} {self.number}"

    @property
    def address(self) -> str:
        """Its address in parameter sets, such as "1800h PDO"."""
        return f"{self.communication:04X}h PDO"

    def setting(self, subindex: int) -> Entry:
        """An entry of its communication parameter."""
        return pdo_entry(self.communication, subindex)

    def mapped(self, subindex: int) -> Entry:
        """An entry of its mapping parameter; sub-index 0 is the number of objects mapped."""
        return pdo_entry(self.mapping, subindex)


def pdo_of(index: int) -> Pdo | None:
    """The PDO that an index belongs to, None for another object."""
    return Pdo(index & ~0x200) if RPDOS <= index < 0x1C00 else None


def pdo_entry(index: int, subindex: int) -> Entry:
    """An entry of a communication or mapping parameter."""
    if index & 0x200:
        return Entry(index, subindex, DataType.U32 if subindex else DataType.U8, "PDO mapping parameter")
    kind, name = SETTINGS.get(subindex, (DataType.U8, "communication parameter"))
    return Entry(index, subindex, kind, f"PDO {name}")


@dataclass(frozen=True)
class PdoSpec:
    """One wanted PDO. number counts from 1; transmit is the drive's view (True: TPDO, the drive sends).

    only_stops: the master sends it only with commands that stop the axis or take its power, so that it cannot be stale: it may map
    6040h beside the RPDO that carries everything else. Raises InputError for a number outside 1…512 or more than 64 bits.
    """

    number: int
    transmit: bool
    cob_id: int
    kind: int
    entries: tuple[Entry, ...]
    only_stops: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.number <= 512:
            raise InputError(f"PDO number is {self.number}, expected 1 to 512")
        if self.bits > 64:
            raise InputError(f"{self} maps {self.bits} bits, at most 64 fit")

    def __str__(self) -> str:
        return f"{self.pdo.name} ({self.cob_id:03X}h)"

    @property
    def pdo(self) -> Pdo:
        """Its place in the dictionary."""
        return Pdo.numbered(self.number, transmit=self.transmit)

    @property
    def cob_id_entry(self) -> int:
        """The value of its COB-ID entry while it is in force."""
        return self.cob_id | (NO_RTR if self.transmit else 0)

    @property
    def bits(self) -> int:
        """Number of bits mapped."""
        return sum(entry.bits for entry in self.entries)

    @cached_property
    def codec(self) -> struct.Struct:
        """Packs and unpacks all mapped values at once (little endian)."""
        return struct.Struct("<" + "".join(entry.type.format.lstrip("<") for entry in self.entries))
