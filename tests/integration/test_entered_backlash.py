"""A backlash measured by other means beside a measured pitch, from the command to the machine, over CANopen.

The bench's geometric machine has 6 µm of backlash, its worn one winds up by some 53 µm (`sim_backends.plant`).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis
from support.backlash_axis import QUICK

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.calibration.job import enter_backlash, entering_job
from hil.correction.store import SealedStore
from hil.correction.tables import SingleTable, TableMode
from hil.records.rows import read_csv

pytestmark = pytest.mark.usefixtures("passwords")

READING, KEY = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]


def reversal_um(directory: Path) -> float:
    """What the last verification found between the two directions, µm, by its raw rows."""
    rows = read_csv(sorted(directory.glob("X-campaign/verify-*/verify.csv"))[-1])
    return float(np.mean(rows.error_um[rows.direction < 0]) - np.mean(rows.error_um[rows.direction > 0]))


def entered(directory: Path, amount_um: float) -> Path:
    """Three positions, none of them a target."""
    path = directory / "backlash.csv"
    path.write_text("position_mm,backlash_um\n" + "".join(f"{at},{amount_um}\n" for at in (31.5, 120.25, 244.75)))
    return path


def test_beside_the_pitch_that_is_measured_and_beside_the_one_that_is_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bench_axis.lay_out(tmp_path)
    axis = load_axis(path)
    wrong = entered(tmp_path, 60.0)
    assert main(["calibrate", str(path), "--backlash", str(wrong)]) == 1
    assert "tables not used" in capsys.readouterr().err
    assert not axis.tables_path.exists(), "what the instrument contradicts is not stored"

    assert main(["calibrate", str(path), "--backlash", str(entered(tmp_path, 6.0))]) == 0
    stored = SealedStore.of(axis, READING).load()
    assert stored.tables.mode is TableMode.MEAN_BACKLASH
    assert stored.tables.backlash is not None
    assert stored.tables.backlash.position_mm.tolist() == [31.5, 120.25, 244.75]
    assert main(["verify", str(path)]) == 0
    assert abs(reversal_um(tmp_path)) < 0.5

    out = tmp_path / "out.json"
    again = ["calibrate", str(path), "--backlash", str(entered(tmp_path, 4.0)), "--stored"]
    assert main([*again, "--dry-run"]) == 0
    assert SealedStore.of(axis, READING).load() == stored
    assert main([*again, "--json", str(out)]) == 0
    assert json.loads(out.read_text())["tables"]["mode"] == "mean+backlash"
    now = SealedStore.of(axis, READING).load()
    assert now.zero is not None
    assert stored.zero is not None
    assert (now.made_with, now.zero.id) == (stored.made_with, stored.zero.id)
    assert main(["verify", str(path)]) in (0, 1)
    assert reversal_um(tmp_path) == pytest.approx(6.0 - 4.0, abs=0.5), "4 of 6 µm are taken out, once"


def test_what_it_does_not_go_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_axis.lay_out(tmp_path)
    backlash = ["--backlash", str(entered(tmp_path, 12.0))]
    for also, words in (
        (["--stored"], "--stored goes with --backlash"),
        ([*backlash, "--stored"], "holds no tables of the axis"),
        ([*backlash, "--stored", "--resume"], "--stored measures nothing"),
    ):
        assert main(["calibrate", str(path), *also]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line


def test_typed_pitch_with_a_backlash_on_its_own_positions(tmp_path: Path) -> None:
    path, typed, out = bench_axis.lay_out(tmp_path), tmp_path / "typed.csv", tmp_path / "out.json"
    typed.write_text("position_mm,plus_um,minus_um\n20,1,2\n260,3,4\n")
    backlash = entered(tmp_path, 12.0)
    assert main(["calibrate", str(path), "--manual", str(typed), "--backlash", str(backlash), "--json", str(out)]) == 0
    tables = SealedStore.of(load_axis(path), READING).load().tables
    assert (float(tables.correction_um(20.0, 1)), float(tables.correction_um(260.0, -1))) == (1.5 + 6.0, 3.5 - 6.0)


def test_lost_motion_by_torque_goes_into_the_sealed_tables_of_a_drive_without_a_parameter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bench_axis.lay_out(tmp_path, machine="worn")
    path.write_text(path.read_text() + f"[backlash]\nreference_plus_mm = 5.0\nreference_minus_mm = 5.0\n{QUICK}")
    out = tmp_path / "out.json"
    assert main(["backlash", str(path), "--write", "--json", str(out)]) == 0
    written_um = json.loads(out.read_text())["parameters"]["written"]
    assert written_um == pytest.approx(53.0, abs=2.0)
    assert "µm in the sealed tables, beside their pitch; not yet proven" in " ".join(capsys.readouterr().out.split())
    tables = SealedStore.of(load_axis(path), READING).load().tables
    assert tables.correction_um([0.0, 400.0], -1).tolist() == [-written_um] * 2
    assert main(["verify", str(path)]) in (0, 1)
    assert abs(reversal_um(tmp_path)) < 3.0, "of 53 µm"
    assert not list(tmp_path.rglob("backlash.json"))


def test_the_screen_enters_it_by_a_job(tmp_path: Path) -> None:
    axis = load_axis(bench_axis.lay_out(tmp_path))
    job = entering_job(axis, SingleTable(np.array([0.0]), np.array([4.0])))
    assert job.plan.locked
    assert [write.place for write in job.plan.writes] == [str(axis.tables_path)]
    assert not job.plan.moves
    store = SealedStore.of(axis, READING, KEY)
    alone = enter_backlash(store, axis, SingleTable(np.array([0.0]), np.array([4.0])))
    assert alone.tables.correction_um([10.0], 1).tolist() == [0.0]
    assert alone.tables.correction_um([10.0], -1).tolist() == [-4.0]
    assert store.load() == alone


def test_a_specified_value_with_signs_and_fine_steps_that_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    signs = "signs = [{ from_mm = 0.0, to_mm = 150.0, plus = 1, minus = -1 }]"
    path = bench_axis.lay_out(tmp_path, correction=f"band_um = [6.0, 7.0]\n{signs}")
    out = tmp_path / "out.json"
    assert main(["calibrate", str(path), "--json", str(out)]) == 0
    capsys.readouterr()
    assert json.loads(out.read_text())["fine_total_um"] == 6.0
    report = tmp_path / "verified.html"
    assert main(["verify", str(path), "--json", str(out), "--report", str(report)]) in (0, 1)
    (between,) = json.loads(out.read_text())["not_judged"]
    assert between["direction"] == -1
    assert between["low_mm"] < 150.0 <= between["high_mm"]
    assert between["low_mm"] < between["target_mm"] < between["high_mm"]
    for text in (" ".join(capsys.readouterr().out.split()), report.read_text(encoding="utf-8")):
        assert f"{between['target_mm']:g} mm -, between the targets {between['low_mm']:g} and" in text
        assert "their specified values differ in sign, and the correction runs from one to the other" in text
    folder = sorted((tmp_path / "X-campaign").glob("calibrate-*"))[-1]
    rows = read_csv(folder / "round-1.csv")
    for target, way, error in zip(rows.target_mm, rows.direction, rows.error_um, strict=True):
        sign = -1 if target < 150.0 and way < 0 else 1
        assert sign * error == pytest.approx(6.5, abs=0.5)
