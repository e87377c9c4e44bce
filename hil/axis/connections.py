"""The [drive] section of an axis file: how to reach the drive, and how it is set up.

What may go in: data and its checks. Concrete drives are made from it by `hil.machine.wiring` alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from drivers.toml_schema import Document, either, shown
from drivers.toml_types import Count, File, Limits, Number, Positive, Text, Via, one_of
from hil.axis import BENCH_MACHINES, BENCH_TABLES

BENCH_FACES = ("canopen", "modbus-tcp", "modbus-rtu", "virtual")
"""How the bench's drive is shown: on a virtual CAN bus, a loopback port, a pty, or with no wire in between."""

GUARD_S = 2.0
"""How long a drive on a machine goes on without hearing us, unless its axis file says otherwise."""

_MAPS = ("cia402_over_modbus", "vendor_style")
_KEYS = {
    "canopen": "interface channel bitrate node_id axis sdo_timeout_s sample_timeout_s heartbeat_s guard_s eds homing correction_table"
    " velocity_unit acceleration_unit modes simulated like",
    "modbus": "register_map url unit baud simulated like",
    "bench": "machine seed like face homing correction_table profile velocity_unit acceleration_unit modes",
    "bench over Modbus": "machine seed like face register_map",
}
_NEEDS = {"canopen": ["node_id"], "modbus": ["register_map", "url"]}


def _period(seconds: float, _: Document) -> float | None:
    if seconds != 0 and not 0.01 <= seconds <= 60.0:
        raise ValueError
    return seconds or None


def _map_file(name: str, document: Document) -> str:
    """A file beside the axis file; what is none may be the name of a shipped map."""
    beside = document.path.resolve().parent / name
    return str(beside) if beside.is_file() or Path(name).suffix else name


Period = Annotated[float | None, Via(Number, _period, "seconds, 0.01 to 60, or 0 for none")]
MapFile = Annotated[str, Via(Text, _map_file, "a map's name or file")]


@dataclass(frozen=True)
class HomingConfig:
    """What is written to the drive before homing; None leaves it as the drive has it.

    method: of 6098h; negative ones are the maker's.
    """

    method: Annotated[int, Limits(ge=-128, le=127)] | None = None
    speed_switch_mm_s: Positive | None = None
    speed_zero_mm_s: Positive | None = None
    home_position_mm: Number | None = None


@dataclass(frozen=True)
class DriveConfig:
    """How to reach the drive. backend: canopen | modbus | bench (the built-in simulated machine).

    heartbeat_s: period asked of a CANopen drive, None when it is not to be supervised; guard_s: how long the drive goes on without
    hearing us before it stops by itself, None for good. eds: the maker's file of a CANopen drive's objects; correction_table: the map
    of the table that it holds itself, a file or the name of a shipped one, empty where it holds none. register_map: an absolute file,
    or the name of a shipped one. face: how the bench shows its drive; profile: of the documented drive that it then is (`hil sim drive
    --help` lists them), empty for the standard's.

    axis: of a CANopen node with several. velocity_unit, acceleration_unit: of a CANopen drive that does not state them, in the form of
    `drivers.scaling.motion_unit`. modes: numbers of 6060h of one without 6502h; empty: they are tried at standstill.
    """

    backend: Annotated[str, one_of("canopen", "modbus", "bench")]
    interface: Annotated[Text, Limits(description="an interface of python-can")] = "socketcan"
    channel: Annotated[Text, Limits(description="a channel such as can0")] = "can0"
    bitrate: Annotated[int, Limits(ge=10_000, le=1_000_000)] = 1_000_000
    node_id: Annotated[int, Limits(ge=1, le=127)] = 1
    sdo_timeout_s: Annotated[float, Limits(ge=0.01, le=60.0)] = 0.5
    sample_timeout_s: Annotated[float, Limits(ge=0.01, le=10.0)] = 0.1
    heartbeat_s: Period = 0.2
    guard_s: Period = None
    eds: Annotated[File | None, Limits(description="the maker's EDS or DCF file")] = None
    homing: HomingConfig = field(default_factory=HomingConfig)
    register_map: MapFile = ""
    url: Annotated[Text, Limits(description="tcp://host:port or a serial port")] = ""
    unit: Annotated[int, Limits(ge=0, le=255)] = 1
    baud: Annotated[int, Limits(ge=300, le=4_000_000)] = 19_200
    machine: Annotated[str, one_of(*BENCH_MACHINES)] = "typical"
    seed: Count = 0
    like: Annotated[File | None, Limits(description="the folder of a real axis's campaigns")] = None
    face: Annotated[str, one_of(*BENCH_FACES)] = "canopen"
    correction_table: MapFile = ""
    profile: Annotated[str, Limits(description="the name of a drive profile")] = ""
    axis: Annotated[int, Limits(ge=1, le=8)] = 1
    velocity_unit: Annotated[Text | None, Limits(description='a unit such as "rpm"')] = None
    acceleration_unit: Annotated[Text | None, Limits(description='a unit such as "rpm/s"')] = None
    modes: tuple[Annotated[int, Limits(ge=1, le=10)], ...] = ()
    simulated: bool = False

    @property
    def is_simulated(self) -> bool:
        """Whether the machine is: the bench, or the process of a `hil sim`."""
        return self.simulated or self.backend == "bench"


def read_drive(document: Document) -> DriveConfig:
    """[drive]. Keys are those of the backend; another backend's are unknown."""
    given = document.table("drive")
    backend = str(given.get("backend"))
    over_modbus = backend == "bench" and str(given.get("face")).startswith("modbus")
    keys = _KEYS.get("bench over Modbus" if over_modbus else backend)
    usual: dict[str, Any] = {"guard_s": GUARD_S} if backend == "canopen" else {}
    if over_modbus:
        usual = {"register_map": _MAPS[0]}
    config = document.load(
        DriveConfig,
        "drive",
        only=None if keys is None else ["backend", *keys.split()],
        needs=_NEEDS.get(backend, ()),
        usual=usual,
    )
    for key, shipped in (("register_map", _MAPS), ("correction_table", BENCH_TABLES)):
        if backend == "bench" and key in given and getattr(config, key) not in shipped:
            raise document.fail(f"drive.{key}", f"is {shown(given[key])}, expected {either(shipped)}")
    for key in ("machine", "seed"):
        if key in given and config.like is not None:
            raise document.fail(f"drive.{key}", "is not simulated beside like, expected one of the two")
    if config.like is not None and not config.is_simulated:
        raise document.fail("drive.like", "is of a simulated machine, and this one is not said to be simulated")
    if config.profile and config.face != "canopen":
        raise document.fail("drive.profile", f"is for face canopen, the face is {config.face}")
    return config
