"""Worker process for computations on stored campaigns: one at a time for each desk, independent of the axis."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.errors import LocalError
from hil.desk.error_log import ErrorLog

PROGRAM = (sys.executable, "-m", "hil.desk.worker_program")
CLOSING_S = 5.0
"""Time limit for the process to end, s; then it is killed."""


@dataclass(frozen=True)
class Passes:
    """Passes of one campaign to compute on. paths: their files, at least one."""

    label: str
    paths: tuple[Path, ...]


@dataclass(frozen=True)
class Work:
    """A computation on stored campaigns, which the worker process imports.

    function: "module:name" of a function of the axis and a list of `Passes`; it returns the names of the files that it wrote
    """

    name: str
    function: str

    def request(self, campaigns: Sequence[Passes] = ()) -> dict[str, Any]:
        """The request to the worker process, as plain values."""
        of = [[one.label, [str(path) for path in one.paths]] for one in campaigns]
        return {"work": self.name, "function": self.function, "campaigns": of}


class ComputingError(LocalError):
    """Another computation is running."""


@dataclass(frozen=True)
class Computed:
    """The running or last computation. work: its name, "" before the first; made: files; error: one line; seconds: so far."""

    number: int = 0
    work: str = ""
    running: bool = False
    made: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0


class WorkerProcess:
    """Starts and ends the process, from any thread. errors: log of program errors; program: command, without the axis file's path."""

    def __init__(self, axis_file: Path, errors: ErrorLog, program: Sequence[str] = PROGRAM) -> None:
        self._command = [*program, str(axis_file)]
        self._errors = errors
        self._lock = threading.Lock()
        self._computed = Computed()
        self._started_s = 0.0
        self._process: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None

    @property
    def computed(self) -> Computed:
        with self._lock:
            now = self._computed
            return replace(now, seconds=time.monotonic() - self._started_s) if now.running else now

    def start(self, request: Mapping[str, Any]) -> None:
        """Start a computation. Raises ComputingError while one is running."""
        with self._lock:
            if self._computed.running:
                raise ComputingError(f"being computed already: {self._computed.work}")
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C at the server reaches it by `cancel` only
            )
            self._computed = Computed(self._computed.number + 1, str(request["work"]), running=True)
            self._started_s = time.monotonic()
            given = (self._process, json.dumps(request), self._started_s)
            self._thread = threading.Thread(target=self._wait, args=given, name="computing", daemon=True)
            self._thread.start()

    def cancel(self) -> None:
        """End the computation; no partly written file remains."""
        with self._lock:
            if self._process is not None and self._computed.running:
                self._process.terminate()

    def close(self) -> None:
        """End the computation and wait for the process; kill it after `CLOSING_S`."""
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
        except Exception as mistake:  # noqa: BLE001  otherwise the state would remain "running"
            made, error = (), self._errors.line_of(mistake)
        with self._lock:
            seconds = time.monotonic() - started_s
            self._computed = replace(self._computed, running=False, made=made, error=error, seconds=seconds)


def _answer(said: str, complained: str, status: int) -> tuple[tuple[str, ...], str]:
    """The files made, and the error."""
    try:
        answer = json.loads(said)
        return tuple(map(str, answer.get("made", ()))), str(answer.get("error", ""))
    except (ValueError, AttributeError):
        lines = complained.strip().splitlines()
        return (), "cancelled" if status < 0 else lines[-1] if lines else f"ended with status {status}"
