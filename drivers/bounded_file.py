"""Reading of a file from outside: no more of it than its reader allows, so that a sparse file or a device takes no memory."""

from __future__ import annotations

import os
import stat
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
