"""The EEPROM ledger: counts attempts, refuses beyond the budget, outlives the process, never half written."""

import errno
import json
from pathlib import Path

import pytest

from drivers.errors import InputError, StateError
from drivers.modbus.wear import WearLedger


def test_a_budget_is_used_up_per_drive_and_register(tmp_path: Path) -> None:
    ledger = WearLedger(tmp_path / "deep" / "wear.json")
    for _ in range(3):
        ledger.charge("X", "gain", 3)
    with pytest.raises(StateError, match="drive X: gain is kept in EEPROM and was written 3 times, its budget is 3"):
        ledger.charge("X", "gain", 3)
    assert ledger.writes("X", "gain") == 3
    ledger.charge("Y", "gain", 3)
    ledger.charge("X", "offset", 3)
    with pytest.raises(StateError):
        ledger.charge("X", "never", 0)


def test_counts_outlive_the_process_and_leave_no_litter(tmp_path: Path) -> None:
    path = tmp_path / "wear.json"
    WearLedger(path).charge("X", "gain", 5)
    WearLedger(path).charge("X", "gain", 5)
    assert WearLedger(path).writes("X", "gain") == 2
    assert json.loads(path.read_text(encoding="utf-8")) == {"X/gain": 2}
    assert [each.name for each in tmp_path.iterdir()] == ["wear.json"]


def test_without_a_file_it_counts_for_this_process() -> None:
    ledger = WearLedger()
    ledger.charge("X", "gain", 1)
    with pytest.raises(StateError):
        ledger.charge("X", "gain", 1)


@pytest.mark.parametrize("text", ["", "[]", '{"X/gain": -1}', '{"X/gain": true}', '{"X/gain": 1.5}', "{"])
def test_a_file_that_is_no_ledger_is_refused_and_not_overwritten(tmp_path: Path, text: str) -> None:
    path = tmp_path / "wear.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="wear ledger"):
        WearLedger(path)
    assert path.read_text(encoding="utf-8") == text


def test_an_interrupted_write_leaves_the_old_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "wear.json"
    ledger = WearLedger(path)
    ledger.charge("X", "gain", 5)

    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "power cut")

    monkeypatch.setattr("drivers.files.os.fsync", broken)
    with pytest.raises(InputError, match="power cut"):
        ledger.charge("X", "gain", 5)
    assert WearLedger(path).writes("X", "gain") == 1
    assert [each.name for each in tmp_path.iterdir()] == ["wear.json"]
