"""The values of one campaign that can age, against what the campaign was made with."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from support.fleet import HEADER, rows

from drivers.errors import InputError
from hil.fleet.values import FleetValue, of_pass, of_result, of_torque_file
from hil.records.rows import Records, parse_csv


def read(text: str) -> Records:
    return parse_csv(f"{HEADER}\n{text}")


def by_name(found: list[FleetValue]) -> dict[str, FleetValue]:
    assert len({one.quantity for one in found}) == len(found)
    return {one.quantity: one for one in found}


def test_backlash_is_the_axis_s_own_whatever_table_is_in_force() -> None:
    found = [by_name(of_pass(read(rows(np.random.default_rng(1), 12.0, noise_um=0.1)), "verify"))["backlash_um"]]
    corrected = read(rows(np.random.default_rng(1), 12.0, noise_um=0.1))
    untouched = corrected.with_column("measured_mm", corrected.measured_mm - corrected.command_mm + corrected.target_mm)
    untouched = untouched.with_column("command_mm", untouched.target_mm)
    found.append(by_name(of_pass(untouched, "verify"))["backlash_um"])
    for one in found:
        assert one.value == pytest.approx(12.0, abs=0.1)
        assert one.of == 5
        assert one.temp_c == pytest.approx(21.15, abs=0.01)


def test_the_stated_uncertainty_is_that_of_repeating() -> None:
    """Over 200 campaigns the deviation from the truth, in stated standard uncertainties, scatters as Student's t of 4 degrees."""
    rng = np.random.default_rng(2)
    found = [by_name(of_pass(read(rows(rng, 10.0, targets=5)), "v"))["backlash_um"] for _ in range(200)]
    inside = np.mean([abs(one.value - 10.0) < 2.776 * one.std for one in found])
    assert 0.9 <= inside <= 0.99
    accuracy = [by_name(of_pass(read(rows(rng, 10.0, targets=5)), "v"))["A_um"] for _ in range(200)]
    scatter = np.std([one.value for one in accuracy])
    assert 0.5 < math.sqrt(np.mean([one.std**2 for one in accuracy])) / scatter < 2.0


def test_a_temperature_coefficient_needs_a_range_of_temperature() -> None:
    rng = np.random.default_rng(3)
    parts = [read(rows(rng, 10.0, runs=1, noise_um=0.1, temp_c=20.0 + k)) for k in range(6)]
    columns = {name: np.concatenate([one[name] for one in parts]) for name in parts[0].columns}
    columns["run"] = np.repeat(np.arange(1.0, 7.0), len(parts[0]))
    found = by_name(of_pass(Records.of(columns), "v"))["expansion_ppm_per_k"]
    assert abs(found.value - 11.0) < 4.0 * found.std < 1.0
    assert "expansion_ppm_per_k" not in by_name(of_pass(read(rows(rng, 10.0)), "v"))


def test_one_run_and_one_direction_give_what_they_can() -> None:
    one_run = by_name(of_pass(read(rows(np.random.default_rng(4), 10.0, runs=1)), "v"))
    assert math.isnan(one_run["backlash_um"].std)
    assert "A_um" not in one_run
    records = read(rows(np.random.default_rng(4), 10.0))
    assert "backlash_um" not in by_name(of_pass(records.where(records.direction > 0), "v"))
    scattered = records.with_column("target_mm", records.target_mm + 0.001 * np.arange(len(records)))
    assert of_pass(scattered, "v") == []


def test_friction_is_half_the_difference_of_both_directions() -> None:
    records = read(rows(np.random.default_rng(5), 10.0))
    torque = 7.0 * records.direction + 12.0  # a vertical axis: 12 % holds the table
    moving = records.with_column("velocity_mm_s", np.full(len(records), 50.0)).with_column("torque_percent", torque)
    found = by_name(of_pass(moving, "v"))["friction_torque_percent"]
    assert (found.value, found.of) == (pytest.approx(7.0), 5)
    at_rest = records.with_column("velocity_mm_s", np.zeros(len(records))).with_column("torque_percent", torque)
    assert "friction_torque_percent" not in by_name(of_pass(at_rest, "v"))


def test_stored_results(tmp_path: Path) -> None:
    lost = {"parameters": {"amount_um": {"value": 3.5, "std": 0.1}}, "reversals": [{}, {}]}
    (tmp_path / "result.json").write_text(json.dumps(lost))
    (one,) = of_result(tmp_path / "result.json")
    assert (one.quantity, one.value, one.std, one.of) == ("lost_motion_um", 3.5, 0.1, 2)
    finding = {"effect": "thermal_expansion", "parameters": {"coefficient_ppm_per_k": {"value": 10.2, "std": 0.3}}}
    path = tmp_path / "before.diagnosis.json"
    path.write_text(json.dumps({"findings": [finding, {"effect": "cyclic"}, 7]}))
    (one,) = of_result(path)
    assert (one.quantity, one.value, one.std) == ("expansion_ppm_per_k", 10.2, 0.3)
    for bad in ("", "[]", "7", '{"findings": 3}', "{" * 1000, '{"findings": ' + "9" * 500 + "}"):
        path.write_text(bad)
        with pytest.raises(InputError):
            of_result(path)


def test_reversals_by_torque(tmp_path: Path) -> None:
    """Wind-up over 20 µm, then sliding at 6 %: what a backlash file holds, without the program's own simulation."""
    path = tmp_path / "backlash-001.jsonl"
    rng = np.random.default_rng(6)
    lines = []
    for run in range(4):
        direction = 1 if run % 2 else -1
        travel_um = np.arange(0.0, 60.0)
        torque = 6.0 * np.minimum(1.0, -1.0 + 2.0 * travel_um / 20.0) + rng.normal(0.0, 0.02, len(travel_um))
        lines.append(
            {
                "run": run,
                "axis": "X",
                "begun": datetime(2026, 3, 1, tzinfo=UTC).isoformat(),
                "direction": direction,
                "position_load_mm": (direction * travel_um / 1000.0).tolist(),
                "torque_percent": (direction * torque)[:, None].tolist(),
                "slides_percent": (direction * (6.0 + rng.normal(0.0, 0.02, (6, 1)))).tolist(),
            }
        )
    text = "".join(json.dumps(line) + "\n" for line in lines)
    path.write_text(text + '{"run": 4, "torn')
    found = of_torque_file(path)
    assert (found.axis, found.begun[:10]) == ("X", "2026-03-01")
    values = by_name(found.values)
    assert values["torque_lost_motion_um"].value == pytest.approx(20.0, abs=0.7)
    assert values["friction_torque_percent"].value == pytest.approx(6.0, abs=0.05)
    path.write_text(text.replace('"direction": -1', '"direction": 0', 1))
    with pytest.raises(InputError, match=r"backlash-001\.jsonl:1"):
        of_torque_file(path)
