"""An effect in a user's own file, from records that hold it to the correction, with and without the file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hil.examples.coolant_level as example
from hil.app.main import main
from hil.records.rows import Records, read_csv, to_csv

OWN = Path(example.__file__)
NOISE_UM = 0.4


def campaign(seed: int) -> Records:
    """5 runs of 24 rows on a wavy axis whose bed bends, more and more slowly, under a tank that is pumped up and down."""
    rng = np.random.default_rng(seed)
    rows: dict[str, list[float]] = {
        name: [] for name in ("run", "direction", "target_mm", "measured_mm", "time_s", "coolant_level_mm")
    }
    time_s, phase = 0.0, rng.uniform(0.0, 6.0)
    for run in range(1, 6):
        for step in range(24):
            time_s += 6.0
            direction = 1.0 if step < 12 else -1.0
            place = step if step < 12 else 23 - step
            target = 40.0 * place + rng.uniform(-12.0, 12.0) + 10.0
            level = 120.0 + 35.0 * np.sin(2 * np.pi * time_s / 210.0 + phase) + rng.normal(0.0, 1.0)
            bend_um = 4.0 * np.tanh((level - 110.0) / 100.0)
            error_um = 4.0 * np.sin(target / 90.0) - 2.5 * (direction < 0) + bend_um + rng.normal(0.0, NOISE_UM)
            values = (run, direction, target, target + error_um / 1000.0, time_s, level)
            for name, value in zip(rows, values, strict=True):
                rows[name].append(float(value))
    return Records.of(rows)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("records") / "measured.csv"
    path.write_text(to_csv(campaign(1)))
    return path


@pytest.fixture(scope="module")
def extended(measured: Path) -> tuple[Path, dict[str, object]]:
    """The model that `diagnose --effects` writes, and its JSON."""
    model, found = measured.with_name("extended.json"), measured.with_name("found.json")
    argv = ["diagnose", str(measured), "--effects", str(OWN), "--json", str(found), "--out", str(model)]
    assert main(argv) == 0
    return model, json.loads(found.read_text())


def test_without_the_file_it_is_unexplained_and_the_column_that_carries_it_is_named(measured: Path) -> None:
    found = measured.with_name("without.json")
    assert main(["diagnose", str(measured), "--json", str(found)]) == 1
    result = json.loads(found.read_text())
    assert result["unexplained"] is True
    assert result["findings"] == []
    assert any("coolant_level_mm" in carrier["columns"] for carrier in result["carried_by"])


def test_with_the_file_it_is_found_by_its_name(extended: tuple[Path, dict[str, object]]) -> None:
    _, result = extended
    assert result["unexplained"] is False
    (finding,) = result["findings"]
    assert (finding["effect"], finding["action"]) == ("coolant_level", "compensate")
    assert finding["confidence"] > 0.95
    assert finding["parameters"]["um_per_mm_of_level"]["value"] == pytest.approx(0.038, rel=0.15)


def test_the_model_corrects_fresh_records_down_to_the_noise(
    extended: tuple[Path, dict[str, object]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, _ = extended
    fresh, out = tmp_path / "fresh.csv", tmp_path / "out.csv"
    fresh.write_text(to_csv(campaign(2)))
    argv = ["apply", "--model", str(model), str(fresh), "--out", str(out)]
    assert main([*argv, "--effects", str(OWN)]) == 0
    assert np.std(read_csv(out)["residual_um"]) < 1.25 * NOISE_UM
    out.unlink()
    capsys.readouterr()
    assert main(argv) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for part in (str(model), "'coolant_level'", "--effects FILE.py"):
        assert part in error
    assert not out.exists()


def test_it_can_be_declared_to_be_there(measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Fitted beside the table without a search; another effect, and one that is never corrected, are refused."""
    model, fresh, out = tmp_path / "declared.json", tmp_path / "fresh.csv", tmp_path / "out.csv"
    argv = ["fit", str(measured), "--out", str(model), "--with"]
    assert main([*argv, "coolant_level", "--effects", str(OWN)]) == 0
    assert "Each mm of coolant in the tank moves the table by 0.0" in capsys.readouterr().out
    fresh.write_text(to_csv(campaign(2)))
    assert main(["apply", "--model", str(model), str(fresh), "--out", str(out), "--effects", str(OWN)]) == 0
    assert np.std(read_csv(out)["residual_um"]) < 1.25 * NOISE_UM
    for name, expected in (
        ("coolant_level", "--with coolant_level: there is no such effect; there are cyclic, "),
        ("dead_path", "effect dead_path is never corrected (fix-setup)"),
        ("velocity_lag", "these records cannot show velocity_lag: a column is missing"),
    ):
        capsys.readouterr()
        assert main([*argv, name]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert expected in error
