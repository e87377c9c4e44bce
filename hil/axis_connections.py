"""The [drive] and [instrument] sections of an axis file: how to reach the two, and how they are set up.

What may go in: data and its checks. Concrete drives and instruments are made from it by `hil.wiring` alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil import axis_reader as reader
from hil.axis_reader import Table

BENCH_MACHINES = ("ideal", "geometric", "typical", "worn")
"""Simulated axes of the bench: without error; pitch and backlash only; with what a workshop adds (heat, lost motion, screw cyclic);
with a soft drive train that winds up by some 53 µm."""

BENCH_FACES = ("canopen", "modbus-tcp", "modbus-rtu", "virtual")
"""How the bench's drive is shown: on a virtual CAN bus, a loopback port, a pty, or with no wire in between."""

THERMOMETERS = (3, 4)
"""Temperature channels of a µMD display."""

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
    hearing us before it stops by itself, None for good. register_map: an absolute file, or the name of a shipped one. face: how the
    bench shows its drive.
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
    homing: HomingConfig = field(default_factory=HomingConfig)
    register_map: str = ""
    url: str = ""
    unit: int = 1
    baud: int = 19_200
    machine: str = "typical"
    seed: int = 0
    face: str = "canopen"


@dataclass(frozen=True)
class FixedAirConfig:
    """Air values that no sensor delivers; None: the instrument's own."""

    temp_c: float | None = None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None


@dataclass(frozen=True)
class InstrumentConfig:
    """How to reach the instrument, and how it stands. kind: umd.

    wavelength_fraction: the optics, one count is λ/2, λ/4 or λ/8; place_temps: place -> temperature channel; air_temp_channel None:
    the air's temperature is fixed_air's; axis: 1 to 3 of a display with several.
    """

    kind: str
    port: str
    wavelength_fraction: int
    direction: int
    compensate_air: bool
    place_temps: dict[str, int]
    stale_after_s: float
    vacuum_wavelength_nm: float
    axis: int
    phase_sign: int
    dead_path_mm: float
    air_temp_channel: int | None
    fixed_air: FixedAirConfig


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
        homing=_homing(table),
    )


def _modbus(table: Table) -> DriveConfig:
    base = table.path.resolve().parent

    def register_map(value: Any) -> str:
        """A file beside the axis file; what is none may be the name of a shipped map."""
        name = reader.text(value)
        beside = base / name
        return str(beside) if beside.is_file() or Path(name).suffix else name

    return DriveConfig(
        "modbus",
        register_map=table.take("register_map", register_map, "a register map's name or file"),
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
    return DriveConfig("bench", machine=machine, seed=seed, face=face, homing=_homing(table))


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


def read_instrument(table: Table, *, has_port: bool) -> InstrumentConfig:
    """[instrument]; has_port False: the bench brings its own."""
    kind = table.take("kind", reader.choice("umd"), "umd", "umd")
    air_channel = table.take("air_temp_channel", reader.choice(0, *THERMOMETERS), "3, 4, or 0 for none", 3)
    compensate_air = table.take("compensate_air", reader.flag, "true or false", True)
    fixed_air = _fixed_air(table)
    config = InstrumentConfig(
        kind=kind,
        port=table.take("port", reader.text, "a serial port", reader.REQUIRED if has_port else "bench"),
        wavelength_fraction=table.take("wavelength_fraction", reader.choice(2, 4, 8), "2, 4 or 8", 2),
        direction=table.take("direction", reader.choice(1, -1), "1 or -1", 1),
        compensate_air=compensate_air,
        place_temps=table.take("place_temps", _channels, "a table of place = channel, 3 or 4", {}),
        stale_after_s=table.take("stale_after_s", reader.positive, "a number > 0 in s", 0.5),
        vacuum_wavelength_nm=table.take(
            "vacuum_wavelength_nm", reader.between(101.0, 1999.0), "nm, 101 to 1999", 632.9912
        ),
        axis=table.take("axis", reader.choice(1, 2, 3), "1, 2 or 3", 1),
        phase_sign=table.take("phase_sign", reader.choice(1, -1), "1 or -1", 1),
        dead_path_mm=table.take("dead_path_mm", reader.between(-10_000.0, 10_000.0), "mm, -10000 to 10000", 0.0),
        air_temp_channel=air_channel or None,
        fixed_air=fixed_air,
    )
    _check_thermometers(table, config)
    table.finish()
    return config


def _fixed_air(table: Table) -> FixedAirConfig:
    air = table.child("fixed_air", required=False)
    config = FixedAirConfig(
        temp_c=air.take("temp_c", reader.between(-20.0, 60.0), "°C, -20 to 60", None),
        pressure_hpa=air.take("pressure_hpa", reader.between(500.0, 1200.0), "hPa, 500 to 1200", None),
        humidity_percent=air.take("humidity_percent", reader.between(0.0, 100.0), "%, 0 to 100", None),
    )
    air.finish()
    return config


def _channels(value: Any) -> dict[str, int]:
    if not isinstance(value, dict):
        raise TypeError
    return {reader.name(place): reader.choice(*THERMOMETERS)(channel) for place, channel in value.items()}


def _check_thermometers(table: Table, config: InstrumentConfig) -> None:
    """One thermometer is in one place; air that is compensated must have a temperature from somewhere."""
    for place, channel in config.place_temps.items():
        if channel == config.air_temp_channel:
            raise table.fail("place_temps", f"gives {place} channel {channel}, which is the air's (air_temp_channel)")
    if config.compensate_air and config.air_temp_channel is None and config.fixed_air.temp_c is None:
        raise table.fail("air_temp_channel", "is 0 and fixed_air has no temp_c, expected one of them to compensate air")
