"""`hil probe` as a user types it, on the bench."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import pytest
from support import probe_files

from hil.app.main import main
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key

QUICK = "touch_mm_s = 20.0\nposition_mm_s = 50.0"
SEED = "[bench]\nseed = 4"
TRUE_X_UM, TRUE_Y_UM = -63.49, -16.63  # of that seed, as the verb itself says of the simulated machine


def machine(tmp_path: Path, **more: Any) -> Path:
    return probe_files.lay_out(
        tmp_path, **{"start_mm": 102.6, "search_mm": 1.0, "probe": QUICK, "block": "turns = 1", "more": SEED, **more}
    )


def form(path: Path) -> Any:
    return json.loads(path.read_text())


def test_measure_correct_and_centre(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = machine(tmp_path, block="turns = 2"), tmp_path / "out.json"
    assert main(["probe", "measure", str(path), "--json", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"simulated     Δx {TRUE_X_UM:+.2f} µm, Δy {TRUE_Y_UM:+.2f} µm, tip radius 1.9894 mm" in said
    found = form(out)
    assert (found["good"], found["mode"], found["refused"]) == (True, "latch", None)
    assert 0.0 < found["run_out_std_um"] < 1.0
    assert f"{2 * found['run_out_std_um']:.2f} µm in Δx and in Δy (k = 2" in said
    assert 1000 * found["run_out"]["x_mm"] == pytest.approx(TRUE_X_UM, abs=1.0)
    assert 1000 * found["run_out"]["y_mm"] == pytest.approx(TRUE_Y_UM, abs=1.0)
    assert form(tmp_path / "mill-probe/runout.json")["x_mm"] == found["run_out"]["x_mm"]

    assert main(["probe", "correct", str(path), "--code", "M91", "--json", str(out)]) == 0
    assert form(out)["driven_mm"] == pytest.approx([found["run_out"]["x_mm"], 0.0])

    assert main(["probe", "centre", str(path), "--json", str(out)]) == 0
    said = capsys.readouterr().out
    true = [float(word) for word in said.split("simulated")[1].replace(",", " ").split()[2:7] if word[0].isdigit()]
    assert form(out)["centre_mm"] == pytest.approx(true, abs=1e-3)
    assert form(out)["middle_mm"] != pytest.approx(true, abs=10e-3)


FEATURES = """
[face]
axis = "y"
x_mm = 20.0
y_mm = 30.0
direction = -1
search_mm = 1.0

[angle]
axis = "x"
x_mm = 20.0
y_mm = 20.0
direction = 1
search_mm = 1.0
apart_mm = 12.0

[boss]
x_mm = 80.0
y_mm = 80.0
clear_mm = 9.0
search_mm = 1.0

