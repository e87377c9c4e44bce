"""What a diagnosis looks like, from its JSON: the numbers of its drawings are those it speaks of."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hil.app.main import main
from hil.diagnosis import pictures
from hil.records.rows import Records, to_csv


def warming(runs: int) -> Records:
    """A screw that grows by 11 µm/m and °C while it warms, measured at five places, with 0.2 µm of noise."""
    rng = np.random.default_rng(4)
    rows = []
    for run in range(1, runs + 1):
        temp_c = 20.0 + 4.0 * (1.0 - math.exp(-run / 3.0))
        for direction in (1, -1):
            for target in (0.0, 103.0, 191.0, 312.0, 405.0)[::direction]:
                error_um = 0.01 * target + direction + 11e-3 * target * (temp_c - 20.0) + 0.2 * rng.normal()
                rows.append((run, direction, target, target + error_um / 1000.0, 20.0 * len(rows), temp_c))
    names = ("run", "direction", "target_mm", "measured_mm", "time_s", "temp_screw_c")
    return Records.of(dict(zip(names, zip(*rows, strict=True), strict=True)))


@pytest.mark.outside
def test_the_residual_and_the_effect_are_those_of_the_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    records = warming(8)
    Path("r.csv").write_text(to_csv(records))
    assert main(["diagnose", "r.csv", "--json", "d.json"]) == 0
    form = json.loads(Path("d.json").read_text())
    residual = np.array(form["residual_um"])
    assert len(residual) == len(records)
    assert math.sqrt(np.mean(residual**2)) == pytest.approx(form["before"]["rms_um"], abs=0.001)
    (finding,) = form["findings"]
    plot = finding["plot"]
    assert (finding["effect"], plot["column"], plot["unit"]) == ("thermal_expansion", "temp_screw_c", "°C")
    assert plot["x"] == records["temp_screw_c"].tolist()
    assert plot["direction"] == records.direction.tolist()
    effect = 11e-3 * records.target_mm * (records["temp_screw_c"] - 20.0)
    found, left = np.array(plot["effect_um"]), np.array(plot["residual_um"])
    assert np.std(left - found) == pytest.approx(0.2, rel=0.4)
    inside = np.linalg.lstsq(np.stack([effect, records.target_mm, np.ones(len(records))], axis=1), found, rcond=None)
    assert math.sqrt(float(inside[1][0]) / len(records)) < 0.1 * np.std(found)  # but for what a table holds as well

    assert main(["report", "r.csv", "--diagnosis", "d.json", "--out", "r.html"]) == 0
    page = Path("r.html").read_text()
    assert "laid over: thermal_expansion." in page
    shown = json.loads(page.split('id="data-residual">')[1].split("<")[0])["columns"]["residual_um"]
    assert shown == pytest.approx(form["residual_um"])

    monkeypatch.setattr(pictures, "MOST_POINTS", 30)
    assert main(["diagnose", "r.csv", "--json", "d.json"]) == 0
    form = json.loads(Path("d.json").read_text())
    assert "residual_um" not in form
    assert len(form["findings"][0]["plot"]["x"]) == 27
    capsys.readouterr()
