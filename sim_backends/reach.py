"""Restriction of simulated parts to this machine, unless access from outside is allowed explicitly.

A simulated drive on a real bus answers in place of a real drive, and one on a network port can be moved by any other host; so
whatever leaves the machine is refused by default.
"""

from __future__ import annotations

import ipaddress
from pathlib import Path

from drivers.errors import InputError

_VIRTUAL_DEVICES = Path("/sys/devices/virtual")
_NETWORK_DEVICES = Path("/sys/class/net")


def check_can(interface: str, channel: str, *, allow_outside: bool, devices: Path = _NETWORK_DEVICES) -> None:
    """Raise InputError for a CAN interface whose frames may leave this machine, unless that is allowed.

    `virtual` is refused in any case: it does not reach other processes.
    """
    if interface == "virtual":
        raise InputError("CAN interface virtual reaches this process only, expected socketcan on a vcan, or slcan-pty")
    if allow_outside or interface == "slcan-pty":
        return
    if interface != "socketcan":
        raise InputError(
            f"CAN interface {interface} may reach real hardware or a network, expected socketcan on a vcan, slcan-pty,"
            " or --allow-outside"
        )
    device = devices / channel
    if device.exists() and not device.resolve().is_relative_to(_VIRTUAL_DEVICES):
        raise InputError(f"CAN channel {channel} is real hardware, expected a vcan, or --allow-outside")


def parse_tcp(text: str, *, allow_outside: bool) -> tuple[str, int]:
    """`host:port` -> (host, port); port 0: a free one is chosen. Raises InputError for an address that other hosts can reach."""
    host, colon, number = text.rpartition(":")
    if not colon or not number.isdecimal() or not int(number) <= 0xFFFF:
        raise InputError(f"address {text!r}, expected host:port with a port 0 to 65535, such as 127.0.0.1:0")
    host = "127.0.0.1" if host == "localhost" else host
    try:
        loopback = ipaddress.IPv4Address(host).is_loopback
    except ValueError as error:
        raise InputError(f"address {text!r}: {host!r} is no IPv4 address") from error
    if not loopback and not allow_outside:
        raise InputError(f"address {text!r} can be reached from outside, expected 127.0.0.1:PORT, or --allow-outside")
    return host, int(number)
