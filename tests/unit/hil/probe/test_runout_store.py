"""Values in force: whole or not at all, sealed where asked for; the history keeps what was refused, and survives a torn line."""

from __future__ import annotations

import os
import stat
import threading
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import pytest

from drivers.errors import InputError, StateError
from hil.correction.sealed import Cost, DamagedError, ForeignSignatureError, SealedError, new_key, seal
from hil.probe import store as runout_store
from hil.probe.runout import FourFeeds, RunOut
from hil.probe.store import HISTORY_COLUMNS, RunOutStore, Seal
from hil.records.files import held

WHEN = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)
FOUND = RunOut(0.010, -0.020, 2.0, 0.4)
TURN = FourFeeds(2.990, 2.980, 3.010, 3.020)


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    store = RunOutStore(tmp_path / "probe", "mill")
    store.save(RunOut(1.0, 1.0, 1.0), WHEN)
    store.save(FOUND, WHEN)
    assert store.load() == (FOUND, "2026-03-01T12:00:00+00:00")
    assert [path.name for path in store.directory.iterdir()] == ["runout.json"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("{", "", "is not JSON"),
        ("hil-runout-1", "hil-runout-9", "is no hil-runout-1 file"),
        ('"mill"', '"lathe"', "is of machine lathe, expected mill"),
        ("-0.02", "true", "y_mm is True, expected a number"),
        ("-0.02", "1e999", "y_mm is inf, expected a number"),
        ('"x_mm"', '"z_mm"', "x_mm is None, expected a number"),
    ],
)
def test_values_that_cannot_be_believed_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    store = RunOutStore(tmp_path, "mill")
    store.save(FOUND, WHEN)
    store.path.write_text(store.path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=said) as refusal:
        store.load()
    assert str(refusal.value).startswith(str(store.path))


def test_nothing_measured_yet(tmp_path: Path) -> None:
    store = RunOutStore(tmp_path, "mill")
    with pytest.raises(InputError, match="cannot be read"):
        store.load()
    assert store.history() == []


@pytest.mark.outside
def test_sealed_values_need_the_builders_key_to_be_changed(tmp_path: Path) -> None:
    key = new_key()
    builder = RunOutStore(tmp_path, "mill", Seal("secret of the probe", key.public_key(), key))
    builder.save(RunOut(1.0, 1.0, 1.0), WHEN)
    builder.save(FOUND, WHEN)
    user = RunOutStore(tmp_path, "mill", Seal("secret of the probe", key.public_key()))
    assert user.load()[0] == FOUND
    with pytest.raises(StateError, match="is locked"):
        user.save(FOUND, WHEN)
    assert b"0.01" not in user.path.read_bytes()
    stranger = RunOutStore(tmp_path, "mill", Seal("secret of the probe", new_key().public_key()))
    with pytest.raises(ForeignSignatureError):
        stranger.load()
    data = bytearray(user.path.read_bytes())
    data[-80] ^= 1
    user.path.write_bytes(data)
    with pytest.raises(SealedError) as damaged:
        user.load()
    assert isinstance(damaged.value, DamagedError | ForeignSignatureError)


def test_what_is_kept_is_locked_with_the_builders_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the slow test does at full cost: the first save seals, the next ones change that file, and only with the key."""
    monkeypatch.setattr(runout_store, "seal", partial(seal, cost=Cost(2, 1, 1)))
    key = new_key()
    builder = RunOutStore(tmp_path, "mill", Seal("secret of the probe", key.public_key(), key))
    builder.save(RunOut(1.0, 1.0, 1.0), WHEN)
    file_id = builder.path.read_bytes()[12:].split(b'"id":"')[1][:32]
    builder.save(FOUND, WHEN)
    assert builder.path.read_bytes()[12:].split(b'"id":"')[1][:32] == file_id  # changed, and not another
    user = RunOutStore(tmp_path, "mill", Seal("secret of the probe", key.public_key()))
    assert user.load()[0] == FOUND
    assert user.path.name == "runout.sealed"
    with pytest.raises(StateError, match="is locked"):
        user.save(FOUND, WHEN)


def test_a_number_that_is_none_is_not_kept(tmp_path: Path) -> None:
    store = RunOutStore(tmp_path / "a" / "b", "mill")
    with pytest.raises(ValueError, match="JSON"):
        store.save(RunOut(float("nan"), 0.0, 1.0), WHEN)
    store.save(FOUND, WHEN)
    assert store.path.read_text().splitlines()[1] == ' "format": "hil-runout-1",'


def test_who_saves_waits_for_who_is_saving(tmp_path: Path) -> None:
    store = RunOutStore(tmp_path, "mill")
    saving = threading.Thread(target=store.save, args=(FOUND, WHEN))
    with held(tmp_path, wait=True):
        saving.start()
        saving.join(0.1)
        assert saving.is_alive()
        assert not store.path.exists()
    saving.join()
    assert store.load()[0] == FOUND


def test_a_line_is_on_the_disk_before_append_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = RunOutStore(tmp_path / "a" / "b", "mill")
    flushed: list[str] = []
    fsync = os.fsync

    def spy(handle: int) -> None:
        flushed.append("directory" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        fsync(handle)

    monkeypatch.setattr(os, "fsync", spy)
    open_before = len(os.listdir("/proc/self/fd"))
    store.append(WHEN, "latch", (TURN,), FOUND, "stored")
    assert flushed == ["file", "directory"]
    store.append(WHEN, "latch", (TURN,), FOUND, "stored")
    assert flushed == ["file", "directory", "file"]
    assert len(os.listdir("/proc/self/fd")) == open_before
    last = store.history()[-1]
    assert (last["verdict"], last["y_um"], last["closure_um"], last["n_0_mm"]) == (
        "stored",
        "-20.000",
        "0.000",
        "2.990000",
    )


def test_the_history_grows_by_whole_lines(tmp_path: Path) -> None:
    store = RunOutStore(tmp_path / "probe", "mill")
    store.append(WHEN, "latch", (TURN, TURN), FOUND, "stored")
    with store.history_path.open("a") as torn:
        torn.write("2026-03-01T12:30:00+00:00,latch,1,2.99")  # power cut
    assert len(store.history()) == 2
    store.append(WHEN, "step", (TURN,), FOUND, "refused: the contacts do not close: 6.0000 mm, 5.9500 mm")
    rows = store.history()
    assert [row["turn"] for row in rows] == ["1", "2", "1"]
    assert rows[2]["verdict"] == "refused: the contacts do not close: 6.0000 mm, 5.9500 mm"
    assert (rows[0]["n_180_mm"], rows[0]["x_um"], rows[0]["tip_radius_mm"]) == ("3.010000", "10.000", "2.000000")
    assert tuple(rows[0]) == HISTORY_COLUMNS
