"""Counts writes to a drive's EEPROM, and refuses the one that exceeds the register's budget.

An EEPROM cell bears some 100 000 writes; a script that writes a parameter in a loop uses that up in an afternoon. The ledger counts
attempts, not successes, and may live in a file, because wear outlasts the process.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

from drivers.errors import InputError, StateError


class WearLedger:
    """Writes so far, by drive and register. path: where they are kept; None keeps them for this process only."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._counts: dict[str, int] = {} if path is None or not path.exists() else _read(path)

    def writes(self, drive: str, register: str) -> int:
        """Writes counted so far."""
        return self._counts.get(f"{drive}/{register}", 0)

    def charge(self, drive: str, register: str, budget: int) -> None:
        """Count one more write, before it is made. Raises StateError when that would exceed the budget."""
        written = self.writes(drive, register)
        if written >= budget:
            raise StateError(
                f"drive {drive}: {register} is kept in EEPROM and was written {written} times, its budget is {budget};"
                " raise wear_budget in the register map if this is meant"
            )
        self._counts[f"{drive}/{register}"] = written + 1
        if self._path is not None:
            _write(self._path, self._counts)


def _read(path: Path) -> dict[str, int]:
    try:
        counts = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read as a wear ledger: {error}", path=path) from error
    if not isinstance(counts, dict) or not all(type(count) is int and count >= 0 for count in counts.values()):
        raise InputError("is no wear ledger, expected an object of whole numbers >= 0", path=path)
    return counts


def _write(path: Path, counts: dict[str, int]) -> None:
    """Replace the file in one step, so that a power cut leaves the old counts or the new ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            json.dump(counts, stream, indent=1, sort_keys=True)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
