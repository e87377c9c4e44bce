"""What the drives of all wires share when they are connected: a machine's links, and what guards a drive."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from drivers.drive import ServoDrive
from hil.axis.axis_file import DriveAxis
from hil.axis.zero import zero_keeper
from hil.machine.interrupts import stopped_by_signals

if TYPE_CHECKING:  # a verb loads the wire that its axis file names
    import canopen

    from drivers.canopen.bus import CanLink
    from drivers.modbus.endpoint import Endpoint
    from drivers.modbus.link import ModbusLink

Drive = TypeVar("Drive", bound=ServoDrive)


@dataclass
class Links:
    """Links shared by the drives of one machine: one for each CAN bus (interface, channel), one for each Modbus endpoint.

    network: a user's connected canopen.Network in place of the CAN bus that the axis files name.
    """

    can: dict[tuple[str, str], CanLink] = field(default_factory=dict)
    modbus: dict[Endpoint, ModbusLink] = field(default_factory=dict)
    network: canopen.Network | None = None


def guarded(axis: DriveAxis, drive: Drive) -> Drive:
    """The drive, stopped by a second signal, its homings recorded by the axis's zero keeper."""
    stopped_by_signals(drive)
    drive.falls_without_power = axis.falls_without_power
    zero_keeper(axis).guard(drive)
    return drive
