"""What a change of a drive's table does in what order, against a drive and a table that only take notes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.correction_table import RawTable
from drivers.drive import DriveState
from drivers.errors import ProtocolError, SafetyError, StateError
from hil.drive_table.change import TableChange, changing, recover, remember_zero

OLD, NEW = RawTable((1, 2), (3, 4), (), 0, 10), RawTable((5, 6), (7, 8), (), 0, 10)
DISABLED, POWERED = DriveState.SWITCH_ON_DISABLED, DriveState.ENABLED


@dataclass
class Noting:
    """A drive and its table in one. refuses: writes of the old table that fail, and how; forgets: writes are not carried out."""

    holds: RawTable = OLD
    on: bool = True
    state: DriveState = DISABLED
    left: int | None = None
    refuses: list[BaseException] = field(default_factory=list)
    forgets: bool = False
    done: list[str] = field(default_factory=list)
    name: str = "X"
    spent_ns: int = 0
    corrected_outside: bool = False

    def __post_init__(self) -> None:
        self.correction_table = self
        self.clock = SimpleNamespace(now_ns=lambda: self.spent_ns)
        self.description = SimpleNamespace(name="table", check=lambda raw: self.done.append("check"))

    def sample(self) -> Any:
        return SimpleNamespace(state=self.state)

    def disable(self) -> None:
        self.done.append("disable")
        self.state = DISABLED

    def read(self) -> RawTable:
        self.spent_ns += 1_000_000_000
        return self.holds

    def enabled(self) -> bool:
        return self.on

    def switch(self, on: bool) -> None:
        self.done.append("on" if on else "off")
        self.on = on

    def changes_left(self) -> int | None:
        return self.left

    def write(self, raw: RawTable, present: RawTable) -> None:
        self.spent_ns += 2_000_000_000
        self.done.append("new" if raw == NEW else "old")
        assert present == self.holds or self.forgets or raw == NEW
        if raw == OLD and self.refuses:
            raise self.refuses.pop(0)
        if not self.forgets:
            self.holds = raw


def drive(**what: Any) -> Any:
    return Noting(**what)


def broken_off(
    x: Any, note: Path, tell: Callable[[str], object], *acts: Callable[[TableChange], object]
) -> TableChange:
    """A change in which an error comes after some acts; it is the error that is raised, whatever undoing brings."""
    begun: list[TableChange] = []

    def run() -> None:
        with changing(x, note, tell) as change:
            begun.append(change)
            for act in acts:
                act(change)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run()
    return begun[0]


def written(change: TableChange) -> None:
    change.write(NEW)


def test_a_change_that_stays(tmp_path: Path) -> None:
    """Off before writing; 2 s for the write and 1 s for reading it back are its time; the note is there meanwhile and gone after."""
    x, note = drive(), tmp_path / "new folder" / "note.json"
    with changing(x, note, pytest.fail) as change:
        assert note.exists()
        change.write(NEW)
        change.switch(True)
    assert x.done == ["check", "off", "new", "on"]
    assert change.seconds == 3.0
    assert (x.holds, x.on, note.exists(), change.undone) == (NEW, True, False, False)


@pytest.mark.parametrize(("left", "goes"), [(None, True), (3, True), (2, True), (1, False), (0, False), (-1, False)])
def test_a_memory_that_wears_has_a_write_left_for_the_way_back(left: int | None, goes: bool, tmp_path: Path) -> None:
    x = drive(left=left)
    with changing(x, tmp_path / "note", pytest.fail) as change:
        if goes:
            change.write(NEW)
            assert x.holds == NEW
        else:
            with pytest.raises(StateError, match=rf"has {max(0, left or 0)} changes left; .* needs 2"):
                change.write(NEW)
            assert x.done == ["check"], "nothing was touched"


def test_an_error_under_power_takes_the_power_away_first(tmp_path: Path) -> None:
    x = drive()
    change = broken_off(
        x, tmp_path / "note", pytest.fail, written, lambda _: setattr(x, "state", POWERED), lambda _: x.done.clear()
    )
    assert x.done == ["disable", "off", "old", "on"]
    assert (x.holds, x.on, change.undone, list(tmp_path.iterdir())) == (OLD, True, True, [])


def test_under_power_nothing_is_written_or_switched(tmp_path: Path) -> None:
    x = drive()
    with changing(x, tmp_path / "note", pytest.fail) as change:
        for state in (POWERED, DriveState.SWITCHED_ON, DriveState.QUICK_STOP):
            x.state = state
            for act in (lambda: change.write(NEW), lambda: change.switch(False)):
                with pytest.raises(StateError, match=f"not changed under power, it is {state.value}"):
                    act()
        x.state = DISABLED
    assert x.done == []


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ProtocolError("no answer")])
def test_the_way_back_is_tried_three_times(error: BaseException, tmp_path: Path) -> None:
    """After the third attempt the note is kept, and its place told."""
    note, told = tmp_path / "note", list[str]()
    x = drive(refuses=[error, error])
    broken_off(x, note, told.append, written)
    assert (told, x.holds, note.exists()) == ([], OLD, False)
    x = drive(refuses=[error, error, error])
    change = broken_off(x, note, told.append, written)
    (sentence,) = told
    assert sentence.startswith(
        f"drive X: its correction table was not put back ({error or 'interrupted'}); it is kept in {note}"
    )
    assert (x.holds, note.exists(), change.undone) == (NEW, True, False)
    x.done.clear()
    assert recover(x, note)
    assert (x.done, x.holds, x.on, note.exists()) == (["off", "old", "on"], OLD, True, False)
    assert not recover(x, note), "there is nothing more to put back"


def test_what_is_put_back_is_read_back(tmp_path: Path) -> None:
    """A drive that acknowledges and keeps the new table."""
    x, note, told = drive(), tmp_path / "note", list[str]()
    broken_off(x, note, told.append, written, lambda _: setattr(x, "forgets", True))
    assert "the table's plus 1 was written 1, it reads back 5" in told[0]
    with pytest.raises(SafetyError, match="cannot be put back"):
        recover(x, note)
    assert note.exists()


def test_a_table_that_is_as_it_was_is_not_written_again(tmp_path: Path) -> None:
    """Each write wears the memory; the switch alone is put back."""
    x = drive()
    broken_off(x, tmp_path / "note", pytest.fail, lambda change: change.switch(False))
    assert x.done == ["off", "on"]


def test_the_note_of_the_zero_makes_its_folder(tmp_path: Path) -> None:
    note = tmp_path / "a" / "b" / "X.drive-table.json"
    remember_zero(note, replace(OLD), None)
    assert note.exists()
