"""Checks of a set before the first write: every entry is checked, every objection is listed. And how long it takes. Does no I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.drive import WITHOUT_POWER, DriveState
from drivers.errors import InputError, ProtocolError
from drivers.parameters import ParameterKind
from drivers.raw_parameters import DriveIdentity, RawParameter, RawParameters, WireTime
from hil.correction.store import BoundTables
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.records.made_with import same

_NAMED = 4
"""Number of addresses named of each kind that is left out."""
_AGREES = 1e-6
"""Relative tolerance between an entry's value and its raw form."""


@dataclass(frozen=True)
class Objection:
    """Why something is not written. address: "" for the drive as a whole; name: of a register its address; line: in the set's file."""

    address: str
    name: str
    why: str
    line: int | None = None

    def __str__(self) -> str:
        place = " ".join(part for part in dict.fromkeys((self.address, self.name)) if part)
        line = "" if self.line is None else f"line {self.line}: "
        return f"{line}{place}: {self.why}" if place else f"{line}{self.why}"


@dataclass(frozen=True)
class Wanted:
    """One entry of a set as the drive's bytes. after: addresses written before it."""

    parameter: RawParameter
    data: bytes
    after: tuple[str, ...] = ()

    @property
    def address(self) -> str:
        return self.parameter.address


def match_set(drive: RawParameters, contents: ParameterSet) -> tuple[list[Wanted], list[Objection]]:
    """The set as the drive's bytes, and objections: missing, wrong type, out of limits, read-only, moves the axis.

    What is no parameter is an objection in a set of this program, and left out of one of a commissioning tool.
    """
    wanted: list[Wanted] = []
    objections: list[Objection] = []
    missing: list[str] = []
    for entry in contents.entries:
        parameter = drive.find(entry.address)
        if contents.foreign and parameter is not None and parameter.refusal is not None:
            continue  # `left_out` lists it
        if parameter is None and contents.foreign:
            missing.append(entry.address)
            continue
        if parameter is None:
            meant = f"{entry.address.upper()}h"
            hint = "" if drive.find(f"{meant}:00") is None else f", expected {meant}"
            objections.append(
                Objection(entry.address, entry.name, f"the drive's file has no such parameter{hint}", entry.line)
            )
            continue
        try:
            data = data_of(drive, parameter, entry)
            for other in entry.after:
                if other not in contents.addresses:
                    raise InputError(f"is to come after {other}, which is not in the set")
        except InputError as error:
            unfit = error.what.removeprefix(f"{parameter.title}: ")  # the objection names it
            objections.append(Objection(entry.address, parameter.info.name, unfit, entry.line))
            continue
        why = drive.objection(parameter, data)
        if why is not None:
            objections.append(Objection(entry.address, parameter.info.name, why, entry.line))
        wanted.append(Wanted(parameter, data, entry.after))
    if missing:
        what = f"{len(missing)} objects of the set are not in the drive's file ({_listed(missing)})"
        objections.append(Objection("", "", f"{what}: expected the axis file's eds to have them"))
    return wanted, objections


def unless_held(
    drive: RawParameters, objections: Sequence[Objection], wanted: Sequence[Wanted], held: Mapping[str, bytes]
) -> list[Objection]:
    """The objections but those to a value that the drive holds already: what a drive holds is never out of range, nor written."""
    same = {
        each.address
        for each in wanted
        if each.parameter.refusal is None
        and each.address in held
        and drive.same(each.parameter, held[each.address], each.data)
    }
    return [each for each in objections if each.address not in same]


def _listed(addresses: Sequence[str]) -> str:
    return ", ".join(addresses[:_NAMED]) + (", …" if len(addresses) > _NAMED else "")


