"""Profiles of documented drives, as data: one TOML file per drive in sim_backends/profiles, each fact with its source beside it.

    [drive]       maker, model, wire: "CANopen", or "CoE" where the source saw the same objects over EtherCAT
    [axis_file]   what an axis file has to state for it, as a user who has read the notes would
    [[fact]]      says, source, strength, and the switches of the simulated drive that follow from it (`Switches`)

A switch stands in one fact only. A fact without a switch says how the drive is where the simulated drive already is so. Everything is
"as documented in" its source: no profile was verified on hardware.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

from drivers.errors import InputError
from drivers.toml_schema import Document
from drivers.toml_types import Limits, Positive, SchemaError, Text, Via, not_empty, one_of
from sim_backends import profile_paths
from sim_backends.canopen_dictionary import Key
from sim_backends.maker_file import MakerFile, MotionUnits, motion_units, read_maker_file

STRENGTHS = ("maker", "run", "notes", "assumed")
"""The maker's own text or file; seen on the drive by whoever wrote the source; notes from a manual; assumed to make it run here."""
MAPPINGS = ("free", "kept")
"""What a drive does with a mapping that it has accepted: it takes it, or keeps its own."""
STATES = ("always", "enabled", "fault")
BASE = Path(__file__).with_name("servo_drive.eds")
COUNTS_PER_REV = 65_536
"""Of a drive whose profile does not state its encoder."""
_OBJECT = re.compile(r"([0-9A-F]{4})h(?::([0-9A-F]{2}))?")
_TYPES = {"i8": "0x2", "i16": "0x3", "i32": "0x4", "u8": "0x5", "u16": "0x6", "u32": "0x7"}


@dataclass(frozen=True)
class Place:
    """An object; subindex None means all of it."""

    index: int
    subindex: int | None

    @property
    def key(self) -> Key:
        """Index and subindex, 0 where none is named."""
        return self.index, self.subindex or 0

    def holds(self, key: Key) -> bool:
        """Whether an entry belongs to it."""
        return key[0] == self.index and self.subindex in (None, key[1])

    def __str__(self) -> str:
        return f"{self.index:04X}h" + ("" if self.subindex is None else f":{self.subindex:02X}")


def _place(text: str, _: Document) -> Place:
    match = _OBJECT.fullmatch(text)
    if match is None:
        raise ValueError
    return Place(int(match[1], 16), None if match[2] is None else int(match[2], 16))


Object = Annotated[Place, Via(str, _place, 'an object such as "6098h" or "6099h:01"')]
Objects = Annotated[tuple[Object, ...], not_empty]
Values = Mapping[Object, int]
Kinds = Annotated[tuple[Annotated[int, Limits(ge=0, le=255)], ...], not_empty]
Methods = Annotated[tuple[Annotated[int, Limits(ge=-128, le=127)], ...], not_empty]
Word = Annotated[int, Limits(ge=0, le=0xFFFF)]


