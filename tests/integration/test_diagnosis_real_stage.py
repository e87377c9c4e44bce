"""The diagnosis on a real stage, as a user types it: fitted on runs 1 to 3, judged on runs 4 and 5, which nothing was fitted to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.places import SHARED_DATA as SHARED

from hil.app.main import main
from hil.records.rows import Records, read_csv, to_csv


def stage(axis: str) -> Path:
    path = SHARED / f"stage_b02_{axis}.csv"
    if not path.exists():
        pytest.skip(f"measured data {path.name} is not at hand (HIL_SHARED_DATA)")
    return path


def diagnosed(tmp_path: Path, records: Path, *more: str) -> tuple[dict[str, Any], Path]:
    """What `hil diagnose` says of records, and the model it writes."""
    found, extended = tmp_path / "found.json", tmp_path / "extended.json"
    assert main(["diagnose", str(records), *more, "--json", str(found), "--out", str(extended)]) == 0
    return json.loads(found.read_text()), extended


def left_on_runs_4_and_5(tmp_path: Path, data: Path, model: Path) -> float:
    """RMS of what a model leaves on those runs, µm."""
    out = tmp_path / "applied.csv"
    assert main(["apply", "--model", str(model), str(data), "--runs", "4-5", "--out", str(out)]) == 0
    return float(np.sqrt(np.mean(read_csv(out)["residual_um"] ** 2)))


@pytest.mark.parametrize("declared", [False, True])
def test_the_warm_up_drift_of_x_is_found_without_a_thermometer_or_a_clock(tmp_path: Path, declared: bool) -> None:
    """The table alone leaves 4.82 µm, table and exponential drift of an earlier evaluation 3.57, an earlier diagnosis 2.60 µm."""
    data, table = stage("x"), tmp_path / "table.json"
    assert main(["fit", str(data), "--runs", "1-3", "--out", str(table)]) == 0
    assert left_on_runs_4_and_5(tmp_path, data, table) > 4.7
    model = ["--model", str(table)] if declared else []
    found, extended = diagnosed(tmp_path, data, "--runs", "1-3", *model)
    assert [finding["effect"] for finding in found["findings"]] == ["thermal_drift"]
    (drift,) = found["findings"]
    assert drift["action"] == "compensate"
    assert drift["parameters"]["drift_over_the_rows_um"]["value"] < 0  # three runs do not show where it ends
    assert "drift_um" not in drift["parameters"]
    assert {rival["effect"] for rival in drift["rivals"]} >= {"datum_step"}
    assert left_on_runs_4_and_5(tmp_path, data, extended) <= 2.67


@pytest.mark.parametrize("declared", [False, True])
def test_a_drift_of_z_that_three_runs_cannot_prove_is_suspected(tmp_path: Path, declared: bool) -> None:
    """The table alone leaves 1.16 to 1.18 µm, table and exponential drift of an earlier evaluation 1.09 µm, to the digits given.

    A table of the same three runs says nothing that they do not.
    """
    data, table = stage("z"), tmp_path / "table.json"
    assert main(["fit", str(data), "--runs", "1-3", "--out", str(table)]) == 0
    assert left_on_runs_4_and_5(tmp_path, data, table) > 1.15
    model = ["--model", str(table)] if declared else []
    found, extended = diagnosed(tmp_path, data, "--runs", "1-3", *model)
    assert found["findings"] == []
    assert not found["unexplained"]
    assert any(note.startswith("thermal_drift is suspected") for note in found["notes"])
    assert left_on_runs_4_and_5(tmp_path, data, extended) <= 1.13


def test_a_correction_that_would_do_harm_is_not_recommended(tmp_path: Path) -> None:
    """Once the table of run 1 corrects z, runs 1 and 2 leave too little to learn from: a second table would be worse than none."""
    data, table, again = stage("z"), tmp_path / "table.json", tmp_path / "again.csv"
    assert main(["fit", str(data), "--runs", "1", "--out", str(table)]) == 0
    applied = tmp_path / "applied.csv"
    assert main(["apply", "--model", str(table), str(data), "--runs", "1-2", "--out", str(applied)]) == 0
    records = read_csv(applied)
    corrected = records.target_mm + records["residual_um"] / 1e3
    again.write_text(to_csv(Records.of({**records.columns, "measured_mm": corrected})))
    found, _ = diagnosed(tmp_path, again)
    alone_um = float(np.sqrt(np.mean(records["residual_um"] ** 2)))
    assert found["after"]["rms_um"] > alone_um
    assert found["recommended"] is False
    (why,) = [note for note in found["notes"] if note.startswith("not recommended")]
    assert f"{alone_um:.3g} µm" in why
