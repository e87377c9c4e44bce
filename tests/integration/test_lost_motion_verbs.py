"""`hil lost-motion` and `hil circle` as a user types them, on the bench."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support.bench_axis import PASSWORDS
from support.two_axes import lay_out_axes

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.published_rise import TwoTanh
from hil.correction.rise import TANH, Rise, rise_of
from hil.correction.store import SealedStore
from sim_backends.bench import known_bench

pytestmark = pytest.mark.usefixtures("passwords")

WORN_UM = 53.0


def stored(path: Path) -> SealedStore:
    return SealedStore.of(load_axis(path), PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"])


def test_dry_runs_touch_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, y = lay_out_axes(tmp_path, "canopen", lost_motion="")
    before = sorted(tmp_path.rglob("*"))
    assert main(["lost-motion", str(x), "--dry-run"]) == 0
    plan = capsys.readouterr().out
    assert (
        "to and fro between 135.413 and 141.413 mm 3 times at 100 mm/s, uncorrected, at rest at 20 places from 2 µm on"
        in plan
    )
    assert "if it proves itself" in plan
    assert main(["circle", str(x), str(y), "--dry-run", "--centre", "100", "90", "--clockwise"]) == 0
    plan = capsys.readouterr().out
    assert "axis Y over bench: would enable it, home it, take its datum at" in plan
    assert "move between 80 and 100 mm" in plan
    assert "10 mm clockwise at 100 mm/min, uncorrected: 44 s each" in plan
    assert main(["circle", str(x), str(y), "--feed", "700"]) == 2
    assert "a circle of 10 mm takes up to 613.9 mm/min" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("rising", "how"),
    [
        ("", "uncorrected, then with the tables of X and Y: 44 s each"),
        ("X", "uncorrected, then with the tables of X and Y, then with these and the lost motion of X: 44 s each"),
        (
            "XY",
            "uncorrected, then with the tables of X and Y, then with these and the lost motion of X and Y: 44 s each",
        ),
    ],
)
def test_a_dry_run_promises_what_is_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rising: str, how: str
) -> None:
    axes, typed = lay_out_axes(tmp_path, "virtual", lost_motion=""), tmp_path / "typed.csv"
    typed.write_text("position_mm,plus_um,minus_um\n20,1,2\n260,3,4\n")
    for path in axes:
        assert main(["calibrate", str(path), "--manual", str(typed)]) == 0
        if path.stem in rising:
            store = stored(path)
            store.save(replace(store.load(), rise=Rise(TANH, (8.0,), (0.5,))))
    capsys.readouterr()
    assert main(["circle", *map(str, axes), "--dry-run"]) == 0
    assert f"would drive 10 mm counter-clockwise at 100 mm/min, {how}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("places = 3", "[lost_motion] places is 3, expected a whole number, 10 to 200"),
        ("at_mm = 500.0", "[lost_motion] at_mm is 500: strokes of 6 mm around it leave the travel"),
        ("finest_um = 900.0", "[lost_motion] finest_um is 900 with 20 places"),
        ("stroke = 3", "stroke"),
    ],
)
def test_a_wrong_axis_file_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], section: str, words: str
) -> None:
    x, _ = lay_out_axes(tmp_path, lost_motion=f"[lost_motion]\n{section}\n")
    assert main(["lost-motion", str(x)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_nothing_to_correct_is_said_and_ends_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An axis that loses nothing at its reversals; stored is nothing."""
    (x, _), out = lay_out_axes(tmp_path, "modbus-vendor", machine="ideal"), tmp_path / "out.json"
    assert main(["lost-motion", str(x), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert (found["good"], found["needless"], found["stored"]) == (True, True, False)
    assert re.fullmatch(r"no lost motion to correct: 0\.\d\d µm with a noise of 0\.\d\d µm; .*", found["verdict"][0])
    assert found["verdict"][0] in capsys.readouterr().out
    assert not (tmp_path / "X-campaign" / "tables.sealed").exists()
    assert main(["lost-motion", str(x), "--resume", "--only-measure"]) == 0  # finished: nothing is left to resume


def test_without_the_builders_key_nothing_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, _ = lay_out_axes(tmp_path)
    (tmp_path / "builder.key").unlink()
    assert main(["lost-motion", str(x)]) == 2
    assert "hil sign --new-key builder" in capsys.readouterr().err
    assert not (tmp_path / "X-campaign").exists()


def test_a_drive_without_set_points_is_said_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axes = lay_out_axes(tmp_path, "modbus-vendor", machine="ideal")
    assert main(["circle", *map(str, axes)]) == 2
    assert "drive X cannot do: cyclic synchronous position" in capsys.readouterr().err
    assert not (tmp_path / "X-campaign" / "circle-001").exists()


@pytest.mark.outside
def test_from_two_worn_axes_to_a_round_circle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], record_property: Callable[[str, object], None]
) -> None:
    """10 mm at 100 mm/min, two drives on one CAN bus, in the drive trains that wind up by 53 µm."""
    axes = lay_out_axes(tmp_path, "canopen")
    out, page, round_page = tmp_path / "out.json", tmp_path / "lm.html", tmp_path / "circle.html"
    for axis in axes:
        report = ["--report", str(page)] if axis is axes[0] else []
        assert main(["lost-motion", str(axis), "--json", str(out), *report]) == 0
        found = json.loads(out.read_text())
        assert (found["good"], found["stored"], found["verdict"]) == (True, True, [])
        assert found["amount_um"] == pytest.approx(WORN_UM, rel=0.01)
        assert found["proof"]["before"]["rms_um"] > 20.0
        assert found["proof"]["after"]["rms_um"] < 0.05 * found["proof"]["before"]["rms_um"]
        assert found["proof"]["over_compensation_um"] <= 0.05 * found["amount_um"]
        assert set(found["parameters"]["amount_um"]) == {"value", "std"}
        assert stored(axis).load().rise is not None
    shown = capsys.readouterr().out
    assert "proof, after" in shown
    assert "RMS on strokes held out" in shown

    assert main(["circle", *map(str, axes), "--period-ms", "10", "--json", str(out), "--report", str(round_page)]) == 0
    found = json.loads(out.read_text())
    before, tables, after = (found["circles"][name] for name in ("uncorrected", "tables", "corrected"))
    assert [each["in_force"] for each in (tables, after)] == ["tables alone", "tables + lost motion"]
    assert after["bump_mean_um"] == pytest.approx(tables["bump_mean_um"], abs=after["floor_um"])  # it rises at once
    record_property(
        "bumps before, after, floor, µm", [before["bump_mean_um"], after["bump_mean_um"], after["floor_um"]]
    )
    assert before["bump_mean_um"] == pytest.approx(WORN_UM, rel=0.05)
    assert after["bump_mean_um"] <= 0.05 * before["bump_mean_um"]
    assert found["fallen_percent"] >= 95.0
    assert after["missed_set_points"] == 0
    assert len(list((tmp_path / "X-campaign" / "circle-001").glob("*.csv"))) == 3

    for text, words in (
        (page.read_text(), ("RMS on strokes held out", "standard uncertainty", "Fresh moves of all lengths")),
        (round_page.read_text(), ("Around the circle", "Bumps after the quadrants", "Fallen by")),
    ):
        assert text.count("<svg") == 2
        assert not re.search(r"(src|href)=\"https?:", text)
        for word in words:
            assert word in text


