"""Changes of a drive's own correction table, completely or not at all.

The drive's contents and switch are noted in a file before the first change, so that the next process restores them even
after this one was killed. A write counts only after it was read back unchanged.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drivers.clock import NS_PER_S
from drivers.correction_table import CorrectionTable, RawTable
from drivers.drive import WITHOUT_POWER, ServoDrive
from drivers.errors import BridgeError, CapabilityError, InputError, ProtocolError, SafetyError, StateError
from drivers.files import read_text, replace_file
from hil.axis.axis_file import DriveAxis
from hil.desk.job import Tell
from hil.machine.one_correction import switch_table
from hil.records.files import parse_json, read_note
from hil.records.made_with import MadeWith
from hil.records.zero import Zero

_TRIES = 3  # attempts to restore
_WRITES = 2  # of a change: the new table, and the old one where the new cannot stay


class NotPutBackError(SafetyError):
    """The drive's table could not be restored; the message names the file that holds it."""


@dataclass(frozen=True)
class Snapshot:
    """A table and its switch as they were found."""

    raw: RawTable
    enabled: bool

    def to_text(self) -> str:
        return json.dumps({"enabled": self.enabled, **asdict(self.raw)}, indent=1) + "\n"

    @classmethod
    def from_file(cls, path: Path) -> Snapshot:
        """Reads a note. Raises InputError for anything that `to_text` did not write."""
        try:
            found = parse_json(read_text(path))
            enabled = bool(found.pop("enabled"))
            values: dict[str, Any] = {
                name: tuple(map(int, value)) if isinstance(value, list) else int(value) for name, value in found.items()
            }
            return cls(RawTable(**values), enabled)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError("is no note of a drive's correction table", path=path) from error


def held_table(drive: ServoDrive) -> CorrectionTable:
    """The open drive's table. Raises CapabilityError for a drive without a described table."""
    table = drive.correction_table
    if table is None:
        raise CapabilityError(
            f"drive {drive.name} has no correction table that is described: name its map as correction_table in [drive],"
            " or give its register map a [drive.correction_table]"
        )
    return table


def snapshot(table: CorrectionTable) -> Snapshot:
    """Reads contents and switch. Raises what access to the drive raises."""
    return Snapshot(table.read(), table.enabled())


class TableChange:
    """A change of a drive's table in progress. Made by `changing`.

    undone: the table was restored; seconds: time for writing and reading back
    """

    def __init__(self, drive: ServoDrive, table: CorrectionTable, found: Snapshot) -> None:
        self.drive = drive
        self.table = table
        self.found = found
        self.seconds = 0.0  # the clock's time for writing and for reading back
        self.undone = False

    def write(self, raw: RawTable) -> None:
        """Switches the drive's correction off, writes, reads all of it back and compares.

        Raises StateError under power or where the memory may not be written often enough to undo it, InputError for a
        table that does not fit, ProtocolError for another value read back.
        """
        self._require_unpowered()
        self.table.description.check(raw)
        left = self.table.changes_left()
        if left is not None and left < _WRITES:
            raise StateError(
                f"drive {self.drive.name}: {self.table.description.name} is kept in EEPROM and its budget has {max(0, left)}"
                f" changes left; one that can be taken back needs {_WRITES} (wear_budget in the register map)"
            )
        self.table.switch(False)
        start_ns = self.drive.clock.now_ns()
        self.table.write(raw, self.found.raw)
        require_same(self.drive.name, raw, self.table.read())
        self.seconds = (self.drive.clock.now_ns() - start_ns) / NS_PER_S

    def switch(self, on: bool) -> None:
        """Switches the drive's correction. Raises StateError under power, ProtocolError for another value read back."""
        self._require_unpowered()
        switch_table(self.drive, self.table, on)

    def undo(self) -> None:
        """Restores contents and switch, and reads them back. Raises what access raises."""
        if self.drive.sample().state not in WITHOUT_POWER:
            self.drive.disable()
        put_back(self.drive, self.table, self.found)
        self.undone = True

    def _require_unpowered(self) -> None:
        state = self.drive.sample().state
        if state not in WITHOUT_POWER:
            raise StateError(f"drive {self.drive.name}: its table is not changed under power, it is {state.value}")


