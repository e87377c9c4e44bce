"""The device side of an slcan adapter on a pseudo-terminal: a CAN bus of two nodes between processes, without kernel support.

The ASCII protocol of Lawicel adapters (CAN232 manual: S, s, O, L, C, t, T, r, R, V, N, F; CR is yes, BEL is no) as the
device speaks it. A process that opens `path` with python-can's slcan interface is the other node on the bus.
"""

from __future__ import annotations

import os
import select
import time
import tty
from typing import Any

import can

_YES, _NO = b"\r", b"\a"
_LONGEST_LINE = 64
_ROOM_BYTES = (
    4000  # a terminal's line discipline holds 4095; what does not fit is lost, as in a device with a full buffer
)
_IDENTIFIER_DIGITS = {"t": 3, "r": 3, "T": 8, "R": 8}


class SlcanDevice(can.BusABC):
    """An adapter as the host sees it on its serial port, and a python-can bus on this side.

    Frames sent while the host's channel is closed (no O or L received) are lost, as on a bus without a receiver.
    """

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._line = b""
        self._lines: list[bytes] = []
        self._unsent = b""
        self._open = False
        self._listen_only = False
        super().__init__(self.path)
        self.channel_info = self.path

    def fileno(self) -> int:
        return self._master

    def shutdown(self) -> None:
        """Close the terminal; the host then sees its port vanish."""
        super().shutdown()
        if self._master >= 0:
            os.close(self._slave)
            os.close(self._master)
            self._master = self._slave = -1

    # -- from the host -------------------------------------------------------------------------------------------------
    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end_s = None if timeout is None else time.monotonic() + timeout
        while True:
            while self._lines:
                message = self._obey(self._lines.pop(0).decode("ascii", errors="replace"))
                if message is not None:
                    return message, False
            left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
            if not select.select([self._master], [], [], left_s)[0]:
                return None, False
            self._read()

    def _read(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        *whole, rest = (self._line + data).split(b"\r")
        self._lines += whole
        self._line = rest[-_LONGEST_LINE:]

    def _obey(self, line: str) -> can.Message | None:
        """Process one line of the host; a frame that it sends is returned."""
        command = line[:1]
        if command in _IDENTIFIER_DIGITS:
            message = _frame(line) if self._open and not self._listen_only else None
            self._answer(_NO if message is None else (b"z\r" if command in "tr" else b"Z\r"))
            return message
        if command in ("O", "L"):
            self._open, self._listen_only = True, command == "L"
        elif command == "C":
            self._open = False
        elif command in ("V", "N"):
            self._answer(f"{command}1013".encode())
        elif command == "F":
            self._answer(b"F00")
        elif command not in ("", "S", "s", "Z"):
            self._answer(_NO)
            return None
        if command:
            self._answer(_YES)
        return None

    # -- to the host ---------------------------------------------------------------------------------------------------
    def _answer(self, text: bytes) -> None:
        if len(self._unsent) + len(text) > _ROOM_BYTES:
            return
        self._unsent += text
        try:
            written = os.write(self._master, self._unsent)
        except BlockingIOError:
            return
        self._unsent = self._unsent[written:]

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to the host, if its channel is open."""
        del timeout
        if not self._open:
            return
        kind = ("R" if msg.is_extended_id else "r") if msg.is_remote_frame else ("T" if msg.is_extended_id else "t")
        identifier = f"{msg.arbitration_id:0{_IDENTIFIER_DIGITS[kind]}X}"
        payload = "" if msg.is_remote_frame else bytes(msg.data).hex().upper()
        self._answer(f"{kind}{identifier}{msg.dlc}{payload}\r".encode())


def _frame(line: str) -> can.Message | None:
    """A transmit command as a frame; None for another line."""
    kind, digits = line[0], _IDENTIFIER_DIGITS[line[0]]
    try:
        identifier, length = int(line[1 : 1 + digits], 16), int(line[1 + digits])
        data = bytes.fromhex(line[2 + digits :])
    except (ValueError, IndexError):
        return None
    remote, extended = kind in "rR", kind in "TR"
    if length > 8 or identifier > (0x1FFFFFFF if extended else 0x7FF) or len(data) != (0 if remote else length):
        return None
    fields: dict[str, Any] = {"arbitration_id": identifier, "is_extended_id": extended, "is_remote_frame": remote}
    return can.Message(dlc=length, data=data, **fields)
