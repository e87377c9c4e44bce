"""Modbus drives from axis files."""

from __future__ import annotations

from drivers.clock import Clock
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.drive_values import DriveValues
from drivers.modbus.endpoint import Endpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_facts import FactLedger
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import find_map
from drivers.modbus.wear import WearLedger
from hil.axis.axis_file import DriveAxis
from hil.machine.links import Links, guarded


def modbus_drive(
    axis: DriveAxis, clock: Clock, endpoint: Endpoint, unit: int, links: Links | None = None
) -> ModbusDrive:
    """The Modbus drive of an axis file, not opened. Writes to its EEPROM are counted in the axis's store."""
    shared = Links() if links is None else links
    drive = ModbusDrive(
        axis.name,
        axis.scaling,
        axis.limits,
        clock,
        link=shared.modbus.setdefault(endpoint, ModbusLink(endpoint, clock)),
        unit=unit,
        drive_map=load_drive_map(axis.drive.register_map),
        wear=WearLedger(axis.store.directory / "eeprom-writes.json"),
        ledger=FactLedger(
            axis.store.directory / "drive-facts.json", f"{endpoint} unit {unit}", find_map(axis.drive.register_map)
        ),
    )
    return guarded(axis, drive)


def check_registers(axis: DriveAxis) -> None:
    """Raise InputError for a travel that the registers of the axis's drive do not hold. Nothing is connected."""
    DriveValues(axis.name, load_drive_map(axis.drive.register_map), axis.scaling).check_held(axis.limits.ends_mm)
