"""Setting up a drive's PDOs and restoring them: survey, lint, write, verify, restore.

The order of writes is that of CiA-301 (disable, clear, map, set, enable), and everything is read back. `pdo` holds the data,
`pdo_lint` the checks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from drivers.canopen import cia301
from drivers.canopen.pdo import (
    COB_ID,
    EXISTS_NOT,
    ID_MASK,
    KIND,
    NO_RTR,
    Pdo,
    PdoImage,
    PdoSpec,
    same,
    wanted_image,
)
from drivers.canopen.pdo_lint import Cycle, Dictionary, Finding, lint, refuse_errors
from drivers.canopen.sdo import SdoClient
from drivers.cia402.objects import DataType, Entry
from drivers.errors import AbortError, BridgeError, InputError, NoAnswerError, ProtocolError
from drivers.undo import undo_all

SURVEYED = 4  # of each direction: the predefined connection set
BY_BITS = {8: DataType.U8, 16: DataType.U16, 32: DataType.U32, 64: DataType.U64}


def entry_of(mapped: int) -> Entry:
    """The object behind a mapping value; one that has no name here is taken as unsigned."""
    index, subindex, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
    named = cia301.NAMED.get((index, subindex))
    if named is not None and named.bits == bits:
        return named
    return Entry(index, subindex, BY_BITS.get(bits, DataType.U64), "object")


def spec_of(image: PdoImage) -> PdoSpec:
    """A drive's image as a spec. Raises InputError when it maps more than 64 bits."""
    pdo, entries = image.pdo, tuple(entry_of(mapped) for mapped in image.mapped)
    return PdoSpec(pdo.number, pdo.transmit, image.cob_id & ID_MASK, image.kind, entries)


READ_ONLY = 0x06010002
KEPT = (READ_ONLY, 0x06090030)
"""A COB-ID that is read-only, or whose bit 31 a drive does not know (invalid value)."""
GENERAL = 0x08000000


