"""DrivesToStop: the connected drives, for whoever has to stop them from outside the thread that works with them.

The command line, or a script's first connection, makes one for the process and hands it down as a context variable: a drive is made
deep in the wiring, for some twenty verbs and the threads of the operator's screen, none of which has anything to decide about it.
"""

from __future__ import annotations

import weakref
from contextvars import ContextVar
from typing import TypeVar

from drivers.drive import ServoDrive

Drive = TypeVar("Drive", bound=ServoDrive)


class DrivesToStop:
    """Drives as long as anybody else keeps them."""

    def __init__(self) -> None:
        self._drives: list[weakref.ref[ServoDrive]] = []

    def add(self, drive: ServoDrive) -> None:
        """A drive that is not open has nothing to stop: `send_stop` then does nothing."""
        self._drives.append(weakref.ref(drive, self._drives.remove))

    def send_stop(self) -> None:
        """Tell all of them. For any thread; never raises and waits for nothing, as `ServoDrive.send_stop`."""
        for reference in tuple(self._drives):
            drive = reference()
            if drive is not None:
                drive.send_stop()


DRIVES_TO_STOP: ContextVar[DrivesToStop | None] = ContextVar("drives to stop", default=None)
"""Of this process, where it has any."""


def stopped_by_signals(drive: Drive) -> Drive:
    """The drive; from now on it is among those of this process."""
    drives = DRIVES_TO_STOP.get()
    if drives is not None:
        drives.add(drive)
    return drive