@dataclass(frozen=True)
class Switches:
    """How the drive differs from the standard's; each default is the standard.

    Objects: missing and read_only; added, with their types; values as delivered; lowest and highest; not_mapped into PDOs;
    unanswered: a write gets no answer and has no effect; changing: it changes by itself.
    Units, of one on the wire: velocity_rpm or velocity_counts_s; acceleration_rpm_s, acceleration_rev_s2 or
    acceleration_counts_s2; counts_per_rev: position counts per motor revolution; start_counts: position shown until it is homed.
    PDOs: numbers of RPDOs and TPDOs; pdo_entries: most objects in one; pdo_mapping: one of `MAPPINGS`; pdo_switched_off: whether
    bit 31 of the COB-ID switches one off; mapped_once: an object goes into one PDO of a direction only; rpdo_kinds: transmission
    types.
    Homing: homing_methods that are taken, others are refused; homing_ignored: methods that are answered and not taken;
    homing_moves: False shows the homing as attained where the axis stands; homing_reached: whether bit 10 ends it.
    States: statusword_bits: set in each of `STATES`; fault_bit_until_shutdown: bit 3 stays after a reset; error_codes: standard to
    maker's; quick_stop_shown: False shows switch on disabled from the command on; quick_stop_ends; quick_stop_resumes: enable
    operation is accepted with 605Ah 1 to 4, with the brake engaged; mode_shown_enabled: 6061h follows 6060h only while enabled;
    mode_in_halt: whether 6060h can be written while bit 8 is set; not_ready_at_first: until a controlword came.
    Handshake: acknowledged_until_arrival: bit 12 stays set during the move.
    Time: loop_s: interval at which 6040h is looked at; sdo_emergency: an EMCY precedes each such answer.
    """

    missing: Objects = ()
    read_only: Objects = ()
    added: Mapping[Object, Annotated[str, one_of(*_TYPES)]] = field(default_factory=dict)
    values: Values = field(default_factory=dict)
    lowest: Values = field(default_factory=dict)
    highest: Values = field(default_factory=dict)
    not_mapped: Objects = ()
    unanswered: Objects = ()
    changing: Objects = ()
    counts_per_rev: Annotated[int, Limits(ge=4, le=2**31)] | None = None
    start_counts: int = 0
    velocity_rpm: Positive | None = None
    velocity_counts_s: Positive | None = None
    acceleration_rpm_s: Positive | None = None
    acceleration_rev_s2: Positive | None = None
    acceleration_counts_s2: Positive | None = None
    rpdos: Annotated[int, Limits(ge=0, le=4)] = 4
    tpdos: Annotated[int, Limits(ge=0, le=4)] = 4
    pdo_entries: Annotated[int, Limits(ge=1, le=64)] = 8
    pdo_mapping: Annotated[str, one_of(*MAPPINGS)] = "free"
    pdo_switched_off: bool = True
    mapped_once: bool = False
    rpdo_kinds: Kinds = ()
    homing_methods: Methods = ()
    homing_ignored: Methods = ()
    homing_moves: bool = True
    homing_reached: bool = True
    statusword_bits: Mapping[Annotated[str, one_of(*STATES)], Word] = field(default_factory=dict)
    fault_bit_until_shutdown: bool = False
    error_codes: Mapping[Annotated[int, Via(str, lambda text, _: int(text, 16), 'a code such as "8611"')], Word] = (
        field(default_factory=dict)
    )
    quick_stop_shown: bool = True
    quick_stop_ends: Annotated[str, one_of("switch on disabled", "switched on")] = "switch on disabled"
    quick_stop_resumes: bool = False
    mode_shown_enabled: bool = False
    mode_in_halt: bool = True
    not_ready_at_first: bool = False
    acknowledged_until_arrival: bool = False
    loop_s: Annotated[float, Limits(ge=0.0, le=0.1)] = 0.0
    sdo_emergency: Annotated[int, Limits(ge=0, le=1000)] = 0


@dataclass(frozen=True)
class Fact(Switches):
    """One documented property, its source and how strong that is, with the switches that follow."""

    says: Text = ""
    source: Text = ""
    strength: Annotated[str, one_of(*STRENGTHS)] = ""

    def __post_init__(self) -> None:
        for name in ("says", "source", "strength"):
            if not getattr(self, name):
                raise SchemaError("", f"lacks {name}: every fact has says, source and strength")

    @property
    def given(self) -> dict[str, Any]:
        """The switches that differ from the standard."""
        usual = Switches()
        named = {one.name: getattr(self, one.name) for one in fields(Switches)}
        return {name: value for name, value in named.items() if value != getattr(usual, name)}


@dataclass(frozen=True)
class _Drive:
    maker: Text
    model: Text
    wire: Annotated[str, one_of("CANopen", "CoE")]


@dataclass(frozen=True)
class AxisFileKeys:
    """Keys of [drive] of an axis file for the drive, and of [drive.homing]; None is not written."""

    velocity_unit: Text | None = None
    acceleration_unit: Text | None = None
    homing_method: Annotated[int, Limits(ge=-128, le=127)] | None = None
    homing_speed_switch_mm_s: Positive | None = None
    homing_speed_zero_mm_s: Positive | None = None

    @property
    def drive(self) -> dict[str, str]:
        named = {"velocity_unit": self.velocity_unit, "acceleration_unit": self.acceleration_unit}
        return {name: value for name, value in named.items() if value is not None}

    @property
    def homing(self) -> dict[str, float]:
        """Those of [drive.homing]."""
        named = {
            "method": self.homing_method,
            "speed_switch_mm_s": self.homing_speed_switch_mm_s,
            "speed_zero_mm_s": self.homing_speed_zero_mm_s,
        }
        return {name: value for name, value in named.items() if value is not None}


@dataclass(frozen=True)
class _File:
    drive: _Drive
    fact: Annotated[tuple[Fact, ...], not_empty]
    axis_file: AxisFileKeys = field(default_factory=AxisFileKeys)


