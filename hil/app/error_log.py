"""Mistakes of the program: one line for a person, the traceback in a file beside the campaigns.

What a `BridgeError` says is enough for whoever stands at the machine. Any other exception is a mistake in the program, and whoever is
to mend it needs its traceback, also where it came up in a thread that nobody watches.
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
"""Of the file; a full one becomes `errors.log.1`, and the one before it goes. Some hundred tracebacks fit."""
_LONGEST = 16 * 1024  # characters of one traceback that are kept, its end


def one_line(error: BaseException) -> str:
    """As the command line says it; the kind of an error that says nothing."""
    return undo.one_line(error) or type(error).__name__


class ErrorLog:
    """The file of one axis, or of whatever has a place for it; any thread."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._last = ""
        self._lock = threading.Lock()

    def line_of(self, error: BaseException) -> str:
        """The error in one line. Of a mistake in the program it names the file, to which its traceback has been written."""
        if isinstance(error, BridgeError):
            return one_line(error)
        text = "".join(traceback.format_exception(error))
        said = str(error).strip()
        return self._kept(f"{type(error).__name__}: {one_line(error)}" if said else type(error).__name__, text)

    def line_of_process(self, said: str, complained: str) -> str:
        """The same for another process, by what it wrote on its standard error."""
        return self._kept(said, complained) if "Traceback" in complained else said

    def _kept(self, said: str, text: str) -> str:
        try:
            with self._lock:
                if text != self._last:  # the same again and again, as from an axis that is connected anew, is kept once
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
def strays_caught(tell: Callable[[BaseException], None]) -> Iterator[None]:
    """Inside, an exception that ends a thread is told, instead of being printed with its traceback; `SystemExit` ends one in peace."""

    def caught(args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
            tell(args.exc_value)

    before = threading.excepthook
    threading.excepthook = caught
    try:
        yield
    finally:
        threading.excepthook = before
