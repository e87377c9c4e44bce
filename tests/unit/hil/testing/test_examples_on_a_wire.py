"""Three scripts that a user writes first, over the simulated drive of the plugin: positions, one parameter, creep after a stop."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from support.docs import lay_files

import hil
from hil.app.main import main
from hil.examples import change_parameter, creep
from hil.testing.drive import SimulatedDrive

pytestmark = pytest.mark.outside


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    lay_files("scripts", tmp_path)
    return tmp_path


def test_ten_positions_with_motor_and_instrument(folder: Path, simulated_drive: SimulatedDrive) -> None:
    rows: hil.Rows = runpy.run_path("positions.py")["measure"](simulated_drive.axis_file)
    assert list(rows["target_mm"]) == [10.0 * place for place in range(1, 11)]
    assert rows["motor_mm"] == pytest.approx(rows["target_mm"], abs=1e-3)
    assert rows["measured_mm"] == pytest.approx(rows["target_mm"], abs=0.05)


def test_one_parameter_is_changed_and_proven(folder: Path, simulated_drive: SimulatedDrive) -> None:
    file = str(simulated_drive.axis_file)
    with hil.open(file) as axis:
        before = axis.parameters.backup("before.toml")
    assert change_parameter.main(file, "6072h", "900") == 0
    with hil.open(file) as axis:
        differing = axis.parameters.diff(before).differing
        assert {name: held for name, (held, _) in differing.items()} == {"6072h:00": 900}
        assert axis.parameters.restore().good
        assert axis.parameters.diff(before).good


def test_creep_becomes_rows_that_the_diagnosis_takes(folder: Path, simulated_drive: SimulatedDrive) -> None:
    words = ["run", creep.__file__, "X.toml", "--targets-mm", "60,20,60", "--watch-s", "4"]
    assert main(words) == 0
    assert not simulated_drive.powered
    assert main(["diagnose", "X-campaign/run-creep-001/creep.csv", "--json", "found.json"]) in (0, 1)
    assert "findings" in json.loads(Path("found.json").read_text())


def test_they_are_checked_strictly_from_outside(folder: Path) -> None:
    for example in (change_parameter, creep):
        (folder / f"{Path(example.__file__).stem}.py").write_bytes(Path(example.__file__).read_bytes())
    words = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", "--cache-dir", str(folder / "cache")]
    files = ["positions.py", "change_parameter.py", "creep.py"]
    answer = subprocess.run([*words, *files], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
