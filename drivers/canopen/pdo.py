"""Process data objects as data: mapped objects, packing, and whether a drive's PDO equals the wanted one.

`pdo_setup` reads and writes them in a drive; `pdo_lint` checks a set of them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import cached_property

from drivers.canopen.objects import Entry
from drivers.errors import InputError

EXISTS_NOT = 0x80000000
NO_RTR = 0x40000000
ID_MASK = 0x7FF
SYNC_EVERY = 1  # transmission type: at each SYNC
EVENT = 255
MAKERS_EVENT = 254
OBJECT_MISSING = (0x06020000, 0x06090011)


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
        return f"{'TPDO' if self.transmit else 'RPDO'} {self.number} ({self.cob_id:03X}h)"

    @property
    def communication(self) -> int:
        """Index of the communication parameters."""
        return (0x1800 if self.transmit else 0x1400) + self.number - 1

    @property
    def mapping(self) -> int:
        """Index of the mapping parameters."""
        return (0x1A00 if self.transmit else 0x1600) + self.number - 1

    @property
    def bits(self) -> int:
        """Number of bits mapped."""
        return sum(entry.bits for entry in self.entries)

    @cached_property
    def codec(self) -> struct.Struct:
        """Packs and unpacks all mapped values at once (little endian)."""
        return struct.Struct("<" + "".join(entry.type.format.lstrip("<") for entry in self.entries))


@dataclass(frozen=True)
class PdoImage:
    """The parameters of one PDO as read from the drive, to be restored later."""

    communication: int
    mapping: int
    cob_id: int
    kind: int
    mapped: tuple[int, ...] = field(default=())
    beyond: tuple[int, ...] = field(default=())  # entries behind the mapped ones, as found


def wanted_image(spec: PdoSpec) -> PdoImage:
    """The image that a spec asks for."""
    cob_id = spec.cob_id | (NO_RTR if spec.transmit else 0)
    return PdoImage(spec.communication, spec.mapping, cob_id, spec.kind, tuple(entry.mapping for entry in spec.entries))


def same(present: PdoImage, wanted: PdoImage) -> bool:
    """Whether a drive's image equals the wanted one; the bits of the COB-ID that a drive may ignore are left out."""
    ignored = NO_RTR
    return (present.cob_id & ~ignored, present.kind, present.mapped) == (
        wanted.cob_id & ~ignored,
        wanted.kind,
        wanted.mapped,
    )
