"""`hil params` from the command line: on a Modbus server on loopback, and on a simulated CANopen drive in a process of its own."""

from __future__ import annotations

import io
import itertools
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hostile import disks
from support.bench_axis import AXIS, lay_out
from support.modbus_parameters import NEW, OLD, FortyFace, write_map
from support.sim_process import SimProcess

from drivers.clock import WallClock
from hil.app.main import main
from hil.correction.sealed import new_key, save_public_key, sign_detached
from hil.parameters import command as jobs
from hil.parameters.set_file import SetEntry, read_set, write_set
from hil.parameters.snapshot import Backup
from sim_backends.canopen_drive import EDS
from sim_backends.modbus_drive import tcp_server

SIDES = {"old": [entry.raw for entry in OLD.entries], "new": [entry.raw for entry in NEW.entries]}


@pytest.fixture
def face() -> FortyFace:
    return FortyFace()


@pytest.fixture
def axis(face: FortyFace, tmp_path: Path) -> Iterator[Path]:
    """An axis file whose drive is on a Modbus server of this process."""
    write_map(tmp_path)
    with tcp_server({7: face}, WallClock()) as (_, port):
        path = tmp_path / "X.toml"
        path.write_text(
            f'{AXIS}\n[drive]\nbackend = "modbus"\nregister_map = "forty.toml"\nurl = "tcp://127.0.0.1:{port}"\nunit = 7\n'
        )
        write_set(tmp_path / "new.toml", NEW)
        yield path


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = main(["params", *map(str, arguments)])
    told = capsys.readouterr()
    return status, told.out, told.err


