"""Process data objects: what is mapped where, how it is packed, and how a mapping is written so that it is really in force.

What may go in: PDOs as data, their codec, and the order of writes that CiA-301 prescribes (disable, clear, map, set, enable),
followed by reading everything back. What a set of PDOs should look like before anything is written is `pdo_lint`'s business.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import cached_property

from drivers.canopen.objects import DataType, Entry
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError, InputError, ProtocolError

EXISTS_NOT = 0x80000000
NO_RTR = 0x40000000
ID_MASK = 0x7FF
SYNC_EVERY = 1  # transmission type: at each SYNC
EVENT = 255
OBJECT_MISSING = (0x06020000, 0x06090011)


@dataclass(frozen=True)
class PdoSpec:
    """One PDO as it should be. number counts from 1; transmit is the drive's view (True: TPDO, the drive sends)."""

    number: int
    transmit: bool
    cob_id: int
    kind: int
    entries: tuple[Entry, ...]

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
        return sum(entry.bits for entry in self.entries)

    @cached_property
    def codec(self) -> struct.Struct:
        """Packs and unpacks all mapped values at once."""
        return struct.Struct("<" + "".join(entry.type.format.lstrip("<") for entry in self.entries))


@dataclass(frozen=True)
class PdoImage:
    """The parameters of one PDO as they stood in the drive, to be put back later."""

    communication: int
    mapping: int
    cob_id: int
    kind: int
    mapped: tuple[int, ...] = field(default=())


def _communication(index: int, subindex: int) -> Entry:
    return Entry(index, subindex, DataType.U8 if subindex == 2 else DataType.U32, "PDO communication parameter")


def _mapping(index: int, subindex: int) -> Entry:
    return Entry(index, subindex, DataType.U32 if subindex else DataType.U8, "PDO mapping parameter")


def read_image(sdo: SdoClient, spec: PdoSpec) -> PdoImage:
    """What the drive has now where the spec would go."""
    count = sdo.read(_mapping(spec.mapping, 0))
    if count > 64:
        raise ProtocolError(f"{sdo.name}: {spec.mapping:04X}h:00 says {count} mapped objects")
    return PdoImage(
        spec.communication,
        spec.mapping,
        sdo.read(_communication(spec.communication, 1)),
        sdo.read(_communication(spec.communication, 2)),
        tuple(sdo.read(_mapping(spec.mapping, subindex)) for subindex in range(1, count + 1)),
    )


def wanted_image(spec: PdoSpec) -> PdoImage:
    """The image that a spec asks for."""
    cob_id = spec.cob_id | (NO_RTR if spec.transmit else 0)
    return PdoImage(spec.communication, spec.mapping, cob_id, spec.kind, tuple(entry.mapping for entry in spec.entries))


def write_image(sdo: SdoClient, image: PdoImage) -> None:
    """Disable, clear, map, set, enable (CiA-301, 7.5.2.36). Raises AbortError where the drive refuses a step."""
    sdo.write(_communication(image.communication, 1), image.cob_id | EXISTS_NOT)
    sdo.write(_mapping(image.mapping, 0), 0)
    for subindex, mapped in enumerate(image.mapped, start=1):
        sdo.write(_mapping(image.mapping, subindex), mapped)
    sdo.write(_mapping(image.mapping, 0), len(image.mapped))
    sdo.write(_communication(image.communication, 2), image.kind)
    if not image.cob_id & EXISTS_NOT:
        sdo.write(_communication(image.communication, 1), image.cob_id)


def same(present: PdoImage, wanted: PdoImage) -> bool:
    """Whether a drive's image does what is wanted; the bits of the COB-ID that a drive may ignore are left out."""
    ignored = NO_RTR
    return (present.cob_id & ~ignored, present.kind, present.mapped) == (
        wanted.cob_id & ~ignored,
        wanted.kind,
        wanted.mapped,
    )


def configure(sdo: SdoClient, spec: PdoSpec) -> PdoImage:
    """Bring a PDO into force and verify it by reading back; returns what stood there before.

    Raises AbortError naming the PDO when a step is refused, ProtocolError when the drive kept something else.
    """
    before = read_image(sdo, spec)
    wanted = wanted_image(spec)
    if same(before, wanted):
        return before
    try:
        write_image(sdo, wanted)
    except AbortError as error:
        raise AbortError(f"{spec} cannot be configured: {error}", error.code) from error
    after = read_image(sdo, spec)
    if not same(after, wanted):
        raise ProtocolError(f"{sdo.name}: {spec} reads back {after}, written was {wanted}")
    return before
