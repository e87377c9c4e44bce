"""Writing to a serial port. On POSIX pyserial's own `write` spins until its time-out on a port that takes nothing, and fails on one
that took everything where this process was held up for so long."""

from __future__ import annotations

import os
import select
import sys
import time

import serial


def write_now(port: serial.Serial, data: bytes) -> int:
    """Number of bytes that the port takes without waiting."""
    if sys.platform == "win32":
        return int(port.write(data) or 0)
    try:
        return os.write(port.fileno(), data)
    except BlockingIOError:
        return 0


def write_within(port: serial.Serial, data: bytes, within_s: float | None) -> None:
    """Write all of it. Raises SerialTimeoutException when the port has not taken it within `within_s` seconds, None: for ever; the
    last attempt is made after them."""
    began_s = time.monotonic()
    while True:
        left_s = None if within_s is None else within_s - (time.monotonic() - began_s)
        data = data[write_now(port, data) :]
        if not data:
            return
        if left_s is not None and left_s <= 0.0:
            raise serial.SerialTimeoutException("the port accepts no bytes")
        select.select([], [port], [], left_s)
