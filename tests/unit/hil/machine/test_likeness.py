"""A simulated machine with the measured errors of another: what a campaign finds on it, and what it says of itself."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import bench_axis

import hil
from drivers.errors import InputError
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.axis.identity import identity
from hil.records.journal import MARKER
from hil.records.rows import Records, read_csv

NOISES = 5.0
"""Largest difference of two means of two runs, in standard deviations of a row: 3.5 of that difference, for ten of them."""
CYCLIC_UM = 3.0


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Records]:
    """The folder of a calibrated axis with its axis file, and its uncorrected rows."""
    path = bench_axis.lay_out(tmp_path_factory.mktemp("calibrated"))
    with pytest.MonkeyPatch.context() as patch:
        for name, value in bench_axis.PASSWORDS.items():
            patch.setenv(name, value)
        with hil.open(path) as axis:
            return path.parent, axis.calibrate().raw.before


@pytest.fixture
def source(passwords: None, calibrated: tuple[Path, Records], tmp_path: Path) -> tuple[Path, Records]:
    """A copy of the campaigns of that axis, and its uncorrected rows."""
    return shutil.copytree(calibrated[0], tmp_path / "real") / "X-campaign", calibrated[1]


def alike(source: Path) -> Path:
    """An axis file of the bench in the likeness of another axis, elsewhere."""
    path = bench_axis.lay_out(source.parents[1] / "likeness")
    path.write_text(rehearsal(path, source))
    return path


def rehearsal(path: Path, source: Path) -> str:
    """The text of an axis file with the machine of its bench replaced."""
    return path.read_text().replace('machine = "geometric"\nseed = 5', f'like = "{source}"')


def simulated(source: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What `hil sim` says of the machine in the likeness of an axis."""
    assert main(["sim", "drive", "--interface", "slcan-pty", "--like", str(source), "--for", "0.05"]) == 0
    machine: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[0])["machine"]
    return machine


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def means_um(rows: Records) -> list[float]:
    places = zip(rows.target_mm, rows.direction, strict=True)
    here = [(rows.target_mm == place) & (rows.direction == sign) for place, sign in dict.fromkeys(places)]
    return [float(rows.uncorrected_error_um[mine].mean()) for mine in here]


def noise_um(rows: Records) -> float:
    """Standard deviation of a row, from two runs."""
    first, second = (rows.uncorrected_error_um[rows.run == run] for run in (1, 2))
    return float(np.sqrt(np.mean((second - first) ** 2) / 2.0))


def test_a_campaign_finds_the_measured_errors_again(source: tuple[Path, Records]) -> None:
    """Also with an effect that was found beside them, which shows between the places that were measured."""
    folder, measured = source
    finding = {"effect": "cyclic", "action": "compensate", "peak_um": CYCLIC_UM}
    (folder / "calibrate-001/before.diagnosis.json").write_text(json.dumps({"findings": [finding]}))
    with hil.open(alike(folder)) as axis:
        again = axis.calibrate().raw.before
        axis.home()
        readings = []
        for place_mm in np.arange(140.0, 151.0, 1.25):
            axis.move_to(float(place_mm))
            readings.append(axis.read())
    errors_um = [1000.0 * (one.instrument_mm - one.motor_mm) for one in readings if one.instrument_mm is not None]
    allowed_um = NOISES * max(noise_um(measured), noise_um(again))
    assert means_um(again) == pytest.approx(means_um(measured), abs=allowed_um)
    assert allowed_um < 0.1
    along_um = abs(errors_um[-1] - errors_um[0])  # over a turn of the screw: the slope of the table
    swing_um = np.ptp(errors_um) - along_um
    assert swing_um > CYCLIC_UM


