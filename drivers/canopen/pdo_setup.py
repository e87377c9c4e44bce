"""Setting up a drive's PDOs and restoring them: survey, lint, write, verify, restore.

The order of writes is that of CiA-301 (disable, clear, map, set, enable), and everything is read back. `pdo` holds the data,
`pdo_lint` the checks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from drivers.canopen import objects
from drivers.canopen.objects import DataType, Entry
from drivers.canopen.pdo import (
    EXISTS_NOT,
    ID_MASK,
    OBJECT_MISSING,
    PdoImage,
    PdoSpec,
    same,
    wanted_image,
)
from drivers.canopen.pdo_lint import Cycle, Dictionary, Finding, lint, refuse_errors
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError, BridgeError, InputError, ProtocolError
from drivers.undo import undo_all

SURVEYED = 4  # of each direction: the predefined connection set
NAMED: dict[tuple[int, int], Entry] = {
    (entry.index, entry.subindex): entry for entry in vars(objects).values() if isinstance(entry, Entry)
}
BY_BITS = {8: DataType.U8, 16: DataType.U16, 32: DataType.U32, 64: DataType.U64}


def entry_of(mapped: int) -> Entry:
    """The object behind a mapping value; one that is not named in `objects` is taken as unsigned."""
    index, subindex, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
    named = NAMED.get((index, subindex))
    if named is not None and named.bits == bits:
        return named
    return Entry(index, subindex, BY_BITS.get(bits, DataType.U64), "object")


def spec_of(image: PdoImage) -> PdoSpec:
    """A drive's image as a spec. Raises InputError when it maps more than 64 bits."""
    transmit = image.communication >= 0x1800
    number = image.communication - (0x1800 if transmit else 0x1400) + 1
    return PdoSpec(
        number, transmit, image.cob_id & ID_MASK, image.kind, tuple(entry_of(mapped) for mapped in image.mapped)
    )


class PdoSetup:
    """The PDOs of one node: `apply` brings the wanted ones into force, `restore` writes back the earlier ones.

    alone: every other PDO of the node is switched off meanwhile, not only conflicting ones.
    """

    def __init__(self, sdo: SdoClient, node_id: int, wanted: Sequence[PdoSpec], *, alone: bool = False) -> None:
        self._sdo = sdo
        self._node_id = node_id
        self.wanted = tuple(wanted)
        self._alone = alone
        self._before: list[PdoImage] = []
        self._changed: list[PdoImage] = []

    def survey(self) -> list[PdoImage]:
        """Read the first PDOs of both directions, existing or disabled. Raises as `SdoClient.read`."""
        images = []
        for transmit in (False, True):
            for number in range(1, SURVEYED + 1):
                probe = PdoSpec(number, transmit, 0, 0, ())
                try:
                    images.append(read_image(self._sdo, probe))
                except AbortError as error:
                    if error.code not in OBJECT_MISSING:
                        raise
                    break
        self._before = images
        return images

    def in_the_way(self) -> list[PdoImage]:
        """Active PDOs that are not wanted and would interfere: they command the same objects, or use our COB-IDs."""
        places = {spec.communication for spec in self.wanted}
        commanded = {entry.mapping for spec in self.wanted if not spec.transmit for entry in spec.entries}
        identifiers = {spec.cob_id for spec in self.wanted}
        return [
            image
            for image in self._before
            if image.communication not in places
            and not image.cob_id & EXISTS_NOT
            and (
                self._alone
                or image.cob_id & ID_MASK in identifiers
                or (image.communication < 0x1800 and not commanded.isdisjoint(image.mapped))
            )
        ]

    def lint(self, dictionary: Dictionary | None = None, cycle: Cycle | None = None) -> list[Finding]:
        """Findings on the wanted PDOs together with those that remain."""
        replaced = {spec.communication for spec in self.wanted} | {image.communication for image in self.in_the_way()}
        staying = []
        for image in self._before:
            if image.communication not in replaced and not image.cob_id & EXISTS_NOT:
                with suppress(InputError):  # an impossible PDO of the drive itself is not checked
                    staying.append(spec_of(image))
        dictionaries = None if dictionary is None else {self._node_id: dictionary}
        return lint({self._node_id: [*self.wanted, *staying]}, dictionaries=dictionaries, cycle=cycle)

    def apply(
        self,
        dictionary: Dictionary | None = None,
        cycle: Cycle | None = None,
        *,
        interrupted: Callable[[], None] = lambda: None,
    ) -> list[Finding]:
        """Survey, lint, then write and verify; returns the warnings. interrupted: called on an interrupt, before anything is restored.

        Raises InputError before anything is written when the linter finds an error; AbortError or ProtocolError, with everything
        restored, when the drive does not accept a PDO.
        """
        self.survey()
        findings = self.lint(dictionary, cycle)
        refuse_errors(findings)
        try:
            for image in self.in_the_way():
                self._changed.append(image)
                self._sdo.write(Entry(image.communication, 1, DataType.U32, "COB-ID"), image.cob_id | EXISTS_NOT)
            for spec in self.wanted:
                before = next((image for image in self._before if image.communication == spec.communication), None)
                before = read_image(self._sdo, spec) if before is None else before
                if not same(before, wanted_image(spec)):
                    self._changed.append(before)
                    configure(self._sdo, spec)
        except BaseException as error:
            if not isinstance(error, BridgeError):
                interrupted()
            undo_all([("", self.restore)], during=error)
            raise
        return findings

    def restore(self) -> None:
        """Restore every PDO that was changed, the last first; one that fails does not prevent the others. Raises as `undo_all`."""
        changed, self._changed = self._changed[::-1], []

        def put_back(image: PdoImage) -> None:
            try:
                write_image(self._sdo, image)
            except BaseException:
                self._changed.insert(0, image)  # so that it can be tried again
                raise

        undo_all([(f"PDO {image.communication:04X}h not put back", partial(put_back, image)) for image in changed])


# -- one PDO of a drive ------------------------------------------------------------------------------------------------
def _communication(index: int, subindex: int) -> Entry:
    return Entry(index, subindex, DataType.U8 if subindex == 2 else DataType.U32, "PDO communication parameter")


def _mapping(index: int, subindex: int) -> Entry:
    return Entry(index, subindex, DataType.U32 if subindex else DataType.U8, "PDO mapping parameter")


def read_image(sdo: SdoClient, spec: PdoSpec) -> PdoImage:
    """The image in the drive at the place of the spec. Raises ProtocolError for an impossible number of mapped objects."""
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


def configure(sdo: SdoClient, spec: PdoSpec) -> PdoImage:
    """Bring a PDO into force and verify it by reading back; returns the image before.

    Raises AbortError naming the PDO when a step is refused, ProtocolError when the drive holds something else.
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
