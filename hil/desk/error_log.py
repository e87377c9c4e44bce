"""Log of program errors: one line for the operator, the traceback in a file beside the campaigns.

The message of a `BridgeError` is enough for the operator. Any other exception is an error in the program; its traceback is needed to
correct it, also where it is raised in a background thread.
"""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from drivers import undo
from drivers.errors import BridgeError

ERRORS = "errors.log"
MOST_BYTES = 256 * 1024
"""Largest size of the file, some hundred tracebacks. A full one becomes `errors.log.1`, replacing the one before."""
_LONGEST = 16 * 1024
"""Characters kept of one traceback, its end."""


def one_line(error: BaseException) -> str:
    """The error's message as one line; its type for an error without a message."""
    return undo.one_line(error) or type(error).__name__


class ErrorLog:
    """The log in one file, for any thread."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._last = ""
        self._lock = threading.Lock()

    def line_of(self, error: BaseException) -> str:
        """The error as one line. The traceback of a program error is written to the file, which the line then names."""
        if isinstance(error, BridgeError):
            return one_line(error)
        text = "".join(traceback.format_exception(error))
        said = str(error).strip()
        return self._kept(f"{type(error).__name__}: {one_line(error)}" if said else type(error).__name__, text)

    def line_of_process(self, said: str, complained: str) -> str:
        """As `line_of` for another process. said: its message; complained: its standard error."""
        return self._kept(said, complained) if "Traceback" in complained else said

    def _kept(self, said: str, text: str) -> str:
        try:
            with self._lock:
                if text != self._last:  # a repeated one, as from each attempt to connect, is written once
                    self._write(text)
                    self._last = text
        except OSError as error:
            return f"{said}; its traceback cannot be kept in {self.path}: {error.strerror}"
        return f"{said}; the traceback is in {self.path}"

    def _write(self, text: str) -> None:
        when = datetime.now().astimezone().isoformat(timespec="seconds")
        head = f"{when} process {os.getpid()}, thread {threading.current_thread().name}\n"
        data = (head + text[-_LONGEST:].rstrip() + "\n\n").encode("utf-8", "replace")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.exists() and self.path.stat().st_size + len(data) > MOST_BYTES:
            self.path.replace(self.path.with_name(f"{self.path.name}.1"))
        with self.path.open("ab", buffering=0) as file:
            file.write(data)


@contextmanager
def thread_errors_caught(tell: Callable[[BaseException], None]) -> Iterator[None]:
    """Inside the block, `tell` is called with an exception that ends a thread, except `SystemExit`; no traceback is printed."""

    def caught(args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
            tell(args.exc_value)

    before = threading.excepthook
    threading.excepthook = caught
    try:
        yield
    finally:
        threading.excepthook = before