def left_out(drive: RawParameters, contents: ParameterSet) -> str:
    """What of a commissioning tool's set is no parameter and never written, by kind in one line; "" for nothing."""
    if not contents.foreign:
        return ""
    kinds: dict[str, list[str]] = {}
    for entry in contents.entries:
        parameter = drive.find(entry.address)
        if parameter is not None and parameter.refusal is not None:
            kinds.setdefault(parameter.kind, []).append(entry.address)
    listed = [f"{kind}: {len(found)} ({_listed(found)})" for kind, found in sorted(kinds.items())]
    return f"left out are {'; '.join(listed)}" if listed else ""


def notes_of_file(drive: RawParameters) -> list[str]:
    """The deviations that were accepted in a drive's maker's file, by kind; empty without a file."""
    return [f"the maker's file: {note}" for note in drive.file_notes]


def objections_to_file(drive: RawParameters, found: DriveIdentity) -> list[Objection]:
    """Objections to the maker's file of a drive: it is of another vendor or product than the drive reports."""
    return [Objection("", "", why) for why in drive.doubts_of_file(found)]


def data_of(drive: RawParameters, parameter: RawParameter, entry: SetEntry) -> bytes:
    """An entry as the drive's bytes. Raises InputError for a type, value or raw form that does not fit, or that contradict each
    other."""
    if entry.type and entry.type.upper() != parameter.type.upper():
        raise InputError(f"is a {entry.type} in the set, the drive's is a {parameter.type}")
    if entry.raw is None:
        if entry.value is None:
            raise InputError("has neither value nor raw")
        data = _encoded(drive, parameter, entry)
        outside = drive.outside(parameter, entry.value)
        if outside is not None and drive.objection(parameter, data) is None:
            raise InputError(outside)  # rounding would put it within
        return data
    data = drive.from_raw(parameter, entry.raw)
    if entry.value is not None and not _agree(drive, parameter, entry, data):
        try:
            shown = f"{drive.decode(parameter, data)!r}"
        except ProtocolError as error:
            shown = str(error)
        raise InputError(
            f"value {entry.value!r} and raw {entry.raw!r} do not agree: raw is {shown}; remove raw to write the value"
        )
    return data


def _encoded(drive: RawParameters, parameter: RawParameter, entry: SetEntry) -> bytes:
    value, kind = entry.value, parameter.info.kind
    if value is None:
        raise InputError("has no value")
    rounded = kind is ParameterKind.INTEGER and isinstance(value, float) and not value.is_integer()
    if rounded or isinstance(value, bool):
        raise InputError(f"{value!r} is no {kind.value}")
    if kind is ParameterKind.BYTES and isinstance(value, str):
        try:
            return bytes.fromhex(value)
        except ValueError as error:
            raise InputError(f"{value!r} is to be bytes, expected hexadecimal digits") from error
    return drive.encode(parameter, value)


def _agree(drive: RawParameters, parameter: RawParameter, entry: SetEntry, data: bytes) -> bool:
    if drive.same(parameter, _encoded(drive, parameter, entry), data):
        return True
    shown = drive.decode(parameter, data)
    if isinstance(shown, float) and isinstance(entry.value, int | float):
        return abs(shown - entry.value) <= _AGREES * max(abs(shown), abs(entry.value))
    return False


def objections_to_identity(
    meant: DriveIdentity | None, found: DriveIdentity, *, any_version: bool = False, same_unit: bool = False
) -> list[Objection]:
    """Objections to writing a set of the identity `meant` to the drive `found`.

    Another model is always an objection, another revision or firmware unless any_version, another serial number if same_unit.
    """
    if meant is None:
        return []
    if meant.protocol != found.protocol:
        return [Objection("", "", f"the set is for a drive on {meant.protocol}, this one is on {found.protocol}")]
    parts = [_differences("is for", meant.model, found.model)]
    if not any_version:
        parts.append(_differences("was read with", meant.version, found.version))
    if same_unit:
        parts.append(_differences("is of the drive with", meant.unit, found.unit))
    return [Objection("", "", why) for part in parts for why in part]