@dataclass(frozen=True)
class DriveProfileFile:
    """A profile: its facts, and the switches that they set together."""

    name: str
    maker: str
    model: str
    wire: str
    facts: tuple[Fact, ...]
    axis_file: AxisFileKeys
    switches: Switches

    def over(self, maker: MakerFile | None = None) -> MakerFile:
        """The objects of the drive: those of a maker's file, or of the simulated drive without makers' own, changed by the facts."""
        base = read_maker_file(BASE) if maker is None else maker
        s = self.switches
        texts: dict[Key, dict[str, str]] = {
            key: dict(entry) for key, entry in base.texts.items() if maker is not None or not 0x2000 <= key[0] < 0x6000
        }
        for place, kind in s.added.items():
            texts[place.key] = {"datatype": _TYPES[kind], "accesstype": "rw", "pdomapping": "1", "defaultvalue": "0"}
            if place.subindex:
                texts.setdefault((place.index, 0), {"datatype": "0x5", "accesstype": "ro", "defaultvalue": "1"})
        pdos = ((0x1400, s.rpdos), (0x1600, s.rpdos), (0x1800, s.tpdos), (0x1A00, s.tpdos))
        gone = [Place(base + number, None) for base, count in pdos for number in range(count, 4)]
        for key in [key for key in texts if any(place.holds(key) for place in (*s.missing, *gone))]:
            del texts[key]
        for key, entry in texts.items():
            if any(place.holds(key) for place in s.read_only):
                entry["accesstype"] = "ro"
            if any(place.holds(key) for place in s.not_mapped):
                entry["pdomapping"] = "0"
        for name, values in (("defaultvalue", s.values), ("lowlimit", s.lowest), ("highlimit", s.highest)):
            for place, value in values.items():
                if place.key in texts:
                    texts[place.key][name] = str(value)
                elif maker is None:
                    raise InputError(f"profile {self.name}: {place} has a {name} and is no object of the drive")
        device = {"vendorname": self.maker, "productname": self.model} | dict(base.device if maker is not None else {})
        return MakerFile(base.path, texts, device)

    def units(self, objects: MakerFile, lead_m: float) -> MotionUnits:
        """What one unit on the wire is, in turns of the shaft: by the profile, else by the objects."""
        s = self.switches
        counts = s.counts_per_rev or COUNTS_PER_REV
        told = MotionUnits(1.0 / counts, 1.0 / counts, 1.0 / counts)
        if objects.path != BASE:
            told = motion_units(objects, counts, lead_m)
        position = 1.0 / s.counts_per_rev if s.counts_per_rev else told.position_rev
        velocity, acceleration = told.velocity_rev_s, told.acceleration_rev_s2
        if s.velocity_rpm is not None:
            velocity = acceleration = s.velocity_rpm / 60.0
        elif s.velocity_counts_s is not None:
            velocity = acceleration = s.velocity_counts_s * position
        if s.acceleration_rpm_s is not None:
            acceleration = s.acceleration_rpm_s / 60.0
        elif s.acceleration_rev_s2 is not None:
            acceleration = s.acceleration_rev_s2
        elif s.acceleration_counts_s2 is not None:
            acceleration = s.acceleration_counts_s2 * position
        return MotionUnits(position, velocity, acceleration, f"profile {self.name}")


def load_profile(name_or_path: str | Path) -> DriveProfileFile:
    """A profile by its name, or from a file. Raises InputError naming file, line and key."""
    known = profile_paths()
    path = known.get(str(name_or_path), Path(name_or_path))
    if not path.is_file():
        raise InputError(f"profile {str(name_or_path)!r}, expected a file or one of {', '.join(known)}")
    document = Document.read(path)
    read = document.load(_File)
    merged = Switches()
    said: dict[str, int] = {}
    for at, fact in enumerate(read.fact):
        for name, value in fact.given.items():
            before = getattr(merged, name)
            if name in said and not isinstance(value, dict | tuple):
                raise document.fail(("fact", at, name), f"is set by fact {said[name] + 1} already")
            said[name] = at
            merged = replace(merged, **{name: _joined(before, value, document, at, name)})
    drive = read.drive
    return DriveProfileFile(path.stem, drive.maker, drive.model, drive.wire, read.fact, read.axis_file, merged)


def _joined(before: Any, value: Any, document: Document, at: int, name: str) -> Any:
    if isinstance(value, dict):
        _refuse_twice(before.keys() & value.keys(), document, at, name)
        return {**before, **value}
    if isinstance(value, tuple):
        _refuse_twice(set(before) & set(value), document, at, name)
        return (*before, *value)
    return value


def _refuse_twice(twice: Iterable[object], document: Document, at: int, name: str) -> None:
    for one in twice:
        raise document.fail(("fact", at, name), f"names {one}, which another fact names already")
