"""`hil campaign` as a user types it, the plan measured on the bench, and the measurement that a diagnosis asks for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from study.next_study import standard_test, written
from study.planned_machine import PlannedMachine
from support import bench_axis

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.calibration.explore import explore
from hil.diagnosis import fit_model
from hil.diagnosis.loop.next_run import runs_of
from hil.diagnosis.next.plans import read_plan
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import to_csv


@pytest.fixture
def axis(tmp_path: Path) -> Path:
    path = bench_axis.lay_out(tmp_path)
    path.write_text(path.read_text().replace('backend = "bench"', 'backend = "bench"\nface = "virtual"'))
    return path


@pytest.mark.outside
def test_a_designed_plan_is_measured_row_by_row_and_checked(axis: Path, tmp_path: Path) -> None:
    plan, out = tmp_path / "plan.csv", tmp_path / "design.json"
    design = ["campaign", "design", str(axis), "--out", str(plan), "--json", str(out)]
    assert main([*design, "--minutes", "22"]) == 0
    facts = json.loads(out.read_text())
    assert facts["minutes"] <= 22
    config = load_axis(axis)
    points = read_plan(plan, config.limits)
    assert len(points) == facts["rows"]
    with connected(config) as machine:
        machine.session.prepare()
        started_s = machine.session.elapsed_s()
        records = explore(
            machine.session, Campaign(tmp_path / "c", {}, resume=False), "plan", runs_of(points), lambda _: None
        )
        took_min = (machine.session.elapsed_s() - started_s) / 60
    assert records.target_mm.tolist() == [point.target_mm for point in points]
    assert records.direction.tolist() == [point.direction for point in points]
    assert took_min == pytest.approx(facts["minutes"] - 4.0, rel=0.25), "the plan says how long it takes"
    rows = tmp_path / "rows.csv"
    rows.write_text(to_csv(records))
    assert main(["campaign", "check", str(rows), "--axis", str(axis), "--json", str(out)]) == 1
    found = json.loads(out.read_text())
    assert found["repeats"] == facts["repeats"]
    assert {"missing"} <= {gap["kind"] for gap in found["gaps"]} <= {"missing", "alike", "blind"}


def test_bad_input_is_one_line_and_exit_2(axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["campaign", "design", str(axis), "--out", str(tmp_path / "p.csv"), "--minutes", "3"]) == 2
    assert "3 min are too short" in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main(["campaign", "design", str(axis), "--out", str(tmp_path / "p.csv"), "--minutes", "soon"])
    assert caught.value.code == 2
    assert main(["campaign", "check", str(tmp_path / "none.csv")]) == 2
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.outside
def test_a_diagnosis_names_hidden_rivals_and_the_run_that_tells_them_apart(tmp_path: Path) -> None:
    machine = PlannedMachine(31, "backlash", 3.0)
    plan = standard_test(machine, np.random.default_rng(2))
    rows = len(plan["run"])
    declared = fit_model(written(PlannedMachine(31, noise=1).measure(plan, rows), slice(0, rows)))
    records, model, out = tmp_path / "records.csv", tmp_path / "model.json", tmp_path / "out.json"
    records.write_text(to_csv(written(machine.measure(plan, rows), slice(0, rows))))
    model.write_text(declared.to_json())
    assert main(["diagnose", str(records), "--model", str(model), "--json", str(out)]) == 0
    result = json.loads(out.read_text())
    finding = result["findings"][0]
    assert finding["effect"] == "backlash"
    assert finding["rivals"][0]["effect"] == "load_deflection"
    assert "kg" in finding["rivals"][0]["separate_by"]
    assert "min" in finding["rivals"][0]["separate_by"]
    asked = result["next_measurement"]
    assert asked["adds"] == ["load_kg"]
    assert asked["person"]
    apart = {frozenset(pair["effects"]): pair["discrimination"] for pair in asked["tells_apart"]}
    assert apart[frozenset({"backlash", "load_deflection"})] == 30.0
