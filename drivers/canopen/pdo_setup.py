"""Setting up a drive's PDOs and restoring them: survey, lint, write, verify, restore.

Everything is read back. `whole_pdo` reads and writes one PDO, `pdo_lint` has the checks.
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
    Pdo,
    PdoSpec,
)
from drivers.canopen.pdo_lint import Dictionary, PdoProblem, lint, refuse_errors
from drivers.canopen.sdo import SdoClient
from drivers.canopen.whole_pdo import KEPT, PdoImage, read_otherwise, read_pdo, wanted_image, write_pdo
from drivers.cia402.objects import DataType, Entry
from drivers.errors import AbortError, BridgeError, InputError
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
    pdo, entries = image.pdo, tuple(entry_of(mapped) for mapped in image.mapped or ())
    cob_id, kind = image.numbers[False, COB_ID], image.numbers[False, KIND]
    return PdoSpec(pdo.number, pdo.transmit, cob_id & ID_MASK, kind, entries)


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
            if image.pdo not in places and image.exists and (self._alone or self._conflicts(image))
        ]

    def _conflicts(self, image: PdoImage) -> bool:
        """Whether an active PDO uses one of our COB-IDs, or could command what ours command."""
        commanded = {entry.mapping for spec in self.wanted if not spec.transmit for entry in spec.entries}
        own_id = image.numbers[False, COB_ID] & ID_MASK in {spec.cob_id for spec in self.wanted}
        return own_id or (not image.pdo.transmit and not commanded.isdisjoint(image.mapped or ()))

    def lint(self, dictionary: Dictionary | None = None) -> list[PdoProblem]:
        """Findings on the wanted PDOs together with those that remain."""
        replaced = {spec.pdo for spec in self.wanted} | {image.pdo for image in self.in_the_way()}
        staying = []
        for image in self._before:
            if image.pdo not in replaced and image.exists:
                with suppress(InputError):  # an impossible PDO of the drive itself is not checked
                    staying.append(spec_of(image))
        dictionaries = None if dictionary is None else {self._node_id: dictionary}
        return lint({self._node_id: [*self.wanted, *staying]}, dictionaries=dictionaries)

    def apply(
        self,
        dictionary: Dictionary | None = None,
        *,
        refuse: bool = True,
        interrupted: Callable[[], None] = lambda: None,
    ) -> list[PdoProblem]:
        """Survey, lint, then write and verify; returns the warnings. interrupted: called on an interrupt, before anything is restored.
        refuse: whether an error that the linter finds ends it.

        Raises InputError before anything is written when the linter finds an error; AbortError or ProtocolError, with everything
        restored, when the drive does not accept a PDO.
        """
        self.survey()
        findings = self.lint(dictionary)
        if refuse:
            refuse_errors(findings)
        try:
            for image in self.in_the_way():
                self._changed.append(image)
                try:
                    self._sdo.write(image.pdo.setting(COB_ID), image.numbers[False, COB_ID] | EXISTS_NOT)
                except AbortError as error:
                    if error.code not in KEPT or self._conflicts(image):
                        raise
                    self._changed.remove(image)  # it only adds to the load of the bus
            for spec in self.wanted:
                before = next((image for image in self._before if image.pdo == spec.pdo), None)
                before = self._found(spec) if before is None else before
                if not before.holds(wanted_image(spec)):
                    self._changed.append(before)
                    configure(self._sdo, spec, before)
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
                present = read_image(self._sdo, image.pdo, max(sub for of, sub in image.numbers if of))
                self._sdo.run(write_pdo(self._sdo, present, image, beyond=True))
            except BaseException:
                self._changed.insert(0, image)  # so that it can be tried again
                raise

        undo_all([(f"PDO {image.pdo.communication:04X}h not put back", partial(put_back, image)) for image in changed])


# -- one PDO of a drive ------------------------------------------------------------------------------------------------
def read_image(sdo: SdoClient, pdo: Pdo, entries: int = 0) -> PdoImage:
    """As `read_pdo`, of what is set up here: COB-ID, transmission type and mapping."""
    return sdo.run(read_pdo(sdo, pdo, (COB_ID, KIND), entries))


def configure(sdo: SdoClient, spec: PdoSpec, before: PdoImage) -> None:
    """Bring a PDO into force and verify it by reading back.

    Raises AbortError naming the PDO when a step is refused, ProtocolError when the drive holds something else.
    """
    wanted = wanted_image(spec)
    tried: list[Entry] = []
    try:
        sdo.run(write_pdo(sdo, before, wanted, tried=tried))
    except AbortError as error:
        last = tried[-1] if tried else None
        maps = last is not None and last.index == spec.pdo.mapping and 0 < last.subindex <= len(spec.entries)
        raise PdoRefusedError(
            f"{spec} cannot be {'configured' if tried else 'read back'}: {error}",
            error.code,
            spec,
            spec.entries[last.subindex - 1] if last is not None and maps else None,
            kind=last == spec.pdo.setting(KIND),
        ) from error
    after = read_image(sdo, spec.pdo)
    if not after.holds(wanted):
        raise read_otherwise(sdo, after, wanted)
