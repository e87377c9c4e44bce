"""A simulated machine with the measured errors of another: what a campaign finds on it, and what it says of itself."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

import hil
from hil.app.main import main
from hil.records.rows import Records

NOISES = 5.0
"""Largest difference of two means of two runs, in standard deviations of a row: 3.5 of that difference, for ten of them."""
CYCLIC_UM = 3.0


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Records]:
    """The folder of a calibrated axis, and its uncorrected rows."""
    for name, value in bench_axis.PASSWORDS.items():
        monkeypatch.setenv(name, value)
    path = bench_axis.lay_out(tmp_path / "real")
    with hil.open(path) as axis:
        return path.parent / "X-campaign", axis.calibrate().raw.before


def alike(source: Path) -> Path:
    """An axis file of the bench in the likeness of another axis, elsewhere."""
    path = bench_axis.lay_out(source.parents[1] / "likeness")
    path.write_text(path.read_text().replace('machine = "geometric"', f'like = "{source}"'))
    return path


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
    assert main([*words[:-3], str(folder.parent), "--for", "0.05"]) == 2
    assert "holds no measure.csv" in capsys.readouterr().err
