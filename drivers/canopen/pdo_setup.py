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
    NO_RTR,
    PdoImage,
    PdoSpec,
    same,
    wanted_image,
)
from drivers.canopen.pdo_lint import Cycle, Dictionary, Finding, lint, refuse_errors
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError, BridgeError, InputError, NoAnswerError, ProtocolError
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
                place = 0x1800 if transmit else 0x1400
                wanted = next((spec for spec in self.wanted if spec.communication == place + number - 1), None)
                probe = wanted or PdoSpec(number, transmit, 0, 0, ())
                try:
                    images.append(read_image(self._sdo, probe))
                except AbortError:
                    break  # no further PDO, or one that does not show what it maps
        self._before = images
        return images

    def in_the_way(self) -> list[PdoImage]:
        """Active PDOs that are not wanted and would interfere: they command the same objects, or use our COB-IDs."""
        places = {spec.communication for spec in self.wanted}
        return [
            image
            for image in self._before
            if image.communication not in places
            and not image.cob_id & EXISTS_NOT
            and (self._alone or self._conflicts(image))
        ]

    def _conflicts(self, image: PdoImage) -> bool:
        """Whether an active PDO uses one of our COB-IDs, or could command what ours command."""
        commanded = {entry.mapping for spec in self.wanted if not spec.transmit for entry in spec.entries}
        own_id = image.cob_id & ID_MASK in {spec.cob_id for spec in self.wanted}
        return own_id or (image.communication < 0x1800 and not commanded.isdisjoint(image.mapped))

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
                    self._sdo.write(_communication(image.communication, 1), image.cob_id | EXISTS_NOT)
                except AbortError as error:
                    if error.code not in KEPT or self._conflicts(image):
                        raise
                    self._changed.remove(image)  # it only adds to the load of the bus
            for spec in self.wanted:
                before = next((image for image in self._before if image.communication == spec.communication), None)
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
            return read_image(self._sdo, spec)
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
        _beyond(sdo, spec, count),
    )


def _beyond(sdo: SdoClient, spec: PdoSpec, count: int) -> tuple[int, ...]:
    """Entries behind the mapped ones that the spec would overwrite; as far as the drive shows them."""
    found: list[int] = []
    for subindex in range(count + 1, len(spec.entries) + 1):
        try:
            found.append(sdo.read(_mapping(spec.mapping, subindex)))
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
    write(_mapping(image.mapping, 0), 0)
    for subindex, mapped in enumerate(image.mapped, start=1):
        write(_mapping(image.mapping, subindex), mapped)
    for subindex, mapped in enumerate(image.beyond, start=len(image.mapped) + 1):
        with suppress(AbortError):  # behind the mapped ones: a drive may refuse what cannot be mapped
            sdo.write(_mapping(image.mapping, subindex), mapped)
    write(_mapping(image.mapping, 0), len(image.mapped))
    kind = _communication(image.communication, 2)
    try:
        write(kind, image.kind)
    except AbortError as error:
        if error.code != READ_ONLY or sdo.read(kind) != image.kind:
            raise
    if not image.cob_id & EXISTS_NOT and not fixed:
        write(_communication(image.communication, 1), image.cob_id)


def _put_back(sdo: SdoClient, image: PdoImage) -> None:
    """Write an earlier image. A drive whose mapping is read-only has it still: only type and COB-ID are written then."""
    try:
        write_image(sdo, image)
        return
    except AbortError:
        direction = PdoSpec(image.communication % 0x400 + 1, image.communication >= 0x1800, 0, 0, ())
        if read_image(sdo, direction).mapped != image.mapped:
            raise
    kind = _communication(image.communication, 2)
    if sdo.read(kind) != image.kind:
        sdo.write(kind, image.kind)
    cob_id = _communication(image.communication, 1)
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
    entry = _communication(image.communication, 1)
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
    before = read_image(sdo, spec)
    wanted = wanted_image(spec)
    if same(before, wanted):
        return before
    steps: list[Entry] = []
    try:
        write_image(sdo, wanted, steps)
    except AbortError as error:
        last = steps[-1]
        maps = last.index == spec.mapping and 0 < last.subindex <= len(spec.entries)
        raise PdoRefusedError(
            f"{spec} cannot be configured: {error}",
            error.code,
            spec,
            spec.entries[last.subindex - 1] if maps else None,
            kind=last.index == spec.communication and last.subindex == 2,
        ) from error
    after = read_image(sdo, spec)
    if not same(after, wanted):
        raise ProtocolError(f"{sdo.name}: {spec} reads back {after}, written was {wanted}")
    return before
