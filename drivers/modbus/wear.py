"""Ledger of the writes to a drive's EEPROM; it refuses the one that exceeds the register's budget.

An EEPROM cell bears some 100 000 writes; a script that writes a parameter in a loop reaches that in an afternoon. The ledger counts
attempts, not successes, and may be kept in a file, because wear outlasts the process. Ledgers of several drives may share the file, in
several threads or processes: each continues from the counts in the file.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.errors import InputError, StateError
from drivers.files import read_text, replace_file


class WearLedger:
    """Writes so far, by drive and register. path: file of the counts; None keeps them for this process only."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._counts: dict[str, int] = {} if path is None or not path.exists() else _read(path)

    def writes(self, drive: str, register: str) -> int:
        """Writes counted so far."""
        return self._counts.get(f"{drive}/{register}", 0)

    def charge(self, drive: str, register: str, budget: int) -> None:
        """Count one more write, before it is made. Raises StateError when that would exceed the budget."""
        if self._path is None:
            self._charge(drive, register, budget)
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with _alone_in(self._path.parent):
            self._counts = _read(self._path) if self._path.exists() else {}
            self._charge(drive, register, budget)
            replace_file(self._path, json.dumps(self._counts, indent=1, sort_keys=True).encode())

    def _charge(self, drive: str, register: str, budget: int) -> None:
        written = self.writes(drive, register)
        if written >= budget:
            raise StateError(
                f"drive {drive}: {register} is kept in EEPROM and was written {written} times, its budget is {budget};"
                " raise wear_budget in the register map if this is meant"
            )
        self._counts[f"{drive}/{register}"] = written + 1


@contextmanager
def _alone_in(directory: Path) -> Iterator[None]:
    """Lock against other ledgers; each opens the directory itself, so that it holds between threads too."""
    handle = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _read(path: Path) -> dict[str, int]:
    try:
        counts = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"cannot be read as a wear ledger: {error}", path=path) from error
    if not isinstance(counts, dict) or not all(type(count) is int and count >= 0 for count in counts.values()):
        raise InputError("is no wear ledger, expected an object of whole numbers >= 0", path=path)
    return counts
