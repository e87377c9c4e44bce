"""can-utils' candump as an independent record of the frames on a CAN interface."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

LIMIT_S = 30.0

Seen = Callable[[], list[str]]


@contextmanager
def candump(interface: str, folder: Path) -> Iterator[Seen]:
    """Yields seen(): the frames since the block was entered, as candump writes them: `605#4000100000000000`.

    seen() first waits until candump has written everything that the kernel gave it. Skips the test where candump is missing.
    """
    if shutil.which("candump") is None:
        pytest.skip("candump is not installed (Debian: can-utils)")
    log = folder / "candump.log"
    receivers = Path("/proc/net/can/rcvlist_all")

    def listeners() -> int:
        return receivers.read_text().count(f" {interface} ")

    def seen() -> list[str]:
        size = -1
        while size != (size := log.stat().st_size):  # it writes line by line, right after each frame
            time.sleep(0.2)
        return [line.split()[2] for line in log.read_text().splitlines()]

    before, end = listeners(), time.monotonic() + LIMIT_S
    with log.open("wb") as out, subprocess.Popen(["candump", "-L", interface], stdout=out) as dump:
        try:
            while listeners() == before:
                if time.monotonic() > end:
                    pytest.fail(f"candump does not listen within {LIMIT_S:g} s")
                time.sleep(0.01)
            yield seen
        finally:
            dump.terminate()
