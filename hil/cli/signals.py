"""A process that is asked to end stops its axis first.

Closing the terminal or stopping a service sends a signal whose default is to die on the spot, with the axis under way. Here it becomes
what Ctrl-C is. SIGKILL cannot be answered; for that a drive supervises its master.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ASKED_TO_END = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def ending_like_ctrl_c() -> Iterator[None]:
    """Inside, SIGTERM and SIGHUP raise KeyboardInterrupt; a signal that somebody ignores (nohup) or handles is left alone."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = [number for number in ASKED_TO_END if signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