@pytest.mark.outside
def test_the_three_circles_where_the_lost_motion_rises_gradually(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Calibrated axes: tables alone switch at once, where the machine takes some millimetres."""
    section = "[lost_motion]\nplaces = 16\nruns = 2\n"
    axes, out = lay_out_axes(tmp_path, "modbus-tcp", machine="typical", lost_motion=section), tmp_path / "out.json"
    for axis in axes:
        assert main(["calibrate", str(axis)]) in (0, 1)
        assert main(["lost-motion", str(axis)]) == 0
    assert main(["circle", *map(str, axes), "--period-ms", "10", "--json", str(out)]) == 0
    found = json.loads(out.read_text())["circles"]
    before, tables, after = (found[name]["bump_mean_um"] for name in ("uncorrected", "tables", "corrected"))
    record_property(
        "bumps uncorrected, tables, tables + lost motion, floor, µm",
        [before, tables, after, found["corrected"]["floor_um"]],
    )
    assert before > 2.5 * tables
    assert tables > 2.5 * after
    assert after < 1.2 * found["corrected"]["floor_um"]


@pytest.mark.outside
@pytest.mark.parametrize(("face", "shape"), [("canopen", "two-tanh"), ("modbus-vendor", "straight-pieces")])
def test_a_shape_that_is_asked_for_is_taken(tmp_path: Path, face: str, shape: str) -> None:
    (x, _), out, page = lay_out_axes(tmp_path, face), tmp_path / "out.json", tmp_path / "lm.html"
    assert main(["lost-motion", str(x), "--shape", shape, "--json", str(out), "--report", str(page)]) == 0
    found = json.loads(out.read_text())
    assert found["asked_for"] is True
    rise = stored(x).load().rise
    assert rise is not None
    assert rise.shape.name == found["rise"]["shape"] == shape.replace("-", " ")
    assert set(found["published_form"]["parameters"]) == {"Pc1_um", "Pc2_um", "a1_mm", "a2_mm", "b2_mm"}
    assert {move["branch"] for move in found["published_form"]["moves"]} <= {1, 2}
    text = page.read_text()
    assert "The published form beside the running one" in text
    assert f"{rise.shape.name} asked for: " in text


@pytest.mark.outside
def test_typed_values_are_proven_and_stored_and_bad_ones_are_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (x, _), out = lay_out_axes(tmp_path, "modbus-vendor", machine="geometric"), tmp_path / "out.json"
    lost_um = known_bench("geometric", 5).plant.backlash.amount_um
    for share, good in ((0.5, False), (1.0, True)):
        typed = f"{0.6 * share * lost_um},{0.4 * share * lost_um},0.0003,0.0003,0"
        assert main(["lost-motion", str(x), "--typed", typed, "--json", str(out)]) == (0 if good else 1)
        found = json.loads(out.read_text())
        assert (found["typed"], found["stored"]) == (True, good)
        assert found["choice"].startswith("two tanh typed: ")
        assert found["amount_um"] == pytest.approx(share * lost_um)
    assert stored(x).load().rise == rise_of(TwoTanh(0.6 * lost_um, 0.4 * lost_um, 0.0003, 0.0003, 0.0))
    capsys.readouterr()
    for typed in ("1,2,3", "1,2,0,3,0", "-1,2,1,3,0", "a,2,1,3,0"):
        with pytest.raises(SystemExit) as ended:
            main(["lost-motion", str(x), f"--typed={typed}"])
        assert ended.value.code == 2
        assert "expected Pc1,Pc2,a1,a2,b2 as five numbers" in capsys.readouterr().err


@pytest.mark.outside
def test_by_the_estimated_position_it_lags_and_by_set_points_not(tmp_path: Path) -> None:
    """The same correction of an abrupt rise, fed fast: the encoder lies behind by the following error and by a period."""
    axes, out = lay_out_axes(tmp_path, "canopen"), tmp_path / "out.json"
    for axis in axes:
        assert main(["lost-motion", str(axis)]) == 0
    bumps = {}
    for travel_by in ("command", "estimate"):
        for axis in axes:
            text = axis.read_text().split("travel_by")[0]
            axis.write_text(f'{text}travel_by = "{travel_by}"\n')
        assert main(["circle", *map(str, axes), "--feed", "600", "--period-ms", "10", "--json", str(out)]) == 0
        bumps[travel_by] = json.loads(out.read_text())["circles"]["corrected"]["bump_mean_um"]
    assert bumps["command"] < 0.04 * WORN_UM
    assert 1.3 * bumps["command"] < bumps["estimate"] < 0.2 * WORN_UM


@pytest.mark.outside
def test_beside_tables_it_is_in_force_for_every_other_verb_and_a_calibration_replaces_it(tmp_path: Path) -> None:
    (x, _), out = lay_out_axes(tmp_path, machine="typical", lost_motion=""), tmp_path / "out.json"
    assert main(["calibrate", str(x)]) == 0
    tables = stored(x).load().tables
    command = [sys.executable, "-m", "hil.examples.lost_motion", str(x)]  # the verb in a few lines
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "LC_ALL": "C.UTF-8"})
    assert (done.returncode, done.stderr) == (0, "")
    assert re.search(
        r"fresh moves: [\d.]+ µm off at worst before, 0\.\d\d µm with the correction in force", done.stdout
    )
    together = stored(x).load()
    assert together.tables == tables  # as they were: the rise goes between their two directions
    assert together.rise is not None
    assert main(["verify", str(x), "--json", str(out)]) == 0
    assert json.loads(out.read_text())["B_um"] < 0.5  # of some 9
    stored(x).save_tables(tables)  # as a calibration does
    assert stored(x).load().rise is None


@pytest.mark.outside
def test_a_correction_that_does_not_prove_itself_is_not_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Strokes far too short for this machine's lost motion, which goes on rising over some millimetres."""
    short = "[lost_motion]\nstroke_mm = 0.5\nplaces = 12\nruns = 2\nproof_moves = 8\n"
    (x, _), out = lay_out_axes(tmp_path, machine="typical", lost_motion=short), tmp_path / "out.json"
    assert main(["lost-motion", str(x), "--json", str(out)]) == 1
    assert json.loads(out.read_text())["stored"] is False
    assert "the strokes are too short for the whole lost motion (stroke_mm)" in capsys.readouterr().out
    assert not (tmp_path / "X-campaign" / "tables.sealed").exists()