class PdoRefusedError(AbortError):
    """A drive refuses one step of setting up a PDO. spec: the PDO. entry: the object that it does not map, None for another step.

    kind: whether its transmission type is refused.
    """

    def __init__(self, message: str, code: int, spec: PdoSpec, entry: Entry | None, *, kind: bool) -> None:
        super().__init__(message, code)
        self.spec = spec
        self.entry = entry
        self.kind = kind


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

    @property
    def found(self) -> list[PdoImage]:
        """The PDOs as `survey` found them."""
        return self._before

    def survey(self) -> list[PdoImage]:
        """Read the first PDOs of both directions, existing or disabled. Raises as `SdoClient.read`."""
        images = []
        for transmit in (False, True):
            for number in range(1, SURVEYED + 1):
                pdo = Pdo.numbered(number, transmit=transmit)
                entries = next((len(spec.entries) for spec in self.wanted if spec.pdo == pdo), 0)
                try:
                    images.append(read_image(self._sdo, pdo, entries))
                except AbortError:
                    break  # no further PDO, or one that does not show what it maps
        self._before = images
        return images

    def in_the_way(self) -> list[PdoImage]:
        """Active PDOs that are not wanted and would interfere: they command the same objects, or use our COB-IDs."""
        places = {spec.pdo for spec in self.wanted}
        return [
            image
            for image in self._before
            if image.pdo not in places and not image.cob_id & EXISTS_NOT and (self._alone or self._conflicts(image))
        ]

    def _conflicts(self, image: PdoImage) -> bool:
        """Whether an active PDO uses one of our COB-IDs, or could command what ours command."""
        commanded = {entry.mapping for spec in self.wanted if not spec.transmit for entry in spec.entries}
        own_id = image.cob_id & ID_MASK in {spec.cob_id for spec in self.wanted}
        return own_id or (not image.pdo.transmit and not commanded.isdisjoint(image.mapped))

    def lint(self, dictionary: Dictionary | None = None, cycle: Cycle | None = None) -> list[Finding]:
        """Findings on the wanted PDOs together with those that remain."""
        replaced = {spec.pdo for spec in self.wanted} | {image.pdo for image in self.in_the_way()}
        staying = []
        for image in self._before:
            if image.pdo not in replaced and not image.cob_id & EXISTS_NOT:
                with suppress(InputError):  # an impossible PDO of the drive itself is not checked
                    staying.append(spec_of(image))
        dictionaries = None if dictionary is None else {self._node_id: dictionary}
        return lint({self._node_id: [*self.wanted, *staying]}, dictionaries=dictionaries, cycle=cycle)

    def apply(
        self,
        dictionary: Dictionary | None = None,
        cycle: Cycle | None = None,
        *,
        refuse: bool = True,
        interrupted: Callable[[], None] = lambda: None,
    ) -> list[Finding]:
        """Survey, lint, then write and verify; returns the warnings. interrupted: called on an interrupt, before anything is restored.
        refuse: whether an error that the linter finds ends it.

        Raises InputError before anything is written when the linter finds an error; AbortError or ProtocolError, with everything
        restored, when the drive does not accept a PDO.
        """
        self.survey()
        findings = self.lint(dictionary, cycle)
        if refuse:
            refuse_errors(findings)
        try:
            for image in self.in_the_way():
                self._changed.append(image)
                try:
                    self._sdo.write(image.pdo.setting(COB_ID), image.cob_id | EXISTS_NOT)
                except AbortError as error:
                    if error.code not in KEPT or self._conflicts(image):
                        raise
                    self._changed.remove(image)  # it only adds to the load of the bus
            for spec in self.wanted:
                before = next((image for image in self._before if image.pdo == spec.pdo), None)
                before = self._found(spec) if before is None else before
                if not same(before, wanted_image(spec)):
                    self._changed.append(before)
                    configure(self._sdo, spec)
        except BaseException as error:
            if not isinstance(error, BridgeError):
                interrupted()
            undo_all([("", self.restore)], during=error)
            raise
        return findings

    def _found(self, spec: PdoSpec) -> PdoImage:
        try:
            return read_image(self._sdo, spec.pdo, len(spec.entries))
        except AbortError as error:
            raise PdoRefusedError(f"{spec}: {error}", error.code, spec, None, kind=False) from error

    def restore(self) -> None:
        """Restore every PDO that was changed, the last first; one that fails does not prevent the others. Raises as `undo_all`."""
        changed, self._changed = self._changed[::-1], []

        def put_back(image: PdoImage) -> None:
            try:
                _put_back(self._sdo, image)
            except BaseException:
                self._changed.insert(0, image)  # so that it can be tried again
                raise

        undo_all([(f"PDO {image.pdo.communication:04X}h not put back", partial(put_back, image)) for image in changed])


# -- one PDO of a drive ------------------------------------------------------------------------------------------------
def read_image(sdo: SdoClient, pdo: Pdo, entries: int = 0) -> PdoImage:
    """A PDO of the drive. entries: number of objects that are to be mapped, whose places are read too where fewer are mapped now.

    Raises ProtocolError for an impossible number of mapped objects."""
    count = sdo.read(pdo.mapped(0))
    if count > 64:
        raise ProtocolError(f"{sdo.name}: {pdo.mapping:04X}h:00 says {count} mapped objects")
    return PdoImage(
        pdo,
        sdo.read(pdo.setting(COB_ID)),
        sdo.read(pdo.setting(KIND)),
        tuple(sdo.read(pdo.mapped(subindex)) for subindex in range(1, count + 1)),
        _beyond(sdo, pdo, range(count + 1, entries + 1)),
    )


def _beyond(sdo: SdoClient, pdo: Pdo, subindices: range) -> tuple[int, ...]:
    """Entries behind the mapped ones that a mapping would overwrite; as far as the drive shows them."""
    found: list[int] = []
    for subindex in subindices:
        try:
            found.append(sdo.read(pdo.mapped(subindex)))
        except AbortError:
            break
    return tuple(found)


