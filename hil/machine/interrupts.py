"""Handling of SIGINT (Ctrl-C), SIGTERM (a service is stopped) and SIGHUP (the terminal is closed): the axes are stopped first.

The first signal raises KeyboardInterrupt in the main thread, whose context managers stop the axes and put them back. A second one
sends a stop to every connected drive, and the process ends within `STOP_WITHIN_S`; a third one ends it at once. SIGKILL cannot be
handled: against that, a drive supervises its master.

A second thread counts the signals, by the wake-up descriptor: a handler in Python does not run while the main thread is blocked in a
system call that does not return.

Python raises between any two calls. Raised in a function that takes or releases something, KeyboardInterrupt leaves a lock taken for
good, or a drive enabled whose block was never entered; raised in a `__del__` it is printed and forgotten. So a signal that finds the
main thread there comes again a millisecond later, and one that was forgotten comes again too.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:  # a verb's help needs no drive
    from drivers.drive import ServoDrive

Drive = TypeVar("Drive", bound="ServoDrive")


class DrivesToStop:
    """Weak references to the drives of this process."""

    def __init__(self) -> None:
        self._drives: list[weakref.ref[ServoDrive]] = []

    def add(self, drive: ServoDrive) -> None:
        """Add a drive, open or not: `send_stop` of a closed drive does nothing."""
        self._drives.append(weakref.ref(drive, self._drives.remove))

    def send_stop(self) -> None:
        """Send a stop to all of them. From any thread; never raises and does not block, as `ServoDrive.send_stop`."""
        for reference in tuple(self._drives):
            drive = reference()
            if drive is not None:
                drive.send_stop()


DRIVES_TO_STOP: ContextVar[DrivesToStop | None] = ContextVar("drives to stop", default=None)
"""The drives of the enclosing `ending_by_signals`, None outside of it."""


def stopped_by_signals(drive: Drive) -> Drive:
    """Returns the drive, which from now on is stopped by a second signal."""
    drives = DRIVES_TO_STOP.get()
    if drives is not None:
        drives.add(drive)
    return drive


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
STOP_WITHIN_S = 2.0
"""Time from a second signal to the end of the process, s: a quick stop and a disable take tenths of a second."""
INTERRUPTED = 130
"""Exit status: 128 + SIGINT, as shells have it."""
ENDED = b"hil: ended at once; every drive was sent a stop, but drives may still be enabled; rows are kept\n"
UNEVEN = frozenset({"__enter__", "__exit__", "__del__", "enter_context", "push"})
"""Functions that are not interrupted: the two of each context manager, contextlib's among them, and those of its ExitStack."""
AGAIN_AFTER_S = 0.001
PUT_OFF_AT_MOST = 100
"""Such a function that takes longer, as it waits for something, is interrupted all the same: 0.1 s and more after the signal."""
AGAIN = 0x80
"""Bit of a byte in the wake-up pipe: the signal is to come again. The numbers of signals are below it."""


class _Signals:
    """Counts the signals while the main thread is in `ending_by_signals`."""

    def __init__(self, drives: DrivesToStop) -> None:
        self._drives = drives
        self._raised = False
        self._put_off = 0
        self._number = 0
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._thread = threading.Thread(target=self._count, name="signals", daemon=True)
        self._report = sys.unraisablehook

    def start(self) -> int:
        """Start to count; returns the wake-up descriptor that was set before."""
        self._thread.start()
        sys.unraisablehook = self._forgotten
        return signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)

    def close(self, before: int) -> None:
        """Stop to count and set the wake-up descriptor `before` again."""
        signal.set_wakeup_fd(before)
        sys.unraisablehook = self._report
        os.close(self._writer)
        self._thread.join()
        os.close(self._reader)

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """The handler. Only the first signal raises KeyboardInterrupt, so that stopping the axes is not interrupted."""
        if self._raised:
            return
        if frame is not None and frame.f_code.co_name in UNEVEN and self._put_off < PUT_OFF_AT_MOST:
            self._put_off += 1
            os.write(self._writer, bytes([number | AGAIN]))
            return
        self._raised, self._number = True, number
        raise KeyboardInterrupt

    def _forgotten(self, unraisable: sys.UnraisableHookArgs) -> None:
        if unraisable.exc_type is KeyboardInterrupt and self._raised:
            self._raised, self._put_off = False, 0
            os.write(self._writer, bytes([self._number | AGAIN]))
        else:
            self._report(unraisable)

    def _count(self) -> None:
        asked = 0
        while data := os.read(self._reader, 64):
            for number in data:
                if number & AGAIN:
                    time.sleep(AGAIN_AFTER_S)
                    asked -= 1  # it is counted when it comes
                    signal.pthread_kill(threading.main_thread().ident or 0, number & ~AGAIN)
                elif signal.getsignal(number) == self.interrupt:  # another handler's, as a web server's, does not count
                    asked += 1
            if asked < 2:
                continue
            threading.Thread(target=self._drives.send_stop, name="stop", daemon=True).start()
            if asked > 2 or not select.select([self._reader], [], [], STOP_WITHIN_S)[0]:
                os.write(2, ENDED)
                os._exit(INTERRUPTED)


@contextmanager
def ending_by_signals() -> Iterator[None]:
    """Handle the signals as said above inside the block. A signal that is ignored (nohup) or already has a handler is left alone.
    Nested in itself, or in another thread than the main one, the block does nothing.

    Drives made inside (`stopped_by_signals`) are stopped by a second signal.
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