@contextmanager
def changing(drive: ServoDrive, note: Path, tell: Tell) -> Iterator[TableChange]:
    """Changes the table inside the block; after any error or interrupt the drive is restored.

    note: file that holds the earlier state meanwhile. tell: receives what could not be restored, and that an earlier
    change was undone.
    Raises StateError before the first access while the axis is under power.
    """
    table = held_table(drive)
    state = drive.sample().state
    if state not in WITHOUT_POWER:
        raise StateError(f"drive {drive.name}: its table is changed while the axis is disabled, it is {state.value}")
    if recover(drive, note):
        tell("an earlier change of the drive's table was broken off; what was there before it has been put back")
    change = TableChange(drive, table, snapshot(table))
    note.parent.mkdir(parents=True, exist_ok=True)
    try:
        replace_file(note, change.found.to_text().encode())
        yield change
    except BaseException:
        _undo_whatever_happens(change, note, tell)
        raise
    note.unlink(missing_ok=True)


def _undo_whatever_happens(change: TableChange, note: Path, tell: Tell) -> None:
    """Restores in spite of errors and interrupts; the error in progress is the one to report."""
    for left in reversed(range(_TRIES)):
        try:
            change.undo()
        except (KeyboardInterrupt, BridgeError) as error:
            if not left:
                tell(
                    f"drive {change.drive.name}: its correction table was not put back ({error or 'interrupted'});"
                    f" it is kept in {note}, the next change of it puts it back first"
                )
        else:
            note.unlink(missing_ok=True)
            return


def recover(drive: ServoDrive, note: Path) -> bool:
    """Restores the state before an interrupted change; returns whether there was one. Raises NotPutBackError."""
    if not note.exists():
        return False
    found = Snapshot.from_file(note)
    try:
        put_back(drive, held_table(drive), found)
    except BridgeError as error:
        raise NotPutBackError(
            f"drive {drive.name}: an earlier change of its correction table was broken off, and what was there before cannot"
            f" be put back ({error}); it is kept in {note}"
        ) from error
    note.unlink(missing_ok=True)
    return True


def put_back(drive: ServoDrive, table: CorrectionTable, found: Snapshot) -> None:
    """Restores contents first, then the switch; both read back. Raises ProtocolError for another value."""
    present = table.read()
    if present != found.raw:
        table.switch(False)
        table.write(found.raw, present)
        require_same(drive.name, found.raw, table.read())
    switch_table(drive, table, found.enabled)


# -- the zero it was made in -----------------------------------------------------------------------------------------------
def zero_note(axis: DriveAxis) -> Path:
    """Where an axis notes it."""
    return axis.store.directory / f"{axis.name}.drive-table.json"


def remember_zero(note: Path, raw: RawTable, zero: Zero | None, made_with: MadeWith | None = None) -> None:
    """Notes the axis's zero in which the drive's table was made, and the drive's other parameters; a drive cannot store it."""
    form = {"table": _digest(raw), "zero": None if zero is None else zero.to_json()}
    form |= {} if made_with is None else {"made_with": made_with.to_json()}
    note.parent.mkdir(parents=True, exist_ok=True)
    replace_file(note, (json.dumps(form, indent=1) + "\n").encode())


def remembered_zero(note: Path, raw: RawTable) -> Zero | None:
    """The zero in which the drive's table was made; None where none was noted. Raises InputError for a note that cannot
    be read.
    """

    def read(form: Any) -> Zero | None:
        zero = None if form["zero"] is None else Zero.from_json(form["zero"])
        return zero if form["table"] == _digest(raw) else None

    return read_note(note, read, "does not say in which zero the drive's table was made")


def remembered_made_with(note: Path, raw: RawTable) -> MadeWith | None:
    """The drive's parameters that its table was made with; None where none were noted. Raises InputError for a note that
    cannot be read.
    """

    def read(form: Any) -> MadeWith | None:
        noted = form.get("made_with") if form["table"] == _digest(raw) else None
        return None if noted is None else MadeWith.from_json(noted)

    return read_note(note, read, "does not say which parameters the drive's table was made with")


def _digest(raw: RawTable) -> str:
    return hashlib.sha256(json.dumps(asdict(raw), sort_keys=True).encode()).hexdigest()


def require_same(drive: str, wanted: RawTable, kept: RawTable) -> None:
    """Raises ProtocolError naming the first value that differs."""
    if kept == wanted:
        return
    for name, value in asdict(wanted).items():
        there = getattr(kept, name)
        if not isinstance(value, tuple):
            if there != value:
                raise ProtocolError(f"drive {drive}: the table's {name} was written {value}, it reads back {there}")
            continue
        if len(there) != len(value):
            raise ProtocolError(f"drive {drive}: {len(value)} values of {name} were written, {len(there)} read back")
        for index, (ours, theirs) in enumerate(zip(value, there, strict=True)):
            if ours != theirs:
                raise ProtocolError(
                    f"drive {drive}: the table's {name} {index + 1} was written {ours}, it reads back {theirs}"
                )
