"""Lock of an axis against other processes, by its axis file and by the address of its drive.

The address is locked besides the file because two axis files may name the same drive, as a copy with another store does.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from drivers.errors import InputError
from drivers.modbus.endpoint import Endpoint, TcpEndpoint, parse_endpoint
from hil.axis.axis_file import DriveAxis
from hil.records.files import held_by_name, held_place


@contextmanager
def held_axis(axis: DriveAxis) -> Iterator[None]:
    """Hold the lock of this axis and of its drive until the block ends or the process dies.

    Raises InputError, naming the axis file, while another process holds either.
    """
    place = drive_address(axis)
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


def drive_address(axis: DriveAxis) -> str | None:
    """Address of the drive: interface, channel and node id; host, port and unit; or serial device and unit.

    None for the bench's drive, which no other process can reach. Two names of one device or host give the same address.
    """
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
    """Endpoint of the axis file's Modbus url. Raises InputError naming the axis file and what is wrong with the url."""
    try:
        return parse_endpoint(axis.drive.url, baud=axis.drive.baud)
    except InputError as error:
        raise InputError(f"[drive] url: {error.what}", path=axis.path) from error


def _device(channel: str) -> str:
    """A device file with symbolic links resolved, without the bit rate that python-can's slcan takes after an @."""
    name = channel.partition("@")[0]
    return os.path.realpath(name) if name.startswith("/") else channel


def _host(host: str) -> str:
    """The host's lowest IP address, or the name in lower case where it does not resolve (connecting then fails)."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return host.lower()
    return min(str(address[4][0]) for address in found)