[reference]
x_from_mm = [20.0, 55.0]
x_direction = 1
y_from_mm = [30.0, 46.0]
y_direction = 1
search_mm = 1.0
"""


@pytest.mark.parametrize(
    ("face", "spindle_deg", "names"),
    [
        (probe_files.CANOPEN, 217.0, ("face",)),
        pytest.param(probe_files.MODBUS, 30.0, ("reference",), marks=pytest.mark.outside),
        (probe_files.VIRTUAL, 90.0, ("face", "angle", "boss", "reference")),
        (probe_files.VIRTUAL, None, ("face", "angle", "boss", "reference")),
    ],
    ids=["canopen-217", "modbus-30", "virtual-90", "virtual-as-it-is"],
)
def test_other_measurements_are_corrected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], face: str, spindle_deg: float | None, names: tuple[str, ...]
) -> None:
    path, out = machine(tmp_path, drive=face, more=FEATURES + SEED), tmp_path / "out.json"
    assert main(["probe", "measure", str(path)]) == 0
    spindle = [] if spindle_deg is None else ["--spindle", str(spindle_deg)]
    for name in names:
        capsys.readouterr()
        assert main(["probe", name, str(path), *spindle, "--json", str(out)]) == 0
        said, found = capsys.readouterr().out, form(out)
        simulated = re.findall(r"(-?\d+\.\d+) (?:mm)|at (-?\d+\.\d+)°", said.split("simulated")[1])
        true = [float(mm or deg) for mm, deg in simulated]
        corrected, uncorrected = found["corrected"], found["uncorrected"]
        assert found["spindle_deg"] == pytest.approx(spindle_deg or 0.0, abs=1e-3)
        if name == "face":
            assert corrected["face_mm"] == pytest.approx(true[1], abs=1e-3)
            assert abs(uncorrected["face_mm"] - true[1]) > 0.01
        elif name == "angle":
            assert corrected["angle_deg"] == pytest.approx(true[2], abs=0.005)
            assert corrected["face_mm"] == pytest.approx(true[0], abs=1e-3)
        elif name == "boss":
            assert [corrected[key] for key in ("x_mm", "y_mm", "width_y_mm")] == pytest.approx(true, abs=1e-3)
            assert abs(uncorrected["x_mm"] - true[0]) > 0.01
        else:
            assert (corrected["x_mm"], corrected["y_mm"]) == pytest.approx((true[0], true[4]), abs=1e-3)
        assert "not moved, as [machine] names no z axis" in said


def test_a_machine_with_z_says_how_it_is_approached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = machine(tmp_path, z=True)
    assert main(["probe", "measure", str(path), "--dry-run"]) == 0
    assert "z: at 40 mm on the way, lowered to 30 mm to measure" in capsys.readouterr().out
    assert main(["probe", "measure", str(path), "--json", str(tmp_path / "out.json")]) == 0
    assert "at 40 mm on the way, lowered to 30 mm" in capsys.readouterr().out
    assert 1000 * form(tmp_path / "out.json")["run_out"]["x_mm"] == pytest.approx(TRUE_X_UM, abs=1.0)


def test_other_measurements_need_their_section_and_a_run_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = machine(tmp_path)
    assert main(["probe", "boss", str(path)]) == 2
    assert "lacks the table [boss]" in capsys.readouterr().err
    path = machine(tmp_path, more=FEATURES)
    assert main(["probe", "boss", str(path)]) == 2
    assert "runout.json: cannot be read" in capsys.readouterr().err


@pytest.mark.outside
def test_reports_of_a_measurement_and_of_a_bore(tmp_path: Path) -> None:
    path = machine(tmp_path)
    for _ in range(2):
        assert main(["probe", "measure", str(path), "--report", str(tmp_path / "r.html")]) == 0
    page = (tmp_path / "r.html").read_text()
    assert "http://" not in page
    assert page.count("<svg") == 3  # the ball, its contacts, the history
    assert main(["probe", "centre", str(path), "--report", str(tmp_path / "c.html")]) == 0
    assert "Diameter" in (tmp_path / "c.html").read_text()


def test_a_refused_measurement_is_status_1_and_changes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = machine(tmp_path, block="turns = 1\nclosure_limit_um = 0.000001"), tmp_path / "out.json"
    assert main(["probe", "measure", str(path), "--json", str(out)]) == 1
    assert "refused: the contacts do not close: N0 + N180 =" in capsys.readouterr().out
    assert form(out)["good"] is False
    assert "N90 + N270" in form(out)["refused"]
    assert [entry.name for entry in (tmp_path / "mill-probe").iterdir()] == ["history.csv"]


@pytest.mark.outside
def test_sealed_values_need_the_builders_password(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = machine(tmp_path, more=SEED + "\n[store]\nsealed = true")
    key = new_key()
    save_private_key(tmp_path / "builder.key", key, "builder of the probe", cost=Cost(n=1 << 10, r=8, p=1))
    save_public_key(tmp_path / "builder.pub", key.public_key())
    monkeypatch.setenv("HIL_PASSWORD", "reading of the probe")
    monkeypatch.setenv("HIL_KEY_PASSWORD", "wrong")
    assert main(["probe", "measure", str(path)]) == 2
    assert not (tmp_path / "mill-probe").exists()
    monkeypatch.setenv("HIL_KEY_PASSWORD", "builder of the probe")
    assert main(["probe", "measure", str(path)]) == 0
    kept = sorted(entry.name for entry in (tmp_path / "mill-probe").iterdir())
    assert kept == ["history.csv", "runout.sealed", "runout.seen.json"]
    assert main(["probe", "correct", str(path), "--code", "M93", "--dry-run"]) == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["correct", "--code", "M91"], "runout.json: cannot be read"),
        (["centre"], "runout.json: cannot be read"),
        (["measure", "--times", "3"], "--times needs --every"),
    ],
)
def test_what_cannot_be_done_is_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    path = machine(tmp_path)
    assert main(["probe", arguments[0], str(path), *arguments[1:]]) == 2
    assert said in capsys.readouterr().err


def test_a_dry_run_says_what_would_move_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = machine(tmp_path)
    assert main(["probe", "measure", str(path), "--dry-run", "--mode", "step"]) == 0
    said = capsys.readouterr().out
    assert "would feed x by up to 1 mm in + direction at 20 mm/s, contact by pulses of 1 µm" in said
    assert not (tmp_path / "mill-probe").exists()


@pytest.mark.outside
def test_the_example_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    examples = Path(__file__).parents[2] / "hil/examples"
    for name in ("probe_machine.toml", "probe_x.toml", "probe_y.toml", "probe_spindle.toml"):
        text = (examples / name).read_text().replace('face = "canopen"', 'face = "virtual"')
        (tmp_path / name).write_text(text)
    module = runpy.run_path(str(examples / "measure_probe.py"))
    assert module["main"](str(tmp_path / "probe_machine.toml")) == 0
    assert (tmp_path / "mill-probe/runout.json").exists()
