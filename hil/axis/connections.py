"""The [drive] section of an axis file: how to reach the drive, and how it is set up.

What may go in: data and its checks. Concrete drives are made from it by `hil.machine.wiring` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.axis import reader
from hil.axis.reader import Table

BENCH_MACHINES = ("ideal", "geometric", "typical", "worn")
"""Simulated axes of the bench: without error; pitch and backlash only; with what a workshop adds (heat, lost motion, screw cyclic);
with a soft drive train that winds up by some 53 µm."""

BENCH_FACES = ("canopen", "modbus-tcp", "modbus-rtu", "virtual")
"""How the bench's drive is shown: on a virtual CAN bus, a loopback port, a pty, or with no wire in between."""

BENCH_TABLES = ("simulated_array", "simulated_domain")
"""Correction tables that the bench's drive can hold itself; over Modbus it has that of its register map."""

GUARD_S = 2.0
"""How long a drive on a machine goes on without hearing us, unless its axis file says otherwise."""
_HOMING_METHODS = (-128, 127)  # 6098h is a signed byte; negative ones are the maker's


@dataclass(frozen=True)
class HomingConfig:
    """What is written to the drive before homing; None leaves it as the drive has it."""

    method: int | None = None
    speed_switch_mm_s: float | None = None
    speed_zero_mm_s: float | None = None
    home_position_mm: float | None = None


@dataclass(frozen=True)
class DriveConfig:
    """How to reach the drive. backend: canopen | modbus | bench (the built-in simulated machine).

    heartbeat_s: period asked of a CANopen drive, None when it is not to be supervised; guard_s: how long the drive goes on without
    hearing us before it stops by itself, None for good. eds: the maker's file of a CANopen drive's objects; correction_table: the map
    of the table that it holds itself, a file or the name of a shipped one, empty where it holds none. register_map: an absolute file,
    or the name of a shipped one. face: how the bench shows its drive.
    """

    backend: str
    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: int = 1_000_000
    node_id: int = 1
    sdo_timeout_s: float = 0.5
    sample_timeout_s: float = 0.1
    heartbeat_s: float | None = 0.2
    guard_s: float | None = None
    eds: Path | None = None
    homing: HomingConfig = field(default_factory=HomingConfig)
    register_map: str = ""
    url: str = ""
    unit: int = 1
    baud: int = 19_200
    machine: str = "typical"
    seed: int = 0
    face: str = "canopen"
    correction_table: str = ""


def read_drive(table: Table) -> DriveConfig:
    """[drive]. Keys are those of the backend; another backend's are unknown."""
    backend = table.take("backend", reader.choice("canopen", "modbus", "bench"), "canopen, modbus or bench")
    config = {"canopen": _canopen, "modbus": _modbus, "bench": _bench}[backend](table)
    table.finish()
    return config


def _canopen(table: Table) -> DriveConfig:
    return DriveConfig(
        "canopen",
        interface=table.take("interface", reader.text, "an interface of python-can", "socketcan"),
        channel=table.take("channel", reader.text, "a channel such as can0", "can0"),
        bitrate=table.take("bitrate", reader.whole(10_000, 1_000_000), "bit/s, 10000 to 1000000", 1_000_000),
        node_id=table.take("node_id", reader.whole(1, 127), "a node id, 1 to 127"),
        sdo_timeout_s=table.take("sdo_timeout_s", reader.between(0.01, 60.0), "seconds, 0.01 to 60", 0.5),
        sample_timeout_s=table.take("sample_timeout_s", reader.between(0.01, 10.0), "seconds, 0.01 to 10", 0.1),
        heartbeat_s=table.take("heartbeat_s", _period, "seconds, 0.01 to 60, or 0 for none", 0.2),
        guard_s=table.take("guard_s", _period, "seconds, 0.01 to 60, or 0 for none", GUARD_S),
        eds=table.take("eds", _beside(table), "the maker's EDS or DCF file", None),
        homing=_homing(table),
        correction_table=table.take("correction_table", _map_file(table), "a table map's name or file", ""),
    )


def _beside(table: Table) -> Callable[[Any], Path]:
    """A file, by its place beside the axis file."""
    return lambda value: table.path.resolve().parent / reader.text(value)


def _map_file(table: Table) -> Callable[[Any], str]:
    """A file beside the axis file; what is none may be the name of a shipped map."""

    def convert(value: Any) -> str:
        name = reader.text(value)
        beside = table.path.resolve().parent / name
        return str(beside) if beside.is_file() or Path(name).suffix else name

    return convert


def _modbus(table: Table) -> DriveConfig:
    return DriveConfig(
        "modbus",
        register_map=table.take("register_map", _map_file(table), "a register map's name or file"),
        url=table.take("url", reader.text, "tcp://host:port or a serial port"),
        unit=table.take("unit", reader.whole(0, 255), "a unit id, 0 to 255", 1),
        baud=table.take("baud", reader.whole(300, 4_000_000), "baud, 300 to 4000000", 19_200),
    )


def _bench(table: Table) -> DriveConfig:
    machine = table.take("machine", reader.choice(*BENCH_MACHINES), " or ".join(BENCH_MACHINES), "typical")
    seed = table.take("seed", reader.whole(0, 2**31), "a whole number >= 0", 0)
    face = table.take("face", reader.choice(*BENCH_FACES), " or ".join(BENCH_FACES), "canopen")
    if face.startswith("modbus"):
        maps = ("cia402_over_modbus", "vendor_style")
        register_map = table.take("register_map", reader.choice(*maps), " or ".join(maps), maps[0])
        return DriveConfig("bench", machine=machine, seed=seed, face=face, register_map=register_map)
    own_table = table.take("correction_table", reader.choice(*BENCH_TABLES), " or ".join(BENCH_TABLES), "")
    return DriveConfig(
        "bench", machine=machine, seed=seed, face=face, homing=_homing(table), correction_table=own_table
    )


def _homing(table: Table) -> HomingConfig:
    homing = table.child("homing", required=False)
    config = HomingConfig(
        method=homing.take("method", reader.whole(*_HOMING_METHODS), "a method of 6098h, -128 to 127", None),
        speed_switch_mm_s=homing.take("speed_switch_mm_s", reader.positive, "a number > 0 in mm/s", None),
        speed_zero_mm_s=homing.take("speed_zero_mm_s", reader.positive, "a number > 0 in mm/s", None),
        home_position_mm=homing.take("home_position_mm", reader.finite, "a position in mm", None),
    )
    homing.finish()
    return config


def _period(value: Any) -> float | None:
    seconds = reader.not_negative(value)
    return None if seconds == 0 else reader.between(0.01, 60.0)(seconds)
