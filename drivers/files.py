"""Files from outside are read up to a bound, so that a sparse one or a device takes no memory; files of ours are replaced in one step,
so that a reader or a power cut finds the old bytes or the new ones.
"""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from drivers.errors import InputError

MOST_BYTES = 1 << 28
"""Longest file without a bound of its own: a million rows of 15 columns take half of it."""


def read_bytes(path: str | Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a file. Raises InputError naming it when it cannot be read, or is longer than `most` bytes."""
    try:
        with Path(path).open("rb") as file:
            about = os.fstat(file.fileno())
            # of a device or a pipe the size is not known before
            data = b"" if about.st_size > most else file.read(-1 if stat.S_ISREG(about.st_mode) else most + 1)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    except ValueError as error:  # a NUL in the name
        raise InputError(f"cannot be read: {error}", path=path) from error
    if max(len(data), about.st_size) > most:
        raise InputError(f"is too long, expected at most {most >> 10} KiB", path=path)
    return data


def replace_file(path: str | Path, data: bytes, *, mode: int | None = None) -> None:
    """Put `data` at `path` atomically and durably.

    The bytes go to a temporary file in the same directory, are flushed to the disk, and take the name in one step; then the
    directory is flushed. An older file's permissions (and owner, where we may) are kept; a new file gets `mode`, by default
    what the umask leaves of 0o666. A symbolic link stays one, its target is replaced. Something that is no regular file (a
    pipe, /dev/stdout) is written to as it is. Raises InputError naming the file when it cannot be written; the old one is then
    untouched.
    """
    try:
        _replace(Path(path), data, mode)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path=path) from error


def _replace(path: Path, data: bytes, mode: int | None) -> None:
    target = Path(os.path.realpath(path))
    try:
        old: os.stat_result | None = target.stat()
    except FileNotFoundError:
        old = None
    if path.is_relative_to("/dev") or (old is not None and not stat.S_ISREG(old.st_mode)):
        path.write_bytes(data)
        return
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            os.fchmod(file.fileno(), _default_mode(mode) if old is None else stat.S_IMODE(old.st_mode))
            if old is not None and (old.st_uid, old.st_gid) != (os.geteuid(), os.getegid()) and os.geteuid() == 0:
                os.fchown(file.fileno(), old.st_uid, old.st_gid)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    sync_directory(target.parent)


def _default_mode(mode: int | None) -> int:
    if mode is not None:
        return mode
    umask = os.umask(0o077)
    os.umask(umask)
    return 0o666 & ~umask


def sync_directory(directory: Path) -> None:
    """Makes a new or changed name in a directory durable. Raises OSError."""
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
