"""Notes on makers' drives: what is documented of each, from whom, and what an axis file has to say because of it.

    [drive]        name, wire, description, maker, and where what is said comes from; vendor_id (1018h:1 of a CANopen drive)
    [[facts]]      one statement each, with topic, source and strength
    [[axis_file]]  a key of [drive] that an axis file of this drive needs, with its value; `unless` names an object whose presence
                   makes it needless; a key without a value only the user knows, one of `choices`

A drive that cannot be described as a register map has notes as well; `no_file` says why. Nothing here acts on a drive: the CANopen
driver finds out by itself what a drive has, and `hil doctor` proves its units.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated

from drivers.facts import Strength
from drivers.files import shipped
from drivers.toml_schema import Document
from drivers.toml_types import Key, Limits, SchemaError, Text, Via, not_empty


class DriveWire(Enum):
    """What the drive is reached by."""

    CANOPEN = "CANopen"
    MODBUS = "Modbus"


class Topic(Enum):
    """What a statement is about."""

    UNITS = "units"
    LIMITS = "limits"
    PDO = "PDOs"
    HOMING = "homing"
    FAULT_RESET = "fault reset"
    STATES = "states"
    MODES = "modes"
    SUPERVISION = "supervision"
    OBJECTS = "objects"
    REGISTERS = "registers"
    ENCODER = "encoder"


@dataclass(frozen=True)
class NotedFact:
    """One statement. does: what hil does about it, "" where it needs nothing."""

    topic: Topic
    says: Text
    source: Text
    strength: Strength
    does: Text = ""


def _object(text: str, _: Document) -> int:
    if len(text) != 5 or text[-1] != "h":
        raise ValueError
    return int(text[:-1], 16)


@dataclass(frozen=True)
class AxisFileKey:
    """A key of an axis file's [drive]. value: what it is to be, None where the user chooses of `choices`; both as text.

    unless: an object whose presence states it already.
    """

    key: Annotated[str, Limits(pattern=r"\A(velocity_unit|acceleration_unit|modes|heartbeat_s|axis)\Z")]
    why: Text
    source: Text
    strength: Strength
    value: Text | None = None
    choices: tuple[Text, ...] = ()
    unless: Annotated[int | None, Via(Text, _object, "an object such as 60A9h")] = None

    def __post_init__(self) -> None:
        if (self.value is None) is (not self.choices):
            raise SchemaError("", "lacks value or choices, expected one of them")

    @property
    def option(self) -> str:
        """The option of `hil drives new` that answers it."""
        return f"--{self.key.replace('_', '-')}"

    def line(self, value: str) -> str:
        numeric = self.key in ("modes", "heartbeat_s", "axis")
        return f"{self.key} = {value}" if numeric else f'{self.key} = "{value}"'


@dataclass(frozen=True)
class _Head:
    """[drive]"""

    name: Text
    wire: DriveWire
    description: Text
    maker: Text
    source: Text
    revision: Text = "not stated"
    verified_on_hardware: bool = False
    vendor_id: Annotated[int, Limits(ge=1, le=0xFFFFFFFF)] | None = None
    no_file: Text = ""


@dataclass(frozen=True)
class DriveNotes:
    """What is noted of one drive."""

    head: Annotated[_Head, Key("drive")]
    facts: Annotated[tuple[NotedFact, ...], not_empty]
    axis_file: tuple[AxisFileKey, ...] = ()


def load_drive_notes(path: Path) -> DriveNotes:
    """Read a file of notes. Raises InputError naming file, line and key."""
    return Document.read(path).load(DriveNotes)


def shipped_notes() -> dict[str, DriveNotes]:
    """The notes that come with the package, by name."""
    paths = shipped("drivers.canopen", "drive_notes") | shipped("drivers.modbus", "drive_notes")
    return {name: load_drive_notes(path) for name, path in sorted(paths.items())}
