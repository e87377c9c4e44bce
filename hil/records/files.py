"""Files read with errors that name them, locked against other processes, and added to durably. Independent of any format.

What replaces an older file is written by `drivers.files.replace_file`.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self, TypeVar

from drivers.errors import InputError, StateError
from drivers.files import read_text

T = TypeVar("T")


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Adds this path to every InputError raised inside that names no file."""
    try:
        yield
    except InputError as error:
        if error.path is not None:
            raise
        raise type(error)(error.what, path=path, line=error.line) from error


MOST_DIGITS = 64
"""Most digits of a whole number in JSON: those of 64 bits written in binary. A float holds whole numbers of up to 309 digits."""
DEEPEST = 64
"""Most levels of brackets in JSON; what this program writes has at most eight."""


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text. Raises ValueError for any other text, a number of too many digits, and too deep a nesting."""
    try:
        value = json.loads(text, parse_int=_whole)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    level, depth = [value], 0
    while level := [each for each in level if isinstance(each, dict | list)]:
        depth += 1
        if depth > DEEPEST:
            raise ValueError("nested too deeply")
        level = [inner for each in level for inner in (each.values() if isinstance(each, dict) else each)]
    return value


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError("a number of too many digits")
    return int(digits)


def read_note(path: Path, read: Callable[[Any], T], wrong: str) -> T | None:
    """What `read` makes of the JSON value in a file; None where there is no such file.

    Raises InputError, with this sentence, for a file that is not of the form that `read` expects.
    """
    if not path.exists():
        return None
    try:
        return read(parse_json(read_text(path)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(wrong, path=path) from error


_LINE_END = re.compile(r"\r\n|\r|\n")


def split_lines(text: str) -> list[str]:
    """The lines of a text without their ends, which are LF, CR or both: `str.splitlines` also ends one at VT, FF, NEL or U+2028."""
    lines = _LINE_END.split(text)
    return lines if lines[-1] else lines[:-1]


@contextmanager
def held(path: str | Path, *, wait: bool = False) -> Iterator[None]:
    """Locks a file or directory exclusively until the block ends or the process dies.

    Raises InputError when it is locked already, by another process or by this one; with `wait` it waits instead.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError as error:
            raise InputError("is in use already, expected one process at a time", path=path) from error
        yield
    finally:
        os.close(handle)


@contextmanager
def held_by_name(path: str | Path) -> Iterator[None]:
    """Locks a file exclusively, also against processes that replace it by another file of the same name, as editors do.

    The name is locked by a socket in Linux's abstract namespace, which leaves no file behind; the file itself as by
    `held`.
    Raises InputError as `held`.
    """
    with held(path), _held_word("file", os.fsencode(os.path.realpath(path)), path):
        yield


@contextmanager
def held_place(place: str) -> Iterator[None]:
    """Something outside the file system that only one may work with at a time on this computer, by the same socket as `held_by_name`.

    Raises InputError while it is held already.
    """
    with _held_word("place", place.encode(), None):
        yield


@contextmanager
def _held_word(kind: str, word: bytes, path: str | Path | None) -> Iterator[None]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as name:
        if sys.platform == "linux":
            try:
                name.bind(f"\0hil-{kind}-{hashlib.sha256(word).hexdigest()}")
            except OSError as error:
                raise InputError("is in use already, expected one process at a time", path=path) from error
        yield


def append_durably(
    handle: int, data: bytes, *, keep: int | None = None, then: Callable[[], object] = lambda: None
) -> None:
    """Write `data` behind the first `keep` bytes of an open file (default: all), flush it to the disk, then call `then`.

    handle: a file descriptor. On OSError, also of `then`, the file is cut back to what was kept, and the error is raised.
    """
    end = os.fstat(handle).st_size if keep is None else keep
    try:
        if keep is not None:
            os.ftruncate(handle, keep)
        left = data
        while left:
            left = left[os.write(handle, left) :]
        os.fsync(handle)
        then()
    except OSError:
        os.ftruncate(handle, end)
        raise


class AppendedFile:
    """A file that only grows, open for appending by one process at a time.

    Raises InputError where it cannot be opened or another process has it open.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._handle: int | None = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise InputError(f"cannot be opened: {error.strerror}", path=path) from error
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException as error:
            self.close()
            if isinstance(error, BlockingIOError):
                raise InputError("is being written by another process", path=path) from error
            raise

    @property
    def _fd(self) -> int:
        if self._handle is None:
            raise StateError(f"{self.path} is closed")
        return self._handle

    def close(self) -> None:
        """Close the file; harmless when it is closed already."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