def _differences(verb: str, meant: Mapping[str, int | str], found: Mapping[str, int | str]) -> Sequence[str]:
    return [
        f"the set {verb} {name.replace('_', ' ')} {_shown(value)}, this drive has {_shown(found.get(name))}"
        for name, value in meant.items()
        if found.get(name) != value
    ]


def _shown(value: int | str | None) -> str:
    if value is None:
        return "none"
    return f"{value:#x}" if isinstance(value, int) else repr(value)


def objection_to_state(state: DriveState) -> Objection | None:
    """An objection unless the drive is disabled (`WITHOUT_POWER`)."""
    if state in WITHOUT_POWER:
        return None
    return Objection("", "", f"the drive is {state.value}: parameters are written while it is disabled")


# -- the tables that the bridge applies --------------------------------------------------------------------------------
def objections_to_reversal(
    drive: RawParameters,
    tables: BoundTables,
    backlash: Sequence[str],
    wanted: Sequence[Wanted],
    old: Mapping[str, bytes],
) -> list[Objection]:
    """Objections to another amount of the drive's own backlash compensation than tables that take the reversal out were made with.

    backlash: its addresses by the axis file, which count where the tables state none; old: what the drive holds
    """
    if tables.corrects_reversal is False:
        return []
    made_with = {} if tables.made_with is None else tables.made_with.backlash
    objections = []
    for each in wanted:
        if each.address not in made_with and each.address not in backlash:
            continue
        present = None if each.address not in old else drive.decode(each.parameter, old[each.address])
        was, value = made_with.get(each.address, present), drive.decode(each.parameter, each.data)
        if isinstance(was, int | float) and isinstance(value, int | float) and not same(was, value):
            objections.append(
                Objection(
                    each.address,
                    each.parameter.info.name,
                    f"would be {value:g}, the stored tables of axis {tables.axis} were made with {was:g} and would take the reversal"
                    " out a second time; leave it out of the set, or take the tables out of force first (hil calibrate --withdraw) and"
                    " calibrate again",
                )
            )
    return objections


def notes_of_units(drive: RawParameters, tables: BoundTables, wanted: Sequence[Wanted]) -> list[str]:
    """That the stored tables do not hold with the units of a set, one line each."""
    units = {} if tables.made_with is None else tables.made_with.units
    notes = []
    for each in wanted:
        value, was = drive.decode(each.parameter, each.data), units.get(each.address)
        if was is not None and isinstance(value, int | float) and not same(was, value):
            notes.append(
                f"{each.address} {each.parameter.info.name}: the stored tables of axis {tables.axis} were made with {was:g} and are"
                f" refused with {value:g}: calibrate again"
            )
    return notes


# -- the time on the bus -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Prediction:
    """One drive's share. look: reading every entry once; write: writing and reading back all of them."""

    drive: str
    look: WireTime
    write: WireTime

    @property
    def whole(self) -> WireTime:
        """look and write together."""
        return self.look + self.write

    def as_json(self) -> dict[str, Any]:
        """As `--json` writes it."""
        return {"drive": self.drive, "look": vars(self.look), "write": vars(self.write)}


def predict(drive: RawParameters, wanted: Sequence[Wanted]) -> Prediction:
    """Prediction of a download that writes all of them, from the sizes of its accesses. Nothing is sent or measured."""
    every = [(each.address, each.data) for each in wanted]
    return Prediction(drive.name, drive.cost(every, []), drive.cost(every, every))


def seconds_together(costs: Sequence[WireTime], answer_s: float = 0.0) -> float:
    """Duration at most, s, for drives served side by side on one bus. answer_s: a drive's own time for one answer, s.

    It is the longer of the bus time of all drives and the bus and answer time of the slowest drive.
    """
    return max(sum(cost.seconds for cost in costs), *(cost.seconds + answer_s * cost.answers for cost in costs), 0.0)
