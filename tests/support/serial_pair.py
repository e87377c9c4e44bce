"""Two serial ports joined by a wire, as two pseudo-terminals."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def serial_pair() -> Iterator[tuple[str, str]]:
    """Two ports joined by a wire: two pseudo-terminals whose masters are pumped into each other."""
    ends = [os.openpty(), os.openpty()]
    stop_read, stop_write = os.pipe()
    for _, slave in ends:
        tty.setraw(slave)
    masters = [master for master, _ in ends]

    def pump() -> None:
        while True:
            ready = select.select([*masters, stop_read], [], [])[0]
            if stop_read in ready:
                return
            for master in ready:
                os.write(masters[1 - masters.index(master)], os.read(master, 4096))

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield os.ttyname(ends[0][1]), os.ttyname(ends[1][1])
    finally:
        os.write(stop_write, b"x")
        thread.join()
        for handle in (*masters, *(slave for _, slave in ends), stop_read, stop_write):
            os.close(handle)
