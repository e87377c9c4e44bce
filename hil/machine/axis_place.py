"""The place of an axis's drive on a real wire, and holding an axis against other processes.

Two axis files may name one drive: a copy with another store, a second name. So an axis is held by its file and by its drive's place.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from drivers.errors import InputError
from drivers.modbus.wire import Endpoint, TcpEndpoint, parse_endpoint
from hil.axis.axis_file import DriveAxis
from hil.records.files import held_by_name, held_place


@contextmanager
def held_axis(axis: DriveAxis) -> Iterator[None]:
    """Nobody else connects this axis, by its file or by another one that names its drive, until the block ends or the process dies.

    Raises InputError, naming the axis file, while somebody has it.
    """
    place = drive_place(axis)
    with ExitStack() as stack:
        stack.enter_context(held_by_name(axis.path))
        if place is not None:
            try:
                stack.enter_context(held_place(place))
            except InputError as error:
                raise InputError(
                    f"its drive ({place}) is in use already, by another axis file, expected one process at a time",
                    path=axis.path,
                ) from error
        yield


def drive_place(axis: DriveAxis) -> str | None:
    """Interface, channel and node id, host, port and unit, or serial device and unit; None for the bench's drive, which has no place
    that another process could reach. Two names of one device or host give the same place."""
    drive = axis.drive
    if drive.backend == "canopen":
        interface = drive.interface.lower()
        own = f" of process {os.getpid()}" if interface == "virtual" else ""  # python-can's virtual bus ends with it
        return f"CAN {interface} {_device(drive.channel)}{own} node {drive.node_id}"
    if drive.backend == "modbus":
        endpoint = modbus_endpoint(axis)
        if isinstance(endpoint, TcpEndpoint):
            return f"Modbus {_host(endpoint.host)}:{endpoint.port} unit {drive.unit}"
        return f"Modbus {_device(endpoint.device)} unit {drive.unit}"
    return None


def modbus_endpoint(axis: DriveAxis) -> Endpoint:
    """Raises InputError naming the axis file and what is wrong with its url."""
    try:
        return parse_endpoint(axis.drive.url, baud=axis.drive.baud)
    except InputError as error:
        raise InputError(f"[drive] url: {error.what}", path=axis.path) from error


def _device(channel: str) -> str:
    """A device file by its one real name; python-can's slcan takes a bit rate behind it, after an @."""
    name = channel.partition("@")[0]
    return os.path.realpath(name) if name.startswith("/") else channel


def _host(host: str) -> str:
    """Its first address; the name where it has none now, which connecting will tell."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return host.lower()
    return min(str(address[4][0]) for address in found)
