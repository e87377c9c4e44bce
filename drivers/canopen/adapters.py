"""CAN adapters by python-can: opening one, with reason and remedy in one line where it cannot be, and what a failed read means.

python-can's interfaces raise errors of any kind, the same ones for a line that is no frame and for an adapter that was unplugged.
"""

from __future__ import annotations

import os
import re
import socket
import struct
import sys
from collections.abc import Mapping

import can
import serial

from drivers.errors import LinkLostError
from drivers.serial_writing import write_within
from drivers.system_errors import causes, told_with_remedy

READ_ERRORS = (can.CanError, OSError, ValueError, TypeError, LookupError, struct.error, EOFError)
"""Raised by python-can's interfaces for what they read: by slcan ValueError, IndexError, by serial struct.error, TypeError."""
SEND_S = 0.25
"""Longest time that an interface may delay a frame while its transmit buffer is full, s. A serial adapter whose other end (a
process or a USB stack on a loaded host) does not read for a moment is not lost: delays above 10 ms were measured."""

_INSTALL = {
    "canalystii": 'the Python package "canalystii"',
    "cantact": 'the Python package "cantact"',
    "etas": "ETAS BOA, on Windows",
    "gs_usb": 'the Python package "gs-usb"',
    "iscan": "Thorsis' isCAN driver, on Windows",
    "ixxat": "HMS' IXXAT VCI driver, on Windows",
    "kvaser": "Kvaser's driver with CANlib",
    "neousys": "Neousys' WDT_DIO driver",
    "neovi": 'the Python package "python-ics"',
    "nican": "NI-CAN, on Windows",
    "nixnet": "NI-XNET, on Windows",
    "pcan": "PEAK's driver with PCAN-Basic",
    "systec": "SYS TEC's USB-CANmodul driver, on Windows",
    "udp_multicast": 'the Python package "msgpack"',
    "usb2can": "8devices' USB2CAN driver, on Windows",
    "vector": "Vector's XL driver library, on Windows",
}
_IN_THE_KERNEL = ("gs_usb", "ixxat", "kvaser", "pcan", "systec", "usb2can")
"""Interfaces whose adapters have a driver in Linux, so that socketcan serves them."""


def open_adapter(interface: str, channel: str | int, settings: Mapping[str, object]) -> can.BusABC:
    """A python-can bus. Raises LinkLostError, which says what to install or to do."""
    try:
        bus = can.Bus(channel=channel, interface=interface, **settings)  # type: ignore[arg-type]
    except Exception as error:  # a missing library shows as an ImportError, a NameError, an AttributeError
        raise LinkLostError(f"CAN {interface} {channel} cannot be opened: {_why(interface, channel, error)}") from error
    bound_sending(bus)
    return bus


def place_of(bus: can.BusABC) -> str:
    """What to call a bus that was opened elsewhere."""
    return type(bus).__name__ if bus.channel_info == can.BusABC.channel_info else bus.channel_info


def _why(interface: str, channel: str | int, error: Exception) -> str:
    told = told_with_remedy(error, channel)
    if interface not in can.VALID_INTERFACES:
        return f"python-can has no such interface, but {', '.join(sorted(can.VALID_INTERFACES))}"
    if isinstance(error, TypeError) and (lacking := re.findall(r"'(\w+)'", told)):
        lines = "".join(f" {name} = …" for name in lacking)
        return f"it also needs {' and '.join(lacking)}: write them to ~/can.conf, below [default], as{lines}"
    if interface in _INSTALL and isinstance(
        error, (ImportError, NameError, AttributeError, NotImplementedError, OSError)
    ):
        without = sys.platform == "linux" and interface in _IN_THE_KERNEL
        other = ", or use socketcan, which needs no such library" if without else ""
        return f"install {_INSTALL[interface]}{other} ({re.sub(r' [(]/.*[)]', '', told)})"
    return told


# -- reading -----------------------------------------------------------------------------------------------------------
def is_gone(error: Exception) -> bool:
    """Whether a failed read shows a lost adapter: the operating system refused it. Any other error may be of one damaged piece."""
    return any(isinstance(each, OSError) for each in causes(error))


def drop_undecoded(bus: can.BusABC) -> None:
    """Discard the bytes that an interface has kept and cannot decode: slcan and socketcand (python-can 4.6) would fail at them again
    with every later frame. slcan also discards what waits in the port."""
    if (flush := getattr(bus, "flush", None)) is not None:
        flush()
    elif hasattr(bus, "_SocketCanDaemonBus__receive_buffer"):
        bus._SocketCanDaemonBus__receive_buffer = ""


# -- sending -----------------------------------------------------------------------------------------------------------
def bound_sending(bus: can.BusABC) -> None:
    """Bound the time that `send` may block: behind a TCP connection (socketcand), which ignores its time-out, the socket gets one of
    `SEND_S`, so that sending fails when the server no longer reads; a serial port writes by `write_within`. Other interfaces keep the
    time-out themselves, or never wait.
    """
    port = getattr(bus, "serialPortOrig", None)  # of slcan
    if isinstance(port, serial.Serial) and sys.platform != "win32":
        port.write = lambda data: write_within(port, bytes(data), port.write_timeout)  # type: ignore[method-assign]
    try:
        number = os.dup(bus.fileno())
    except (OSError, NotImplementedError, ValueError):
        return  # no descriptor that the operating system could time
    try:
        own = socket.socket(fileno=number)
    except OSError:  # a serial port
        os.close(number)
        return
    with own:
        if own.family in (socket.AF_INET, socket.AF_INET6) and own.type == socket.SOCK_STREAM:
            limit = struct.pack("@ll", 0, round(SEND_S * 1e6))
            own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
