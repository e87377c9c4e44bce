"""Who answers on a bus, in one clause, for the error of a drive that does not. Reads only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from drivers.clock import Clock, WallClock
from drivers.errors import BridgeError, InputError, InstrumentLinkError, OtherAnswerError, TransportError
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from hil.axis.axis_file import DriveAxis
from hil.machine.axis_lock import modbus_endpoint

if TYPE_CHECKING:  # only the wire that is scanned is loaded
    from drivers.canopen.bus import CanLink

NODE_S, UNIT_S = 0.02, 0.15
"""Time for one answer, s: a CANopen node takes 1 to 10 ms, a Modbus drive 1 to 60 ms. All nodes take 0.4 s, the units 2.4 s."""
UNITS = range(1, 17)


def canopen_nodes(link: CanLink) -> str:
    """The nodes of an open CAN bus. Raises TransportError."""
    from drivers.canopen import scan as canopen  # noqa: PLC0415  (only the wire that is scanned is loaded)

    ids = ", ".join(str(node.node_id) for node in canopen.scan(link, canopen.ALL_NODES, timeout_s=NODE_S))
    return f"a scan found {ids}" if ids else "a scan found no node at all: bit rate, wiring, termination, power?"


def modbus_units(endpoint: Endpoint, clock: Clock) -> str:
    """The units 1 to 16 of a Modbus line. Raises TransportError."""
    from drivers.modbus import scan as modbus  # noqa: PLC0415  (as above)
    from drivers.modbus.link import ModbusLink  # noqa: PLC0415  (as above)

    quick: Endpoint
    if isinstance(endpoint, RtuEndpoint):
        quick = RtuEndpoint(endpoint.device, endpoint.baud, endpoint.parity, endpoint.stop_bits, UNIT_S)
    else:
        quick = TcpEndpoint(endpoint.host, endpoint.port, UNIT_S)
    link = ModbusLink(quick, clock, policy=modbus.POLICY)
    link.open()
    try:
        ids = ", ".join(str(unit.unit) for unit in modbus.scan(link, UNITS))
    finally:
        link.close()
    if ids:
        return f"a scan found unit {ids}"
    serial = isinstance(endpoint, RtuEndpoint)
    ask = "baud, parity, stop bits, wiring" if serial else "is this the drive's address, does the gateway reach it"
    return f"a scan found none of the units 1 to 16: {ask}?"


def who_is_there(axis: DriveAxis) -> str:
    """For a drive that did not answer: where it was looked for, and who answers there instead; "" where that cannot be told."""
    drive = axis.drive
    with suppress(BridgeError, InputError, OSError):
        if drive.backend == "canopen":
            from drivers.canopen.bus import CanLink  # noqa: PLC0415  (as above)

            clock = WallClock()
            with CanLink.open(clock, interface=drive.interface, channel=drive.channel, bitrate=drive.bitrate) as link:
                return f"looked for node {drive.node_id} on {drive.channel}; {canopen_nodes(link)}"
        if drive.backend == "modbus":
            endpoint = modbus_endpoint(axis)
            return f"looked for unit {drive.unit} on {endpoint}; {modbus_units(endpoint, WallClock())}"
    return ""


@contextmanager
def naming_who_is_there(axis: DriveAxis) -> Iterator[None]:
    """Around connecting: the error of a drive that does not answer says where it was looked for, and who answers instead."""
    try:
        yield
    except (InstrumentLinkError, OtherAnswerError):
        raise
    except TransportError as error:
        there = who_is_there(axis)
        raise type(error)(f"{error}; {there}" if there else str(error)) from error
