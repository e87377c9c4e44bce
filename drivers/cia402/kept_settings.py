"""KeptSettings: objects of one open drive that are written for a while, and put back as they were found."""

from __future__ import annotations

from functools import partial

from drivers.cia402 import objects
from drivers.cia402.objects import Entry
from drivers.cia402.wire import ObjectAccess
from drivers.errors import AbortError
from drivers.undo import undo_all

TARGETS = (
    objects.TARGET_POSITION,
    objects.TARGET_VELOCITY,
    objects.TARGET_TORQUE,
    objects.INTERPOLATION_TARGET,
)
"""Set-points; they are never put back: they would be motion orders."""


class KeptSettings:
    """written: values that the drive is known to hold."""

    def __init__(self, access: ObjectAccess) -> None:
        self._access = access
        self.written: dict[Entry, int] = {}
        self._found: dict[Entry, int] = {}  # before they were written

    def set(self, entry: Entry, value: int, *, always: bool = False) -> None:
        """Write an object unless it is known to hold the value already. Raises as `ObjectAccess.write`."""
        if not always and self.written.get(entry) == value:
            return
        self.written.pop(entry, None)
        known = entry in self._found
        self._remember(entry)
        try:
            self._access.write(entry, value)
        except AbortError:
            if not known:  # refused, so there is nothing to put back
                self._found.pop(entry, None)
            raise
        self.written[entry] = value

    def _remember(self, entry: Entry) -> None:
        if entry in self._found or entry in TARGETS:
            return
        try:
            self._found[entry] = self._access.read(entry)
        except AbortError:
            if entry is not objects.MODE:
                raise
            self._found[entry] = self._access.read(objects.MODE_DISPLAY)  # 6060h may be write-only

    def put_back(self) -> None:
        """Restore mode, speeds and ramps on a disabled axis, the last one written first. Raises as `undo_all`."""
        found = reversed(list(self._found.items()))
        undo_all([(f"{entry} not put back", partial(self._put_back, entry, value)) for entry, value in found])

    def _put_back(self, entry: Entry, value: int) -> None:
        if self.written.pop(entry, None) != value:
            self._access.write(entry, value)
        del self._found[entry]
