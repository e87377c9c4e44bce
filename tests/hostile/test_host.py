"""The computer itself: a clock that is set during a campaign, a disk that is full at any write, two programs on one store."""

from __future__ import annotations

import itertools
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from datetime import datetime, timedelta, tzinfo
from importlib.resources import files
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hostile import disks
from hostile import files as fuzzed
from hostile.places import VERBS, Place, store_of
from support.bench_axis import PASSWORDS

import hil.correction.sealed.sealing
import hil.records.journal
import hil.records.zero
from hil.app.main import main
from hil.correction.sealed import Cost, check, new_key, save_private_key, save_public_key, seal
from hil.figures.history import merge, read_campaign

pytestmark = pytest.mark.outside

# -- the clock ---------------------------------------------------------------------------------------------------------
JUMPS_S = (0, -86_400, 3_600, -7, 31_536_000, -31_536_000)


@contextmanager
def jumping_clock() -> Iterator[None]:
    """Each look at the wall clock finds it set to another day."""
    jumps = itertools.cycle(JUMPS_S)

    class Set(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Any:
            return datetime.now(tz) + timedelta(seconds=next(jumps))

    with ExitStack() as stack:
        for module in (hil.records.journal, hil.records.zero, hil.correction.sealed.sealing):
            stack.enter_context(patch.object(module, "datetime", Set))
        yield


def test_a_clock_that_is_set_changes_neither_rows_nor_tables_nor_their_order(tmp_path: Path) -> None:
    found = []
    for name in ("steady", "set"):
        place = Place(tmp_path / name, "virtual")
        with place.wired(), jumping_clock() if name == "set" else ExitStack():
            VERBS["calibrate"](place)
        axis = place.axis()
        campaign = read_campaign(axis.store.directory / "calibrate-001")
        found.append((store_of(axis).load().tables, campaign))
    (tables, steady), (tables_set, jumped) = found
    assert tables == tables_set
    assert [one.name for one in steady.passes] == [one.name for one in jumped.passes]
    assert [one.begun for one in jumped.passes] != sorted(one.begun for one in jumped.passes), "they did jump"
    rows, rows_set = merge(steady.passes), merge(jumped.passes)
    assert np.array_equal(rows.error_um, rows_set.error_um)
    assert np.all(np.diff(rows_set["time_s"]) >= 0.0)


def test_a_campaign_resumes_after_the_clock_was_set_back(tmp_path: Path) -> None:
    folder = tmp_path / "axis"
    place = Place(folder, "virtual")
    with place.wired(), jumping_clock():
        with disks.FullDisk("write", 20).here(), pytest.raises(Exception, match="No space left"):
            VERBS["calibrate"](place)
        VERBS["calibrate"](Place(folder, "virtual", resume=True))


# -- the disk ----------------------------------------------------------------------------------------------------------
def _some(verb: str, kind: str, folder: Path, most: int) -> list[int]:
    count = disks.writes(verb, kind, folder)
    return sorted({round(at) for at in np.linspace(1, count, min(most, count))}) if count else []


@pytest.mark.parametrize(
    ("verb", "kind"), list(zip([verb for verb in VERBS if verb != "probe"], itertools.cycle(disks.KINDS), strict=False))
)
def test_a_disk_that_is_full_at_any_write_of_a_verb(verb: str, kind: str, tmp_path: Path) -> None:
    for at in _some(verb, kind, tmp_path / "counted", 3):
        found = disks.run(verb, kind, at, tmp_path / f"{at}")
        assert not found.complaints, (at, found)


# -- the disk, for the verbs that move nothing -------------------------------------------------------------------------
SPREAD = 64
"""Bytes by which a file differs between two runs, as it says how long they took."""
FILE_VERBS = {
    "export": "export table.csv --format linuxcnc --out new.comp",
    "import": "import x.comp --format linuxcnc --out new.csv",
    "sign --new-key": "sign --new-key new",
    "sign": "sign table.csv --key builder.key",
    "seal": "seal table.csv --out new.sealed --key builder.key",
    "seal --update": "seal x.comp --out x.sealed --key builder.key --update",
    "open": "open x.sealed --builder builder.pub --out new",
    "iso230": "iso230 rows.csv --json new.json",
    "fit": "fit rows.csv --out new.json",
    "apply": "apply --model model.json rows.csv --out new.csv",
    "diagnose": "diagnose rows.csv --json new.json --out more.json",
    "report": "report rows.csv --out new.html",
    "records merge": "records merge rows.csv rows.csv --out new.csv",
    "records export": "records export rows.csv --format iso-wide --out new.csv",
    "campaign design": "campaign design axis.toml --minutes 20 --out new.csv",
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the verbs read."""
    folder = tmp_path_factory.mktemp("inputs")
    key = new_key()
    save_private_key(folder / "builder.key", key, PASSWORDS["HIL_KEY_PASSWORD"], cost=Cost(2, 1, 1))
    save_public_key(folder / "builder.pub", key.public_key())
    (folder / "table.csv").write_text("position_mm,plus_um,minus_um\n0,0,1\n10,2,3\n20,1,2\n")
    (folder / "x.comp").write_text("0 0.0 0.001\n10 0.002 0.003\n")
    (folder / "x.sealed").write_bytes(
        seal({"table.csv": b"1" * 5000}, PASSWORDS["HIL_PASSWORD"], key, cost=Cost(2, 1, 1))
    )
    rows = [
        f"{run},{way},{at},{at + 0.001 * np.sin(at) + 0.0001 * ((7 * at + run + way) % 3):.6f}"
        for run in (1, 2, 3)
        for way in (1, -1)
        for at in range(0, 80, 10)
    ]
    (folder / "rows.csv").write_text("\n".join(["run,direction,target_mm,measured_mm", *rows, ""]))
    (folder / "axis.toml").write_text(files("hil.examples").joinpath("demo_axis.toml").read_text(encoding="utf-8"))
    (folder / "model.json").write_text(fuzzed.model())
    return folder


@contextmanager
def longest_file(most_bytes: int) -> Iterator[None]:
    """The kernel lets no file grow beyond this: a write ends short, the next one fails, as on a disk that has just become full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.usefixtures("passwords")
@pytest.mark.parametrize(
    "verb",
    [
        pytest.param(verb, marks=[] if verb in ("export", "seal", "open") else pytest.mark.outside)
        for verb in FILE_VERBS
    ],
)
def test_a_disk_that_is_full_at_any_write_of_a_verb_of_files(
    verb: str, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:

    def tried(name: str, disk: AbstractContextManager[None]) -> tuple[int, str, dict[str, bytes]]:
        """Exit status, error output, and the files that are new or changed."""
        folder = tmp_path / name
        shutil.copytree(inputs, folder, dirs_exist_ok=True)
        monkeypatch.chdir(folder)
        capsys.readouterr()
        with disk:
            status = main(FILE_VERBS[verb].split())
        now = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        was = {path.name: path.read_bytes() for path in inputs.iterdir()}
        return status, capsys.readouterr().err, {name: data for name, data in now.items() if was.get(name) != data}

    counted = {kind: disks.FullDisk(kind) for kind in disks.KINDS}
    with ExitStack() as stack:
        for disk in counted.values():
            stack.enter_context(disk.here())
        status, said, good = tried("good", nullcontext())
    assert status in (0, 1), said
    assert good
    longest = max(map(len, good.values()))
    full = [
        (f"{kind} {at}", disks.FullDisk(kind, at).here())
        for kind, disk in counted.items()
        for at in sorted({1, disk.count // 2 or 1, disk.count} if disk.count else ())
    ]
    full += [(f"{size} bytes", longest_file(size)) for size in {0, 1, longest // 2, max(1, longest - SPREAD - 1)}]
    for name, disk in full:
        status, said, left = tried(name, disk)
        errors = [line for line in said.splitlines() if line.startswith("hil: ")]
        assert status != 0, (name, "says nothing")
        assert len(errors) == 1, (name, said)
        assert "No space left on device" in said or "File too large" in said, (name, said)
        assert "traceback" not in said, (name, said)
        assert all(abs(len(data) - len(good[file])) <= SPREAD for file, data in left.items()), (
            name,
            "leaves half a file",
        )
        for each in left:
            (tmp_path / name / each).unlink()
        status, said, again = tried(name, nullcontext())
        assert status in (0, 1), (name, said)
        assert set(again) == set(good), name


# -- two programs ------------------------------------------------------------------------------------------------------
def test_two_programs_on_one_store_lose_nothing_and_each_remembers_its_own(tmp_path: Path) -> None:
    axis = Place(tmp_path / "axis", "virtual").axis()
    code = "import sys; sys.path[:0] = sys.argv[3:]; from hostile.disks import save_often; save_often(*sys.argv[1:3])"
    programs = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(axis.path), name, *sys.path], stderr=subprocess.PIPE, text=True
        )
        for name in ("X", "Y")
    ]
    assert [(program.communicate(timeout=120)[1], program.returncode) for program in programs] == [("", 0)] * 2
    store = store_of(axis)
    binding = check(store.path.read_bytes(), store.builder_public).binding
    assert binding is not None
    assert binding.counter == 2 * disks.SAVES, "every save is one change of the file"
    assert store.load().tables == disks.level(disks.SAVES - 1.0)
