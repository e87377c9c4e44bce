"""Work on what is stored, in a process of its own: one at a time at each desk, whatever the axis does meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.errors import LocalError
from hil.app.error_log import ErrorLog

PROGRAM = (sys.executable, "-m", "hil.app.jobs.worker_process")
CLOSING_S = 5.0


class ComputingError(LocalError):
    """Something is being computed already."""


@dataclass(frozen=True)
class Computed:
    """The work that is being done, or was done last. work: "" before the first; made: files; error: in one line; seconds: so far"""

    number: int = 0
    work: str = ""
    running: bool = False
    made: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0


class Aside:
    """For any thread. errors: keeps mistakes of the program; program: what is started, with the axis file's path behind it."""

    def __init__(
        self,
        axis_file: Path,
        errors: ErrorLog,
        program: Sequence[str] = PROGRAM,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._command = [*program, str(axis_file)]
        self._errors = errors
        self._monotonic_s = monotonic_s
        self._lock = threading.Lock()
        self._computed = Computed()
        self._started_s = 0.0
        self._process: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None

    @property
    def computed(self) -> Computed:
        """As it stands."""
        with self._lock:
            now = self._computed
            return replace(now, seconds=self._monotonic_s() - self._started_s) if now.running else now

    def start(self, request: Mapping[str, Any]) -> None:
        """Begin. Raises ComputingError while the last is not done."""
        with self._lock:
            if self._computed.running:
                raise ComputingError(f"being computed already: {self._computed.work}")
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C at the server ends it by `cancel`, not in the middle of a line
            )
            self._computed = Computed(self._computed.number + 1, str(request["work"]), running=True)
            self._started_s = self._monotonic_s()
            given = (self._process, json.dumps(request), self._started_s)
            self._thread = threading.Thread(target=self._wait, args=given, name="computing", daemon=True)
            self._thread.start()

    def cancel(self) -> None:
        """End it; nothing half-written stays."""
        with self._lock:
            if self._process is not None and self._computed.running:
                self._process.terminate()

    def close(self) -> None:
        """End it, and wait until it has ended; where it does not for `CLOSING_S`, by force."""
        self.cancel()
        if self._thread is not None and self._process is not None:
            self._thread.join(CLOSING_S)
            if self._thread.is_alive():
                self._process.kill()
            self._thread.join()

    def _wait(self, process: subprocess.Popen[str], request: str, started_s: float) -> None:
        try:
            with process:
                said, complained = process.communicate(request)
            made, error = _answer(said, complained, process.returncode)
            error = self._errors.line_of_process(error, complained)
        except Exception as mistake:  # noqa: BLE001  otherwise it would be computing for ever
            made, error = (), self._errors.line_of(mistake)
        with self._lock:
            seconds = self._monotonic_s() - started_s
            self._computed = replace(self._computed, running=False, made=made, error=error, seconds=seconds)


def _answer(said: str, complained: str, status: int) -> tuple[tuple[str, ...], str]:
    """What was made, and what went wrong."""
    try:
        told = json.loads(said)
        return tuple(map(str, told.get("made", ()))), str(told.get("error", ""))
    except (ValueError, AttributeError):
        lines = complained.strip().splitlines()
        return (), "cancelled" if status < 0 else lines[-1] if lines else f"ended with status {status}"
