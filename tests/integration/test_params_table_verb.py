"""`hil params table` as a user types it, on the bench."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.table_axis import lay_out_table_axis, store

import hil.drive_table.job
import hil.examples.drive_table
import sim_backends.virtual_drive
from drivers.correction_table import RawTable
from hil.app.main import main
from hil.axis.axis_file import AxisConfig
from hil.drive_table.change import Snapshot, remembered_zero, zero_note
from hil.records.zero import Zero, read_zero, write_zero
from sim_backends.virtual_faces import VirtualCorrectionTable

OLD = RawTable((5, 6), (7, 8), (), 100, 200)


class Kept:
    """What the drive holds over several calls of the verb, as its memory would."""

    raw = OLD
    enabled = True


@pytest.fixture
def kept(passwords: None, monkeypatch: pytest.MonkeyPatch) -> Kept:
    """A drive that corrects by an old table; `hil` is called anew for each job, and the drive stays."""
    memory = Kept()

    class Remembering(VirtualCorrectionTable):
        def read(self) -> RawTable:
            return memory.raw

        def _write(self, table: RawTable, present: RawTable | None) -> None:
            super()._write(table, present)
            memory.raw = table

        def _switch(self, on: bool) -> None:
            self._raw = memory.raw
            super()._switch(on)
            memory.enabled = on

        def enabled(self) -> bool:
            return memory.enabled

    monkeypatch.setattr(sim_backends.virtual_drive, "VirtualCorrectionTable", Remembering)
    return memory


@pytest.fixture
def axis(tmp_path: Path) -> AxisConfig:
    found, tables = lay_out_table_axis(tmp_path, "in process")
    store(found, tables)
    return found


def run(axis: AxisConfig, job: str, *options: str) -> int:
    return main(["params", "table", job, str(axis.path), *options])


def test_download_prove_show_and_remove(
    kept: Kept, axis: AxisConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    assert run(axis, "download", "--dry-run") == 0
    assert (kept.raw, kept.enabled) == (OLD, True)
    assert "would write 11 points" in capsys.readouterr().out

    assert run(axis, "download", "--prove-by", "drive", "--positions", "3", "--json", str(out)) == 0
    found = json.loads(out.read_text())
    assert (found["good"], found["points"], kept.enabled) == (True, 11, True)
    assert 0 < found["rounding_um"] <= 0.005 + 1e-9
    assert found["rounding_um"] <= found["deviation_um"] <= 0.5
    assert len(found["proof"]["places"]) == 6
    assert "the drive corrects by it now; the bridge must not" in capsys.readouterr().out

    assert run(axis, "show", "--json", str(out)) == 0
    found = json.loads(out.read_text())
    assert (found["enabled"], found["points"]) == (True, 11)
    assert found["plus_um"][0] - found["minus_um"][0] == pytest.approx(12.0, abs=0.02)
    assert "corrects by it" in capsys.readouterr().out

    assert run(axis, "remove") == 0
    assert (kept.raw, kept.enabled) == (RawTable(), False)
    assert not list(axis.store.directory.glob("drive-table-before*"))


def test_what_was_not_proven_is_put_back(
    kept: Kept, axis: AxisConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    tight = ["--prove-by", "drive", "--positions", "3", "--tolerance-um", "0.001"]
    assert run(axis, "download", *tight, "--json", str(out)) == 1
    assert (kept.raw, kept.enabled) == (OLD, True)
    assert json.loads(out.read_text())["good"] is False
    shown = capsys.readouterr().out
    assert "put back as it was found" in shown
    assert "not proven" in shown or "does not correct" in shown


def test_an_interrupt_puts_everything_back(
    kept: Kept, axis: AxisConfig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_args: object, **_named: object) -> None:
        assert kept.raw != OLD
        raise KeyboardInterrupt

    monkeypatch.setattr(hil.drive_table.job, "prove_by_drive", interrupted)
    assert run(axis, "download", "--prove-by", "drive") == 130
    assert (kept.raw, kept.enabled) == (OLD, True)
    assert "interrupted" in capsys.readouterr().err


def test_a_change_that_was_broken_off_is_made_good_first(
    kept: Kept, axis: AxisConfig, capsys: pytest.CaptureFixture[str]
) -> None:
    note = axis.store.directory / "drive-table-before.json"
    note.parent.mkdir(parents=True, exist_ok=True)
    before = RawTable((1, 2, 3), (4, 5, 6), (), 10, 20)
    note.write_text(Snapshot(before, enabled=False).to_text())
    kept.enabled = False
    assert run(axis, "show") == 0
    assert "broken off" in capsys.readouterr().out
    assert run(axis, "remove", "--keep-contents") == 0
    assert "has been put back" in capsys.readouterr().err
    assert (kept.raw, kept.enabled) == (before, False)
    assert not note.exists()


def test_by_the_instrument_from_end_to_end(
    kept: Kept, axis: AxisConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    assert run(axis, "download", "--positions", "2", "--runs", "1", "--json", str(out)) == 0
    found = json.loads(out.read_text())["proof"]
    assert found["measured"]
    assert found["share"] == pytest.approx(1.0, abs=0.02)
    assert kept.enabled
    assert main(["verify", str(axis.path)]) == 2  # the bridge's own on top
    assert "would be corrected twice" in capsys.readouterr().err
    assert run(axis, "prove", "--positions", "2", "--runs", "1") == 0
    assert kept.enabled, "as it was found"
    assert "off the stored ones at most" in capsys.readouterr().out
    assert run(axis, "prove", "--dry-run") == 0
    assert "would measure" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("download --deviation-um 0.004", "in steps of 0.01 µm, which alone may be 0.005 µm off"),
        ("download --deviation-um 0", "--deviation-um: is '0', expected a number > 0"),
        ("prove --positions 1", "--positions: is '1', expected a whole number, 2 to 200"),
        ("prove --prove-by nothing", "invalid choice"),
    ],
)
def test_wrong_options_are_one_line(
    kept: Kept, axis: AxisConfig, capsys: pytest.CaptureFixture[str], line: str, words: str
) -> None:
    try:
        status = run(axis, *line.split())
    except SystemExit as error:
        status = int(str(error.code))
    assert status == 2
    assert words in capsys.readouterr().err
    assert (kept.raw, kept.enabled) == (OLD, True)


@pytest.mark.usefixtures("passwords")
def test_a_drive_without_a_table_says_what_to_write_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis, _ = lay_out_table_axis(tmp_path, "in process")
    axis.path.write_text(axis.path.read_text().replace('correction_table = "simulated_array"\n', ""))
    for job in ("show", "download", "remove"):
        assert run(axis, job) == 2
        assert "correction_table" in capsys.readouterr().err


def test_the_example_as_it_is_shipped(kept: Kept, axis: AxisConfig, capsys: pytest.CaptureFixture[str]) -> None:
    assert hil.examples.drive_table.main(str(axis.path)) == 0
    assert kept.enabled
    assert kept.raw != OLD
    assert "the drive corrects as the bridge does" in capsys.readouterr().out
    made_in = remembered_zero(zero_note(axis), kept.raw)
    assert made_in is not None
    assert made_in == read_zero(axis.zero_path)
    assert run(axis, "show") == 0
    assert made_in.describe() in capsys.readouterr().out


def test_a_drives_table_remembers_the_zero_it_was_made_in(
    kept: Kept, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axis, tables = lay_out_table_axis(tmp_path, "in process")
    first = Zero("ab" * 16, "X", "2026-03-01T08:00:00+00:00", {"model": "virtual"}, True, 21, -2.0)
    second = replace(first, id="cd" * 16, made="2026-04-01T08:00:00+00:00")
    write_zero(axis.zero_path, first)
    store(axis, tables)
    assert run(axis, "download", "--prove-by", "nothing") == 0
    assert run(axis, "show") == 0
    assert "abababab of 2026-03-01, homing method 21 to -2 mm" in capsys.readouterr().out

    write_zero(axis.zero_path, second)  # the axis got another zero
    before = kept.raw
    for job in (("download", "--prove-by", "nothing"), ("prove", "--prove-by", "drive")):
        assert run(axis, *job) == 2
        assert "the tables were made in another zero" in capsys.readouterr().err
    store(axis, tables)  # and was calibrated in it, but the drive's table is the old one
    assert run(axis, "prove", "--prove-by", "drive", "--positions", "3") == 2
    *_, line = capsys.readouterr().err.strip().splitlines()
    assert "made in another zero (abababab of 2026-03-01" in line
    assert kept.raw == before
    assert run(axis, "download", "--prove-by", "nothing") == 0
    assert run(axis, "show") == 0
    assert "cdcdcdcd of 2026-04-01" in capsys.readouterr().out
    assert run(axis, "remove") == 0
    assert not list(axis.store.directory.glob("*.drive-table.json"))
