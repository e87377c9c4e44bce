"""From what an axis file says of a Modbus drive to the drive: address, register map, unit. What wiring imports."""

from __future__ import annotations

from pathlib import Path

from drivers.clock import Clock
from drivers.drive import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.link import LinkPolicy, ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.wear import WearLedger
from drivers.modbus.wire import parse_endpoint
from drivers.scaling import AxisScaling


def modbus_link(url: str, clock: Clock, *, baud: int = 19200, policy: LinkPolicy | None = None) -> ModbusLink:
    """A link, not yet open, to `tcp://host:port` or a serial device; drives on one line share one link.

    Options follow the address: `?timeout_s=0.3`, on a serial device also `&parity=N&stop_bits=2`. Raises InputError.
    """
    return ModbusLink(parse_endpoint(url, baud=baud), clock, policy=policy)


def modbus_drive(
    name: str,
    scaling: AxisScaling,
    limits: DriveLimits,
    clock: Clock,
    *,
    link: ModbusLink,
    unit: int,
    register_map: str | Path,
    wear_file: Path | None = None,
) -> ModbusDrive:
    """A drive, not yet open. register_map: a file, or the name of a shipped map; wear_file: where EEPROM writes are counted.

    Raises InputError naming file, line and key of a map that cannot be used.
    """
    return ModbusDrive(
        name,
        scaling,
        limits,
        clock,
        link=link,
        unit=unit,
        drive_map=load_drive_map(register_map),
        wear=WearLedger(wear_file),
    )