def test_it_says_that_it_is_a_likeness(source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = source
    written = folder.parent / "S.toml"
    words = ["sim", "drive", "--interface", "slcan-pty", "--laser", "--like", str(folder), "--axis-file", str(written)]
    assert main([*words, "--for", "0.05"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out.splitlines()[0])["machine"]["kind"] == "likeness"
    assert "proves nothing of that axis" in said.err
    assert 'name = "X-like"' in written.read_text(), "its rows never come into the real axis's folder"
    assert load_axis(written).purpose("calibrate")["drive"]["like"] == str(folder), "a likeness of it is refused"
    assert "a likeness of X-campaign, which proves nothing of it" in identity(load_axis(written))["Drive"]
    assert main([*words[:-3], str(folder.parent), "--for", "0.05"]) == 2
    assert "holds no measure.csv" in capsys.readouterr().err


def test_an_axis_of_a_few_millimetres_gets_targets_within_its_travel(
    source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, written = source[0], source[0].parent / "S.toml"
    marker = folder / "calibrate-001" / MARKER
    purpose = json.loads(marker.read_text())
    purpose["limits"] |= {"travel_min_mm": -1.8, "travel_max_mm": 1.8}
    marker.write_text(json.dumps(purpose))
    rows = [
        "run,direction,target_mm,measured_mm",
        *(f"1,{way},{at},{at}" for way in (1, -1) for at in (-0.8, 0.0, 0.8)),
    ]
    (folder / "calibrate-001/measure.csv").write_text("\n".join(rows) + "\n")
    words = ["sim", "drive", "--interface", "slcan-pty", "--laser", "--like", str(folder), "--axis-file", str(written)]
    assert main([*words, "--for", "0.05"]) == 0
    targets_mm = load_axis(written).measurement.targets_mm
    assert len(set(targets_mm)) == 11
    assert min(targets_mm) < -0.8
    assert max(targets_mm) > 0.8
    capsys.readouterr()


@pytest.mark.parametrize("like", ["X-campaign", "../real/X-campaign"])
def test_it_never_writes_to_the_real_axis_s_folder(source: tuple[Path, Records], like: str) -> None:
    folder, _ = source
    before = files(folder)
    copy = folder.parent / "rehearse.toml"
    copy.write_text(rehearsal(folder.parent / "axis.toml", Path(like)))
    with (
        pytest.raises(InputError, match=r"rehearse.toml.*\[drive\] like.*another \[axis\] name") as raised,
        hil.open(copy) as axis,
    ):
        axis.calibrate()
    assert "\n" not in str(raised.value)
    assert files(folder) == before
    copy.write_text(copy.read_text().replace('name = "X"', 'name = "X-rehearsal"'))
    with hil.open(copy) as axis:
        axis.home()
    assert files(folder) == before


def test_only_a_campaign_that_is_complete_and_of_the_machine_itself_counts(
    source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]
) -> None:
    """Each of the campaigns beside the one that counts is newer, and has a diagnosis that shows where it is taken."""
    folder, _ = source
    first = folder / "calibrate-001"
    finding = {"effect": "cyclic", "action": "compensate", "peak_um": CYCLIC_UM}
    for number, (without, mark, like) in enumerate(
        [("finished", "", False), ("finished", "discarded", False), ("", "discarded", False), ("", "", True)], start=2
    ):
        again = Path(shutil.copytree(first, folder / f"calibrate-{number:03d}"))
        (again / "before.diagnosis.json").write_text(json.dumps({"findings": [finding]}))
        if without:
            (again / without).unlink()
        if mark:
            (again / mark).touch()
        if like:
            purpose = json.loads((again / "campaign.json").read_text())
            purpose["drive"]["like"] = str(folder)
            (again / "campaign.json").write_text(json.dumps(purpose))
        assert simulated(folder, capsys)["effects"] == {}, again.name
    (first / "finished").unlink()
    assert main(["sim", "drive", "--interface", "slcan-pty", "--like", str(folder), "--for", "0.05"]) == 2
    assert "holds no measure.csv of a finished" in capsys.readouterr().err


def test_a_reversal_error_that_was_not_measured_is_not_zero(
    source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, measured = source
    rows = folder / "calibrate-001/measure.csv"
    lines = rows.read_text().splitlines()
    heading = next(at for at, line in enumerate(lines) if not line.startswith("#"))
    column = lines[heading].split(",").index("direction")
    up = [line for line in lines[heading + 1 :] if not line.startswith("#") and float(line.split(",")[column]) > 0]
    assert len(up) == np.count_nonzero(measured.direction == 1)
    rows.write_text("\n".join([*lines[: heading + 1], *up]) + "\n")
    assert main(["sim", "drive", "--interface", "slcan-pty", "--like", str(folder), "--for", "0.05"]) == 2
    assert "no target approached from both sides" in capsys.readouterr().err


def test_effects_found_at_rest_stay_beside_those_in_motion(
    source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = source
    found = {
        "before": [("cyclic", 3.0), ("thermal_expansion", 8.0)],
        "motion-before": [("velocity_lag", 4.0), ("cyclic", 1.0)],
    }
    for name, effects in found.items():
        findings = [{"effect": effect, "action": "compensate", "peak_um": size} for effect, size in effects]
        (folder / f"calibrate-001/{name}.diagnosis.json").write_text(json.dumps({"findings": findings}))
    assert simulated(folder, capsys)["effects"] == {"cyclic": 3.0, "thermal_expansion": 8.0, "velocity_lag": 4.0}


def test_a_machine_and_a_likeness_together_are_refused(
    source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = source
    words = ["sim", "drive", "--interface", "slcan-pty", "--like", str(folder), "--machine", "worn", "--for", "0.05"]
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert "not allowed with argument" in capsys.readouterr().err
    words[6:8] = ["--seed", "3"]
    assert main(words) == 2
    assert "--seed is which machine of --machine" in capsys.readouterr().err
    text = alike(folder).read_text()
    for key, value in (("machine", '"worn"'), ("seed", "3")):
        path = folder.parents[1] / "likeness/both.toml"
        path.write_text(text.replace("like =", f"{key} = {value}\nlike ="))
        with pytest.raises(InputError, match=rf"\[drive\] {key}.*beside like"), hil.open(path):
            pass


def test_an_axis_whose_zero_is_within_its_travel_has_a_likeness(
    tmp_path: Path, source: tuple[Path, Records], capsys: pytest.CaptureFixture[str]
) -> None:
    """The measured axis moved by half its travel: the same errors, at the same places of the machine."""
    folder, measured = source
    marker, rows = folder / "calibrate-001/campaign.json", folder / "calibrate-001/measure.csv"
    purpose = json.loads(marker.read_text())
    purpose["limits"] |= {"travel_min_mm": -252.0, "travel_max_mm": 252.0}
    marker.write_text(json.dumps(purpose))
    moved = read_csv(rows)
    columns = {
        "run": moved.run,
        "direction": moved.direction,
        "target_mm": moved.target_mm - 250.0,
        "measured_mm": moved.measured_mm - 250.0,
    }
    lines = [",".join(columns), *(",".join(f"{one:.9g}" for one in row) for row in zip(*columns.values(), strict=True))]
    rows.write_text("\n".join(lines) + "\n")
    assert simulated(folder, capsys)["length_mm"] == 500.0
    path = alike(folder)
    text = path.read_text()
    for here, there in (("-2.0", "-252.0"), ("502.0", "252.0"), ("20.0", "-230.0"), ("260.0", "10.0")):
        text = text.replace(f"_mm = {here}\n", f"_mm = {there}\n")
    path.write_text(text)
    with hil.open(path) as axis:
        again = axis.calibrate().raw.before
    allowed_um = NOISES * max(noise_um(measured), noise_um(again))
    assert min(again.target_mm) < -200.0
    assert means_um(again) == pytest.approx(means_um(measured), abs=allowed_um)


def test_an_axis_of_a_few_millimetres_has_a_likeness(source: tuple[Path, Records]) -> None:
    """It is shorter than what a simulated axis travels beyond its length."""
    marker = source[0] / "calibrate-001/campaign.json"
    purpose = json.loads(marker.read_text())
    purpose["limits"] |= {"travel_min_mm": -1.5, "travel_max_mm": 1.5}
    marker.write_text(json.dumps(purpose))
    path = alike(source[0])
    text = path.read_text()
    for here, there in (("-2.0", "-1.5"), ("502.0", "1.5"), ("20.0", "-0.5"), ("260.0", "0.5\noverrun_mm = 0.1")):
        text = text.replace(f"_mm = {here}\n", f"_mm = {there}\n")
    path.write_text(text)
    with hil.open(path) as axis:
        axis.home()
        axis.move_to(0.5)
        assert axis.read().instrument_mm == pytest.approx(0.5, abs=0.1)
