"""`hil fit`, `apply` and `diagnose` as a user types them, on real data where it is at hand and on a hand-made campaign."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.places import SHARED_DATA as SHARED

from hil.app.main import main
from hil.effects import ALL
from hil.effects.base import Form, Term
from hil.effects.model import Model, PitchTable
from hil.effects.warming import as_far_as_seen
from hil.records.rows import Records, read_csv, to_csv


def stage(name: str) -> Records:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"measured data {name} is not at hand (HIL_SHARED_DATA)")
    return read_csv(path)


@pytest.mark.parametrize(
    ("name", "raw_um", "table_um"), [("stage_b02_x.csv", 33.2, 4.82), ("stage_b02_z.csv", 11.6, 1.18)]
)
def test_a_table_of_runs_1_to_3_on_runs_4_and_5_of_a_real_stage(
    tmp_path: Path, name: str, raw_um: float, table_um: float
) -> None:
    records = stage(name)
    held_out = tmp_path / "held_out.csv"
    held_out.write_text(to_csv(records.of_runs([4, 5])))
    model, out = tmp_path / "model.json", tmp_path / "out.csv"
    assert main(["fit", str(SHARED / name), "--runs", "1-3", "--out", str(model)]) == 0
    assert main(["apply", "--model", str(model), str(held_out), "--out", str(out)]) == 0
    applied = read_csv(out)
    assert np.sqrt(np.mean(applied.error_um**2)) == pytest.approx(raw_um, abs=0.05)
    assert np.sqrt(np.mean(applied["residual_um"] ** 2)) <= table_um
    np.testing.assert_allclose(
        applied["residual_um"], applied.uncorrected_error_um + applied["correction_um"], atol=1e-6
    )


def campaign(expansion_ppm_k: float, seed: int = 3) -> Records:
    """8 runs of 42 rows on a wavy axis with backlash that a warming screw stretches; worked out here, row by row."""
    rng = np.random.default_rng(seed)
    rows: dict[str, list[float]] = {
        name: []
        for name in ("run", "direction", "target_mm", "measured_mm", "time_s", "temp_screw_c", "colour_of_coolant")
    }
    time_s = 0.0
    for run in range(1, 9):
        for step in range(42):
            time_s += 7.0
            direction = 1.0 if step < 21 else -1.0
            place = step if step < 21 else 41 - step
            target = 20.0 * place + rng.uniform(-4.0, 4.0) + 10.0
            screw_c = 20.0 + 3.0 * (1.0 - np.exp(-time_s / 900.0)) + 0.5 * np.sin(run * 2.1)
            error_um = 4.0 * np.sin(target / 60.0) - 2.5 * (direction < 0)
            error_um += expansion_ppm_k * 1e-3 * target * (screw_c - 20.0) + rng.normal(0.0, 0.4)
            values = (run, direction, target, target + error_um / 1000.0, time_s, screw_c, rng.normal())
            for name, value in zip(rows, values, strict=True):
                rows[name].append(float(value))
    return Records.of(rows)


def test_diagnose_writes_the_agreed_json_and_a_model_that_apply_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    measured, fresh = tmp_path / "measured.csv", tmp_path / "fresh.csv"
    measured.write_text(to_csv(campaign(11.5)))
    fresh.write_text(to_csv(campaign(11.5, seed=4)))
    found, extended, out = tmp_path / "found.json", tmp_path / "extended.json", tmp_path / "out.csv"
    assert main(["diagnose", str(measured), "--json", str(found), "--out", str(extended)]) == 0
    result = json.loads(found.read_text())
    assert set(result) >= {
        "noise_floor_um", "declared", "findings", "unexplained", "before", "after", "held_out", "seconds",
    }  # fmt: skip
    assert result["declared"] == ["pitch_table"]
    assert result["unexplained"] is False
    assert result["noise_floor_um"] is None  # no target is approached twice in the same conditions
    assert result["noise"]["within_run_um"] == pytest.approx(0.4, rel=0.15)
    (finding,) = result["findings"]
    assert set(finding) >= {"effect", "parameters", "confidence", "action", "explanation", "rivals"}
    assert (finding["effect"], finding["action"]) == ("thermal_expansion", "compensate")
    said = capsys.readouterr().out
    size = re.search(r"([\d.]+) ± ([\d.]+) µm RMS\.", " ".join(said.split()))
    assert size is not None, "what it does on these rows, k = 2"
    assert [float(one) for one in size.groups()] == pytest.approx(
        [finding["rms_um"], 2.0 * finding["rms_std_um"]], rel=0.05
    )
    coefficient = finding["parameters"]["coefficient_ppm_per_k"]
    assert abs(coefficient["value"] - 11.5) < 4 * coefficient["std"] < 2.0
    assert result["after"]["rms_um"] < 0.25 * result["before"]["rms_um"]
    assert result["held_out"] == {"how": "leave-one-run-out", "rows": 336}

    assert main(["apply", "--model", str(extended), str(fresh), "--out", str(out)]) == 0
    applied = read_csv(out)
    assert np.sqrt(np.mean(applied["residual_um"] ** 2)) < 0.55
    assert "colour_of_coolant" in applied


def test_diagnose_finds_nothing_that_is_not_there(tmp_path: Path) -> None:
    measured, found = tmp_path / "measured.csv", tmp_path / "found.json"
    measured.write_text(to_csv(campaign(0.0)))
    assert main(["diagnose", str(measured), "--json", str(found), "--out", str(tmp_path / "model.json")]) == 0
    result = json.loads(found.read_text())
    assert result["findings"] == []
    assert result["unexplained"] is False


def test_a_model_that_needs_a_column_says_so_when_it_is_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured, model = tmp_path / "measured.csv", tmp_path / "model.json"
    measured.write_text(to_csv(campaign(11.5)))
    assert main(["diagnose", str(measured), "--out", str(model), "--json", str(tmp_path / "found.json")]) == 0
    bare = campaign(11.5)
    without = Records.of({name: values for name, values in bare.columns.items() if name != "temp_screw_c"})
    measured.write_text(to_csv(without))
    capsys.readouterr()
    assert main(["apply", "--model", str(model), str(measured), "--out", str(tmp_path / "out.csv")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "temp_screw_c" in error


def test_apply_says_on_how_many_rows_a_bounded_temperature_is_beyond_what_was_seen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """2.5 µm/K seen up to 22 °C: at 21 and 22 °C all of it is corrected, at 23 and 30 °C as much as at 22."""
    known = {one.id: one for one in ALL}["thermal_drift"]
    drift = Term(known, Form(known.id, "temperature", ("temp_screw_c",)), (), (2.5,), ((1e-4,),))
    bounded = as_far_as_seen(drift, {"temp_screw_c": np.array([20.0, 22.0])})
    model, records, out = (tmp_path / name for name in ("model.json", "records.csv", "out.csv"))
    model.write_text(Model(PitchTable((0.0,), (0.0,), (0.0,)), (bounded,)).to_json(), encoding="utf-8")
    warm = {"run": 1, "direction": 1, "target_mm": 5.0, "measured_mm": 5.0}
    columns = {name: np.full(4, value) for name, value in warm.items()} | {
        "temp_screw_c": np.array([21.0, 22.0, 23.0, 30.0])
    }
    records.write_text(to_csv(Records.of(columns)), encoding="utf-8")
    assert main(["apply", "--model", str(model), str(records), "--out", str(out)]) == 0
    assert read_csv(out)["correction_um"] == pytest.approx([-2.5, -5.0, -5.0, -5.0])
    assert "thermal_drift: on 2 of 4 rows temp_screw_c is beyond the range" in capsys.readouterr().out
    columns["temp_screw_c"] = np.full(4, 21.5)
    records.write_text(to_csv(Records.of(columns)), encoding="utf-8")
    assert main(["apply", "--model", str(model), str(records), "--out", str(out)]) == 0
    assert "beyond" not in capsys.readouterr().out
