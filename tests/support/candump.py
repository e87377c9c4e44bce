"""can-utils' candump as an independent record of the frames on a CAN interface."""

from __future__ import annotations

import itertools
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import can
import pytest

LIMIT_S = 60.0
"""Longest wait for candump, s; a guest under load was seen to stand still for 20 s."""
MARK = 0x1FFFFFF0
"""Identifier of the frames that show how far candump has come; an extended one, which CANopen does not use."""

Seen = Callable[[], list[str]]


@contextmanager
def candump(interface: str, folder: Path) -> Iterator[Seen]:
    """Yields seen(): the frames since the block was entered, as candump writes them: `605#4000100000000000`.

    seen() sends a mark behind all that is on the bus and waits until candump has written it; marks are left out. Skips the test
    where candump is missing.
    """
    if shutil.which("candump") is None:
        pytest.skip("candump is not installed (Debian: can-utils)")
    log = folder / "candump.log"
    receivers = Path("/proc/net/can/rcvlist_all")
    numbers = itertools.count(1)

    def listeners() -> int:
        return receivers.read_text().count(f" {interface} ")

    def written() -> list[str]:
        complete = log.read_text().rpartition("\n")[0]
        return [line.split()[2] for line in complete.splitlines()]

    def seen() -> list[str]:
        number = next(numbers)
        sender.send(can.Message(arbitration_id=MARK, data=number.to_bytes(2, "big")))
        mark, end = f"{MARK:X}#{number:04X}", time.monotonic() + LIMIT_S
        while mark not in (frames := written()):
            if time.monotonic() > end:
                pytest.fail(f"candump has not written what was sent within {LIMIT_S:g} s")
            time.sleep(0.01)
        return [frame for frame in frames[: frames.index(mark)] if not frame.startswith(f"{MARK:X}#")]

    with can.Bus(interface="socketcan", channel=interface) as sender, log.open("wb") as out, ExitStack() as stack:
        before, end = listeners(), time.monotonic() + LIMIT_S
        dump = stack.enter_context(subprocess.Popen(["candump", "-L", interface], stdout=out))
        try:
            while listeners() == before:
                if time.monotonic() > end:
                    pytest.fail(f"candump does not listen within {LIMIT_S:g} s")
                time.sleep(0.01)
            yield seen
        finally:
            dump.terminate()
