"""What a machine remembers of its sealed file: an older one, or another machine's, is not taken in its place without the builder."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

from drivers.errors import InputError, StateError
from hil.app.main import main
from hil.axis.axis_file import AxisConfig, load_axis
from hil.correction.sealed import ReplacedError, check, new_key, resign
from hil.correction.sealed.seen import SeenFile, check_seen
from hil.correction.store import SealedStore
from hil.correction.tables import DirectionalTable, TableMode, TableSet

READING, KEY = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]


def tables(level_um: float) -> TableSet:
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable.constant(np.array([0.0, 100.0]), level_um))


@pytest.fixture
def axis(tmp_path: Path) -> AxisConfig:
    return load_axis(bench_axis.lay_out(tmp_path / "here"))


def reading(axis: AxisConfig) -> SealedStore:
    return SealedStore.of(axis, READING)


def level_um(axis: AxisConfig) -> float:
    return float(reading(axis).load().tables.pitch.plus_um[0])


def test_an_older_file_is_refused_until_the_builder_accepts_it(axis: AxisConfig, tmp_path: Path) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    older = builder.path.read_bytes()
    builder.save_tables(tables(2.0))
    assert level_um(axis) == 2.0
    builder.path.write_bytes(older)
    with pytest.raises(
        ReplacedError, match=r"tables\.sealed: is older \(.*change 1 .*than the file used before \(.*change 2"
    ):
        level_um(axis)
    with pytest.raises(ReplacedError):  # nor is it made into a newer one
        builder.save_tables(tables(3.0))
    with pytest.raises(ReplacedError):
        builder.withdraw()
    assert builder.path.read_bytes() == older
    with pytest.raises(StateError, match="builder's private key"):
        reading(axis).accept()
    builder.accept()
    assert level_um(axis) == 1.0


def test_the_builder_accepts_by_a_verb(axis: AxisConfig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    older = builder.path.read_bytes()
    builder.save_tables(tables(2.0))
    builder.path.write_bytes(older)
    monkeypatch.setenv("HIL_KEY_PASSWORD", KEY)
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown):
        assert main(["sign", "--accept", str(axis.path)]) == 0
    assert "counter" in shown.getvalue()
    assert level_um(axis) == 1.0
    monkeypatch.setenv("HIL_KEY_PASSWORD", "not the builder's one")
    assert main(["sign", "--accept", str(axis.path)]) == 2


def test_a_file_of_another_machine_with_the_same_axis_name_is_refused(axis: AxisConfig, tmp_path: Path) -> None:
    """One builder, so that the signature is good; the same passwords; neither axis has a zero yet."""
    there = load_axis(bench_axis.lay_out(tmp_path / "there"))
    for name in ("builder_key", "builder_public"):
        shutil.copy(getattr(axis.store, name), getattr(there.store, name))
    for each, level in ((axis, 1.0), (there, 9.0)):
        SealedStore.of(each, READING, KEY).save_tables(tables(level))
    axis.tables_path.write_bytes(there.tables_path.read_bytes())
    with pytest.raises(ReplacedError, match=r"is another file .* of another machine, or sealed anew"):
        level_um(axis)


def test_two_files_of_the_same_number_are_told_apart(axis: AxisConfig) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    first, note = builder.path.read_bytes(), builder.seen_path.read_bytes()
    builder.save_tables(tables(2.0))
    second = builder.path.read_bytes()
    builder.path.write_bytes(first)
    builder.seen_path.write_bytes(note)
    builder.save_tables(tables(3.0))  # a second history of the same file
    builder.path.write_bytes(second)
    with pytest.raises(ReplacedError, match="has the number, but not the contents"):
        level_um(axis)


def test_a_file_handed_on_to_another_key_is_the_same_file(axis: AxisConfig) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    assert builder.builder_key is not None
    successor = new_key()
    builder.path.write_bytes(resign(builder.path.read_bytes(), builder.builder_public, successor))
    handed = replace(reading(axis), builder_public=successor.public_key())
    assert handed.load().tables == tables(1.0)


def test_withdrawn_tables_do_not_come_back(axis: AxisConfig) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    old = builder.path.read_bytes()
    builder.withdraw()
    assert not builder.path.exists()
    builder.path.write_bytes(old)
    with pytest.raises(ReplacedError, match="older"):
        level_um(axis)
    builder.path.unlink()
    builder.save_tables(tables(2.0))
    assert level_um(axis) == 2.0


def test_a_file_that_was_there_before_the_note_opens_and_is_remembered(axis: AxisConfig) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    builder.seen_path.unlink()
    assert level_um(axis) == 1.0
    form = json.loads(builder.seen_path.read_text())
    info = check(builder.path.read_bytes(), builder.builder_public)
    assert info.binding is not None
    assert form == vars(SeenFile(info.id, 1, info.binding.date, info.builder, info.sha256))
    assert SeenFile.of(info).counter == 1


def test_the_stated_limit_who_deletes_the_note_takes_the_memory_with_it(axis: AxisConfig) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    older = builder.path.read_bytes()
    builder.save_tables(tables(2.0))
    builder.path.write_bytes(older)
    builder.seen_path.unlink()
    assert level_um(axis) == 1.0


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"id": 1, "counter": 1, "date": "", "builder": "", "sha256": ""}', "[" * 10_000]
)
def test_a_damaged_note_is_refused(axis: AxisConfig, text: str) -> None:
    builder = SealedStore.of(axis, READING, KEY)
    builder.save_tables(tables(1.0))
    builder.seen_path.write_text(text)
    with pytest.raises(InputError, match=r"X\.seen\.json: does not say"):
        check_seen(builder.seen_path, check(builder.path.read_bytes(), builder.builder_public))
