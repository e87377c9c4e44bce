"""A process that is asked to end stops its axes first, and a second time ends whatever hangs.

Ctrl-C, SIGTERM (a service is stopped) and SIGHUP (the terminal is closed) raise KeyboardInterrupt in the main thread, once; on its way
out the axes are stopped and put back. Another one while this is going on sends a stop to every connected drive, and the process ends
within `WAY_OUT_S`, or at once at the third. SIGKILL cannot be answered; for that a drive supervises its master.

The signals are counted in a thread of their own, by the wake-up descriptor: a handler in Python runs only once the main thread is back
from what it hangs in.
"""

from __future__ import annotations

import os
import select
import signal
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType
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


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WAY_OUT_S = 2.0
"""How long the way out may still take after a second signal: a quick stop and taking the power off need tenths of a second."""
INTERRUPTED = 130
"""Exit status: 128 + SIGINT, as shells have it."""
ENDED = b"hil: ended at once; every drive was sent a stop, but drives may still be enabled; rows are kept\n"


class _Signals:
    """Of one process, while its main thread is in `ending_by_signals`."""

    def __init__(self, drives: DrivesToStop) -> None:
        self._drives = drives
        self._raised = False
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._thread = threading.Thread(target=self._count, name="signals", daemon=True)

    def start(self) -> int:
        """From now on signals are counted; the descriptor that was told of them before."""
        self._thread.start()
        return signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)

    def close(self, before: int) -> None:
        """The main thread has found its way out."""
        signal.set_wakeup_fd(before)
        os.close(self._writer)
        self._thread.join()
        os.close(self._reader)

    def interrupt(self, _number: int, _frame: FrameType | None) -> None:
        """The handler. Only the first one interrupts: the way out is not to be broken off half-way."""
        if not self._raised:
            self._raised = True
            raise KeyboardInterrupt

    def _count(self) -> None:
        asked = 0
        while data := os.read(self._reader, 64):
            # what another handler answers, such as a web server's, is none of these
            asked += sum(signal.getsignal(number) == self.interrupt for number in data)
            if asked < 2:
                continue
            threading.Thread(target=self._drives.send_stop, name="stop", daemon=True).start()
            if asked > 2 or not select.select([self._reader], [], [], WAY_OUT_S)[0]:
                os.write(2, ENDED)
                os._exit(INTERRUPTED)


@contextmanager
def ending_by_signals() -> Iterator[None]:
    """Inside, the signals end the process as said above; one that somebody ignores (nohup) or handles is left alone. Within itself and
    in another thread than the main one, it does nothing.

    Drives that are made inside are among those that are stopped.
    """
    if threading.current_thread() is not threading.main_thread() or DRIVES_TO_STOP.get() is not None:
        yield
        return
    drives = DrivesToStop()
    ours = {
        number: handler
        for number in SIGNALS
        if (handler := signal.getsignal(number)) in (signal.SIG_DFL, signal.default_int_handler)
    }
    signals = _Signals(drives)
    before = signals.start()
    for number in ours:
        signal.signal(number, signals.interrupt)
    token = DRIVES_TO_STOP.set(drives)
    try:
        yield
    finally:
        DRIVES_TO_STOP.reset(token)
        for number, handler in ours.items():
            signal.signal(number, handler)
        signals.close(before)