def test_a_whole_job(axis: Path, face: FortyFace, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, result = tmp_path / "new.toml", tmp_path / "result.json"
    status, out, _ = run(capsys, "backup", axis)
    assert (status, (tmp_path / "X.params.toml").exists()) == (0, True)
    assert "X.params.toml" in out
    status, out, _ = run(capsys, "diff", axis, "--set", new)
    assert status == 0
    assert "as in the set: 0 of 40 parameters; different: 40" in out
    assert re.search(r"a download takes at most [\d.]+ ms", out)
    assert run(capsys, "verify", axis, "--set", new)[0] == 1
    status, out, _ = run(capsys, "download", axis, "--set", new, "--dry-run")
    assert (status, face.ram) == (0, SIDES["old"])
    assert "would read 40 parameters" in out
    status, out, _ = run(capsys, "download", axis, "--set", new, "--store", "--json", result)
    assert (status, face.ram, face.flash) == (0, SIDES["new"], SIDES["new"])
    assert "written, and read back (40 written" in out
    form: dict[str, Any] = json.loads(result.read_text())
    assert form["good"] is True
    assert [row["verdict"] for row in form["drives"][0]["parameters"]] == ["written"] * 40
    assert all(row["read_s"] > 0 and row["write_s"] > 0 for row in form["drives"][0]["parameters"])
    assert run(capsys, "verify", axis, "--set", new)[0] == 0
    status, out, _ = run(capsys, "restore", axis)
    assert (status, face.ram, face.flash) == (0, SIDES["old"], SIDES["new"])
    assert run(capsys, "store", axis, "--set", new)[0] == 1  # it holds something else: not stored
    assert face.stores == 1
    assert run(capsys, "store", axis)[0] == 0  # what the last download, the restore, wrote
    assert (face.stores, face.flash) == (2, SIDES["old"])
    assert run(capsys, "resume", axis)[:2] == (0, "nothing to do: no download was cut off\n")
    assert run(capsys, "restore", axis, "--set", tmp_path / "X.params.toml")[0] == 0


def test_what_cannot_be_done_is_one_line(axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new = tmp_path / "new.toml"
    for arguments, what in (
        (("download", axis), "--set FILE is missing"),
        (("download", axis, "--set", tmp_path / "none.toml"), "none.toml: cannot be read"),
        (("download", axis, "--set", new, "--set", new), "--set is given twice"),
        (("download", axis, "--set", new, "--audit"), "--audit needs --store"),
        (("download", axis, "--set", new, "--signed"), "new.toml: has no signature beside it"),
        (("download", axis, axis, "--set", new), "axis X is given twice"),
        (("restore", axis, "--factory", "--store"), "--factory goes with no other option"),
        (("restore", axis), "has no download of X in its journal"),
        (("backup", axis, "--out", "a", "--out", "b"), "--out is given twice"),
        (("backup", axis, "--format", "dcf"), "is no CANopen object"),
    ):
        status, _, err = run(capsys, *arguments)
        assert (status, err.count("\n")) == (2, 1), (arguments, err)
        assert what in err


@pytest.mark.parametrize(
    ("said", "status"), [("n\n", 1), ("\n", 1), ("ja\n", 1), ("", 2)], ids=["no", "nothing", "another word", "nobody"]
)
def test_factory_defaults_are_loaded_once_a_backup_is_there_and_a_person_has_agreed(
    axis: Path,
    face: FortyFace,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    *,
    monkeypatch: pytest.MonkeyPatch,
    said: str,
    status: int,
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(said))
    found, out, err = run(capsys, "restore", axis, "--factory")
    assert (found, face.ram) == (status, SIDES["old"])
    assert "the maker's defaults take the place of all 40 parameters" in out
    assert "nothing was loaded" in out + err
    (backup,) = tmp_path.glob("X-*.params.toml")
    assert f"hil params restore {axis} --set {backup} --store" in out
    assert len(read_set(backup).entries) == 40


@pytest.mark.parametrize(("said", "options"), [("y\n", ()), ("YES\n", ()), ("", ("--yes",))])
def test_who_agrees_gets_the_factory_defaults(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    said: str,
    options: tuple[str, ...],
) -> None:
    path = lay_out(tmp_path)
    path.write_text(
        path.read_text(encoding="utf-8").replace("[drive]\n", '[drive]\nface = "canopen"\n'), encoding="utf-8"
    )
    monkeypatch.setattr(sys, "stdin", io.StringIO(said))
    found, out, _ = run(capsys, "restore", path, "--factory", *options)
    assert (found, "X: holds its factory defaults, and was restarted" in out) == (0, True)
    assert len(list(tmp_path.glob("X-*.params.toml"))) == 1


def test_a_drive_that_could_not_be_read_keeps_what_it_has(
    axis: Path, face: FortyFace, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "back_up_axes", lambda axes, _paths, **_how: [Backup(axes[0].drive, error="is silent")])
    monkeypatch.setattr(jobs, "connected_parameters", pytest.fail)
    found, out, _ = run(capsys, "restore", axis, "--factory", "--yes")
    assert (found, face.ram) == (1, SIDES["old"])
    assert out == "X: no backup: is silent\nnothing was loaded\n"
    assert not list(tmp_path.glob("X-*.params.toml"))


def test_a_changed_or_foreign_set_is_refused(
    axis: Path, face: FortyFace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, key, other = tmp_path / "new.toml", new_key(), new_key()
    save_public_key(tmp_path / "builder.pub", key.public_key())
    signature = tmp_path / "new.toml.sig"
    signature.write_bytes(sign_detached(new.read_bytes(), other))
    status, _, err = run(capsys, "download", axis, "--set", new)
    assert status == 2
    assert "signed with another key" in err
    signature.write_bytes(sign_detached(new.read_bytes(), key))
    assert run(capsys, "verify", axis, "--set", new, "--signed")[0] == 1
    new.write_text(new.read_text() + "# a comment\n")
    status, _, err = run(capsys, "download", axis, "--set", new)
    assert status == 2
    assert "the file was changed after the builder signed it" in err
    assert face.ram == SIDES["old"]


def test_a_refused_set_is_exit_1_and_names_every_reason(
    axis: Path, face: FortyFace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.toml"
    write_set(wrong, type(NEW)("wrong", None, (*NEW.entries, SetEntry("target", 5), SetEntry("nothing", 1))))
    for extra in ((), ("--dry-run",)):
        status, out, _ = run(capsys, "download", axis, "--set", wrong, *extra)
        assert status == 1
        assert "line 46: target" in out
        assert "line 47: nothing: the drive's file has no such parameter" in out
    assert face.ram == SIDES["old"]


@pytest.mark.parametrize("kind", disks.KINDS)
def test_a_disk_that_is_full_at_any_write_leaves_the_drive_whole(
    kind: str, axis: Path, face: FortyFace, capsys: pytest.CaptureFixture[str]
) -> None:
    """The disk stays full; then there is room again."""
    new, backup = axis.with_name("new.toml"), axis.with_name("X.params.toml")
    tried = 0
    for verb in ("backup", "download"):
        order = [verb, axis, *(["--set", new] if verb == "download" else [])]
        for at in itertools.count(1):
            with disks.FullDisk(kind, at).here():
                status, out, err = run(capsys, *order)
            if status == 0:
                break
            tried += 1
            assert "No space left on device" in out + err, (verb, at)
            assert "Traceback" not in out + err
            assert not list(axis.parent.rglob("*.part")), (verb, at)
            assert not backup.exists() or verb == "download", "half a backup"
            assert run(capsys, "rollback", axis)[0] == 0
            if face.ram == SIDES["new"]:  # the disk was full only when everything was written and the journal closed
                assert run(capsys, "restore", axis)[0] == 0
            assert face.ram == SIDES["old"], (verb, at)
    assert tried
    assert (backup.exists(), face.ram) == (True, SIDES["new"])


# -- in processes --------------------------------------------------------------------------------------------------------
@pytest.fixture
def canopen_axis(tmp_path: Path) -> Iterator[Path]:
    """A simulated drive in a process of its own, on an adapter's terminal."""
    machine = SimProcess("drive", "--interface", "slcan-pty")
    try:
        path, place = tmp_path / "X.toml", machine.place["drive"]
        path.write_text(
            f'{AXIS}\n[drive]\nbackend = "canopen"\ninterface = "slcan"\nchannel = "{place["channel"]}"\n'
            f'node_id = {place["node_id"]}\neds = "{EDS}"\nsdo_timeout_s = 2.0\n'
        )
        yield path
    finally:
        machine.end()


@pytest.mark.outside
def test_a_drive_in_a_process_of_its_own(
    canopen_axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Backed up as TOML, DCF and concise DCF; downloaded, stored, audited by a restart; killed in the middle and rolled back."""
    backup = tmp_path / "X.params.toml"
    assert run(capsys, "backup", canopen_axis)[0] == 0
    for form in ("dcf", "cdcf"):
        assert run(capsys, "backup", canopen_axis, "--out", tmp_path / f"X.{form}")[0] == 0
        assert run(capsys, "verify", canopen_axis, "--set", tmp_path / f"X.{form}")[0] == 0
    text = backup.read_text(encoding="utf-8")
    changed = re.sub(r"(index = 0x2210, subindex = 1,) value = \d+, raw = \d+", r"\1 value = 4321", text)
    changed = re.sub(r"(index = 0x6065, subindex = 0,) value = \d+, raw = \d+", r"\1 value = 777", changed)
    new = tmp_path / "new.toml"
    new.write_text(re.sub("hash = .*\n", "", changed), encoding="utf-8")
    assert read_set(new).hash is None
    status, out, _ = run(capsys, "download", canopen_axis, "--set", new, "--store", "--audit")
    assert status == 0
    assert "stored, and proven: after its restart it still holds all of it" in out
    assert run(capsys, "verify", canopen_axis, "--set", new)[0] == 0
    journal = tmp_path / "X-campaign" / "parameters"
    command = [
        sys.executable,
        "-m",
        "hil.app.main",
        "params",
        "download",
        str(canopen_axis),
        "--set",
        str(backup),
    ]
    for _ in range(20):  # until one is killed between its first and its last write
        before = len(list(journal.iterdir()))
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None and len(list(journal.iterdir())) == before:
                time.sleep(0.0005)
            process.kill()
        noted = sorted(journal.iterdir())[-1].read_text()
        if noted.endswith("\n") and '"end"' not in noted:
            break
        assert run(capsys, "download", canopen_axis, "--set", new)[0] == 0
    else:
        pytest.fail("never killed in time")
    status, _, err = run(capsys, "download", canopen_axis, "--set", backup)
    assert status == 2
    assert "is not finished, expected `hil params resume` or `hil params rollback` first" in err
    assert run(capsys, "rollback", canopen_axis)[0] == 0
    assert run(capsys, "verify", canopen_axis, "--set", new)[0] == 0
