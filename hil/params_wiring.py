"""From axis files to their drives' parameters: the concrete lines and nodes behind `hil.params`.

Drives on one bus share one link, so that work on them runs side by side. Nothing is opened for motion, enabled or moved.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from drivers.canopen.bus import CanLink
from drivers.canopen.eds import load_eds
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.side_by_side import CanLine
from drivers.canopen.table_map import load_table_map
from drivers.clock import WallClock
from drivers.errors import CapabilityError, InputError
from drivers.raw_parameters import RawParameters
from hil.axis import DriveAxis
from hil.files import held
from hil.params.journal import Journal
from hil.wiring import bench_parameters
from sim_backends.bench import Bench
from sim_backends.canopen_in_turn import drives_in_turn

Bus = tuple[str, str]
"""python-can's interface and channel."""


@contextmanager
def connected_parameters(axes: Sequence[DriveAxis]) -> Iterator[list[RawParameters]]:
    """The parameters of each axis's drive, in the order of the axes. Reading and writing only; nothing is set up in a drive.

    Raises InputError for an axis given twice or in use by another process, CapabilityError for a drive without parameters on a wire,
    and whatever connecting raises.
    """
    with ExitStack() as stack:
        lines: dict[Bus, CanLine] = {}
        drives = []
        for axis in axes:
            if any(other.name == axis.name for other in axes if other is not axis):
                raise InputError(f"axis {axis.name} is given twice, expected different ones", path=axis.path)
            stack.enter_context(held(axis.path))
            drives.append(_drive(axis, lines, stack))
        yield drives


@contextmanager
def unconnected_parameters(axes: Sequence[DriveAxis]) -> Iterator[list[RawParameters]]:
    """The same without a wire: what the drives' files say of their parameters. Work on them is never answered."""
    with ExitStack() as stack:
        lines: dict[Bus, CanLine] = {}
        for axis in axes:
            bus = axis.drive.interface, axis.drive.channel
            link = CanLink.open(WallClock(), interface="virtual", channel=f"nobody-{uuid.uuid4().hex}")
            lines.setdefault(bus, CanLine(stack.enter_context(link)))
        yield [_canopen(axis, (axis.drive.interface, axis.drive.channel), lines, stack) for axis in axes]


def journal_of(axis: DriveAxis) -> Journal:
    """Where an axis's downloads are noted."""
    return Journal(axis.store.directory / "parameters")


def _drive(axis: DriveAxis, lines: dict[Bus, CanLine], stack: ExitStack) -> RawParameters:
    if axis.drive.backend == "canopen":
        return _canopen(axis, (axis.drive.interface, axis.drive.channel), lines, stack)
    if axis.drive.backend == "bench" and axis.drive.face == "canopen":
        bench = stack.enter_context(Bench(bench_parameters(axis)))
        channel = f"bench-{uuid.uuid4().hex}"
        bus = stack.enter_context(drives_in_turn(bench.clock, channel))
        bus.add(bench.servo, axis.drive.node_id, parameters=bench.parameters.objects)
        lines["virtual", channel] = CanLine(stack.enter_context(CanLink(bus.master(), bench.clock)))
        return _canopen(axis, ("virtual", channel), lines, stack)
    raise CapabilityError(
        f"axis {axis.name}: its drive ({axis.drive.backend}) has no parameters that could be written as a set"
    )


def _canopen(axis: DriveAxis, bus: Bus, lines: dict[Bus, CanLine], stack: ExitStack) -> RawParameters:
    config, (interface, channel) = axis.drive, bus
    if bus not in lines:
        bitrate = None if interface == "virtual" else config.bitrate
        link = CanLink.open(WallClock(), interface=interface, channel=channel, bitrate=bitrate)
        lines[bus] = CanLine(stack.enter_context(link))
    eds = None if config.eds is None else load_eds(config.eds, config.node_id)
    table = load_table_map(config.correction_table) if config.correction_table else None
    drive = CanOpenRawParameters(
        axis.name, lines[bus], config.node_id, eds, table=table, timeout_s=config.sdo_timeout_s, bitrate=config.bitrate
    )
    stack.callback(drive.close)
    return drive
