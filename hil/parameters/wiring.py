"""Connects the parameters of drives from axis files. Drives on one bus share one link. No drive is opened for motion or enabled."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from drivers.canopen.bus import CanLink
from drivers.canopen.eds import load_eds
from drivers.canopen.node import Node
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.side_by_side import CanLine
from drivers.canopen.table_map import load_table_map
from drivers.clock import Clock, Waiting, WallClock
from drivers.errors import CapabilityError, InputError
from drivers.modbus.endpoint import Endpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.raw_parameters import ModbusLine, ModbusRawParameters
from drivers.modbus.wear import WearLedger
from drivers.raw_parameters import RawParameters
from hil.axis.axis_file import DriveAxis
from hil.machine.axis_lock import held_axis, modbus_endpoint
from hil.machine.bench_wiring import RunningBench, running_bench
from hil.parameters.journal import Journal

Bus = tuple[str, str]
"""python-can's interface and channel."""


@dataclass
class _Lines:
    """Links shared by the drives. waiting: the waits of their clocks go through it."""

    waiting: Waiting | None = None
    can: dict[Bus, CanLine] = field(default_factory=dict)
    modbus: dict[Endpoint, ModbusLine] = field(default_factory=dict)

    @property
    def wall_clock(self) -> Clock:
        return WallClock(self.waiting)


@contextmanager
def connected_parameters(
    axes: Sequence[DriveAxis], waiting: Waiting | None = None, bench: RunningBench | None = None
) -> Iterator[list[RawParameters]]:
    """The parameters of each axis's drive, in the order of the axes. Connecting writes nothing to a drive.

    waiting: the waits of the drives' clocks go through it, so that another thread can end a wait
    bench: the simulated machine of an axis with backend "bench", which runs; None: one is made
    Raises InputError for an axis given twice or in use by another process, CapabilityError for a drive without parameters on a wire,
    and what connecting raises.
    """
    with ExitStack() as stack:
        lines = _Lines(waiting)
        drives = []
        for axis in axes:
            if any(other.name == axis.name for other in axes if other is not axis):
                raise InputError(f"axis {axis.name} is given twice, expected different ones", path=axis.path)
            stack.enter_context(held_axis(axis))
            drives.append(_drive(axis, lines, stack, bench))
        yield drives


@contextmanager
def unconnected_parameters(axes: Sequence[DriveAxis]) -> Iterator[list[RawParameters]]:
    """As `connected_parameters`, without a wire: the drives' files are used, accesses are never answered. Raises as it does."""
    with ExitStack() as stack:
        lines = _Lines()
        clock = WallClock()
        drives: list[RawParameters] = []
        for axis in axes:
            if axis.drive.backend == "modbus":
                endpoint = modbus_endpoint(axis)
                drives.append(_modbus(axis, lines.modbus.setdefault(endpoint, ModbusLine(ModbusLink(endpoint, clock)))))
                continue
            bus = axis.drive.interface, axis.drive.channel
            if bus not in lines.can:
                name = f"nobody-{uuid.uuid4().hex}"
                link = CanLink.open(clock, interface="virtual", channel=name, bitrate=axis.drive.bitrate)
                lines.can[bus] = CanLine(stack.enter_context(link))
            drives.append(_canopen(axis, bus, lines, stack))
        yield drives


def journal_of(axis: DriveAxis) -> Journal:
    """The journals of an axis's downloads, in its store."""
    return Journal(axis.store.directory / "parameters")


def _drive(axis: DriveAxis, lines: _Lines, stack: ExitStack, running: RunningBench | None) -> RawParameters:
    if axis.drive.backend == "canopen":
        return _canopen(axis, (axis.drive.interface, axis.drive.channel), lines, stack)
    if axis.drive.backend == "modbus":
        endpoint = modbus_endpoint(axis)
        if endpoint not in lines.modbus:
            link = ModbusLink(endpoint, lines.wall_clock)
            link.open()
            stack.callback(link.close)
            lines.modbus[endpoint] = ModbusLine(link)
        return _modbus(axis, lines.modbus[endpoint])
    if axis.drive.backend == "bench":
        can = (running or stack.enter_context(running_bench([axis], waiting=lines.waiting))).can
        if can is not None:
            bus = ("bench", axis.name)
            lines.can[bus] = CanLine(
                stack.enter_context(CanLink(can.master(waits=True), can.clock, axis.drive.bitrate))
            )
            return _canopen(axis, bus, lines, stack)
    raise CapabilityError(
        f"axis {axis.name}: its drive ({axis.drive.backend}) has no parameters that could be written as a set"
    )


def _canopen(axis: DriveAxis, bus: Bus, lines: _Lines, stack: ExitStack) -> RawParameters:
    config, (interface, channel) = axis.drive, bus
    if bus not in lines.can:
        link = CanLink.open(lines.wall_clock, interface=interface, channel=channel, bitrate=config.bitrate)
        lines.can[bus] = CanLine(stack.enter_context(link))
    eds = None if config.eds is None else load_eds(config.eds, config.node_id)
    table = load_table_map(config.correction_table) if config.correction_table else None
    node = Node(axis.name, lines.can[bus].link, config.node_id, eds, table)
    node.open(config.sdo_timeout_s)
    stack.callback(node.close)
    return CanOpenRawParameters(
        node,
        lines.can[bus],
        scaling=axis.scaling,
        velocity_unit=config.velocity_unit,
        acceleration_unit=config.acceleration_unit,
    )


def _modbus(axis: DriveAxis, line: ModbusLine) -> RawParameters:
    return ModbusRawParameters(
        axis.name,
        line,
        axis.drive.unit,
        load_drive_map(axis.drive.register_map),
        wear=WearLedger(axis.store.directory / "eeprom-writes.json"),
    )
