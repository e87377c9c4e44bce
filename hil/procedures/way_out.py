"""What has to be done on the way out of an axis, whatever comes: a quick stop, taking the power off."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from drivers.errors import BridgeError


def completed(undo: Callable[[], None], *, raising: bool = False) -> None:
    """Do it. An interrupt meanwhile (Ctrl-C, the operator's stop) is raised once it was done anew, for it may have been half done.

    raising: whether an error of it is raised; where one is under way already, that matters more: the link may be gone, or the drive in
    a fault, and there is nothing left to tell it.
    """
    try:
        undo()
    except KeyboardInterrupt:
        with suppress(BridgeError):
            undo()
        raise
    except BridgeError:
        if raising:
            raise
