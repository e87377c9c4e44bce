"""Errors of the operating system about a port, a bus or a connection, in one line with the remedy."""

from __future__ import annotations

import errno
from collections.abc import Iterator

_NO_CAN = "this kernel has no CAN: sudo modprobe can-raw, or use another interface, such as slcan"
_NO_PERMISSION = (
    "no permission: ls -l {place} names its group, sudo usermod -aG GROUP $USER adds you to it, then log in anew"
)
_NO_WAY = "are cable, address and netmask right?"
_IN_USE = "another program uses it: end that one"
_REMEDIES = {
    errno.EAFNOSUPPORT: _NO_CAN,
    errno.EPROTONOSUPPORT: _NO_CAN,
    errno.ENODEV: "there is no such channel: ip link lists them",
    errno.ENETDOWN: "sudo ip link set {place} up type can bitrate 1000000 (or the bus's other bit rate)",
    errno.ENOENT: "is the adapter plugged in, and is this its device? (ls /dev/serial/by-id)",
    errno.EACCES: _NO_PERMISSION,
    errno.EPERM: _NO_PERMISSION,
    errno.EBUSY: _IN_USE,
    errno.EAGAIN: _IN_USE,
    errno.EHOSTUNREACH: _NO_WAY,
    errno.ENETUNREACH: _NO_WAY,
    errno.ECONNREFUSED: "nothing listens there: is its server running?",
}


def told_with_remedy(error: BaseException, place: str | int) -> str:
    """The error's first line (some libraries put a traceback below it), and what to do about it where that is known.

    place: the device, channel or address, as the remedy names it.
    """
    told = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip()
    number = next((each.errno for each in causes(error) if isinstance(each, OSError) and each.errno), None)
    remedy = "" if number is None else _REMEDIES.get(number, "")
    return f"{told}; {remedy.format(place=place)}" if remedy else told


def causes(error: BaseException) -> Iterator[BaseException]:
    """An error, and those that caused it."""
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__
