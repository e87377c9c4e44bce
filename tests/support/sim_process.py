"""`hil sim` as a process: started, asked for its connections, and ended, whatever the test's result."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

STARTED_WITHIN_S = 300.0 if os.environ.get("HIL_VCAN") == "guest" else 60.0
ENDED_WITHIN_S = 60.0


class SimProcess:
    """A running `hil sim`; `place` is its first line, `left` its last one, set when `end` has returned."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil.app.main", "sim", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self.left: dict[str, Any] | None = None
        self.errors = ""
        try:
            self.place: dict[str, Any] = json.loads(self._first_line())
        except BaseException:
            self.process.kill()
            self.end()
            raise

    def _first_line(self) -> bytes:
        out = self.process.stdout
        assert out is not None
        line = b""
        deadline = time.monotonic() + STARTED_WITHIN_S
        while not line.endswith(b"\n"):
            if not select.select([out], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise TimeoutError(f"hil sim said {line!r} within {STARTED_WITHIN_S:g} s")
            data = os.read(out.fileno(), 4096)
            if not data:
                raise EOFError(f"hil sim ended: {self.process.communicate()[1].decode()}")
            line += data
        return line

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send it a signal and wait; its exit status."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            out, errors = self.process.communicate(timeout=ENDED_WITHIN_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
            raise
        self.errors = errors.decode()
        if out.strip():
            self.left = json.loads(out.splitlines()[-1])["left"]
        return self.process.returncode


@contextmanager
def sim(*arguments: str) -> Iterator[SimProcess]:
    """A simulated part that is ended with the block."""
    running = SimProcess(*arguments)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.end()
        for pipe in (running.process.stdout, running.process.stderr):
            if pipe is not None:
                pipe.close()