def write_image(sdo: SdoClient, image: PdoImage, steps: list[Entry] | None = None) -> None:
    """Disable, clear, map, set, enable (CiA-301, 7.5.2.36). steps: filled with the entries that were to be written.

    Raises AbortError where the drive refuses a step."""

    def write(entry: Entry, value: int) -> None:
        if steps is not None:
            steps.append(entry)
        _write(sdo, entry, value)

    fixed = _fixed_cob_id(sdo, image, write)
    write(image.pdo.mapped(0), 0)
    for subindex, mapped in enumerate(image.mapped, start=1):
        write(image.pdo.mapped(subindex), mapped)
    for subindex, mapped in enumerate(image.beyond, start=len(image.mapped) + 1):
        with suppress(AbortError):  # behind the mapped ones: a drive may refuse what cannot be mapped
            sdo.write(image.pdo.mapped(subindex), mapped)
    write(image.pdo.mapped(0), len(image.mapped))
    kind = image.pdo.setting(KIND)
    try:
        write(kind, image.kind)
    except AbortError as error:
        if error.code != READ_ONLY or sdo.read(kind) != image.kind:
            raise
    if not image.cob_id & EXISTS_NOT and not fixed:
        write(image.pdo.setting(COB_ID), image.cob_id)


def _put_back(sdo: SdoClient, image: PdoImage) -> None:
    """Write an earlier image. A drive whose mapping is read-only has it still: only type and COB-ID are written then."""
    try:
        write_image(sdo, image)
        return
    except AbortError:
        if read_image(sdo, image.pdo).mapped != image.mapped:
            raise
    kind = image.pdo.setting(KIND)
    if sdo.read(kind) != image.kind:
        sdo.write(kind, image.kind)
    cob_id = image.pdo.setting(COB_ID)
    if not image.cob_id & EXISTS_NOT and sdo.read(cob_id) != image.cob_id:
        sdo.write(cob_id, image.cob_id)


def _write(sdo: SdoClient, entry: Entry, value: int) -> None:
    """Write a parameter of a PDO, a second time where the drive did not answer and still has the old value: that changes no other.

    Raises AbortError too for one that answers a read of it and neither of the writes; else as `SdoClient.write`."""
    for again in (False, True):
        try:
            sdo.write(entry, value)
            return
        except NoAnswerError as error:
            sdo.read(entry)  # a drive that does not answer at all ends it
            if again:
                raise AbortError(f"{sdo.name}: a write to {entry} is not answered", GENERAL) from error


def _fixed_cob_id(sdo: SdoClient, image: PdoImage, write: Callable[[Entry, int], None]) -> bool:
    """Switch the PDO off; True where that is refused and its COB-ID is the wanted one: it is changed with a count of 0 alone."""
    entry = image.pdo.setting(COB_ID)
    try:
        write(entry, image.cob_id | EXISTS_NOT)
    except AbortError as error:
        ignored = NO_RTR
        if error.code in KEPT and sdo.read(entry) & ~ignored == image.cob_id & ~ignored:
            return True
        raise
    return False


def configure(sdo: SdoClient, spec: PdoSpec) -> PdoImage:
    """Bring a PDO into force and verify it by reading back; returns the image before.

    Raises AbortError naming the PDO when a step is refused, ProtocolError when the drive holds something else.
    """
    before = read_image(sdo, spec.pdo, len(spec.entries))
    wanted = wanted_image(spec)
    if same(before, wanted):
        return before
    steps: list[Entry] = []
    try:
        write_image(sdo, wanted, steps)
    except AbortError as error:
        last = steps[-1]
        maps = last.index == spec.pdo.mapping and 0 < last.subindex <= len(spec.entries)
        raise PdoRefusedError(
            f"{spec} cannot be configured: {error}",
            error.code,
            spec,
            spec.entries[last.subindex - 1] if maps else None,
            kind=last == spec.pdo.setting(KIND),
        ) from error
    after = read_image(sdo, spec.pdo)
    if not same(after, wanted):
        raise ProtocolError(f"{sdo.name}: {spec} reads back {after}, written was {wanted}")
    return before
