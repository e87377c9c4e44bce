"""A correction without a cause from `hil diagnose --non-parametric` to the drive's command: applied, sealed, in force, verified."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from study.truth_machines import Machine, Plan
from support import bench_axis

from drivers.errors import StateError
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.store import SealedStore
from hil.correction.tables import TableSet
from hil.diagnosis import diagnose
from hil.diagnosis.loop.procedure import compensation_of
from hil.effects import Term
from hil.effects.model import Model
from hil.effects.non_parametric import NonParametric, smooth_form
from hil.records.rows import Records, read_csv, to_csv

PLAN = Plan(runs=6, targets=16)


def written(path: Path, kind: str, seed: int, number: int = 0) -> str:
    columns, _ = Machine(seed, (kind,) if kind else (), (2.0,) if kind else ()).campaign(number, PLAN)
    path.write_text(to_csv(Records.of(columns)))
    return str(path)


def test_the_option_without_a_file_for_the_model_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", written(tmp_path / "a.csv", "cross_product", 17), "--non-parametric"]) == 2
    assert "--out" in capsys.readouterr().err


@pytest.mark.outside
def test_from_records_to_the_drives_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The correction that `apply` writes is that of the engine out of the sealed store, row by row."""
    measured = written(tmp_path / "a.csv", "cross_product", 17)
    fresh = written(tmp_path / "b.csv", "cross_product", 17, 1)
    plain, extended, out = (str(tmp_path / name) for name in ("plain.json", "extended.json", "out.csv"))
    assert main(["diagnose", measured, "--out", plain, "--json", str(tmp_path / "a.json")]) == 1
    said = capsys.readouterr().out
    assert "load_kg × pos_y_mm, " in said
    assert "--non-parametric adds a smooth function of load_kg × pos_y_mm" in said
    assert "non_parametric" not in Path(plain).read_text()
    (carrier,) = json.loads((tmp_path / "a.json").read_text())["carried_by"]
    assert 0 < carrier["rms_std_um"] < 0.2 * carrier["rms_um"]
    report = tmp_path / "report.html"
    assert main(["report", measured, "--diagnosis", str(tmp_path / "a.json"), "--out", str(report)]) == 0
    page = report.read_text(encoding="utf-8")
    assert "What the extended model leaves" in page
    assert 'id="data-spectrum"' in page
    assert len(page) < 1_500_000
    capsys.readouterr()

    assert main(["diagnose", measured, "--out", extended, "--non-parametric"]) == 1, "still unexplained"
    assert "the cause is unknown" in capsys.readouterr().out
    assert main(["apply", "--model", plain, fresh, "--out", out]) == 0
    without_um = float(np.sqrt(np.mean(read_csv(out)["residual_um"] ** 2)))
    assert main(["apply", "--model", extended, fresh, "--out", out]) == 0
    assert "the cause is unknown" in capsys.readouterr().out
    applied = read_csv(out)
    assert float(np.sqrt(np.mean(applied["residual_um"] ** 2))) < 0.6 * without_um

    axis = load_axis(bench_axis.lay_out(tmp_path))
    passwords = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]
    model = Model.from_json(Path(extended).read_text())
    nodes = np.array(model.table.positions_mm)
    SealedStore.of(axis, *passwords).save(compensation_of(model, TableSet.zero(nodes)))
    in_force = SealedStore.of(axis, passwords[0]).load()
    for row in (3, 40, 111):
        target, d = float(applied.target_mm[row]), int(applied.direction[row])
        known = {name: float(applied[name][row]) for name in ("load_kg", "pos_y_mm")}
        command = in_force.command(target, MotionHistory(target - d), known)
        assert command.correction_um == pytest.approx(float(applied["correction_um"][row]), abs=1e-4)
        with pytest.raises(StateError, match="pos_y_mm"):
            in_force.command(target, MotionHistory(target - d), {"load_kg": known["load_kg"]})


@pytest.mark.outside
@pytest.mark.parametrize(
    ("kind", "words"), [("", "nothing is left unexplained"), ("torque_times_temperature", "torque")]
)
def test_it_is_refused_in_one_line_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, words: str
) -> None:
    out = tmp_path / "extended.json"
    measured = written(tmp_path / "a.csv", kind, 12)
    assert main(["diagnose", measured, "--out", str(out), "--non-parametric"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error
    assert not out.exists()


@pytest.mark.usefixtures("passwords")
@pytest.mark.outside
def test_verify_moves_with_it_in_force(tmp_path: Path) -> None:
    """Measured on a colder machine than today's: held at the end of that range, where it says 20 µm."""
    axis = load_axis(bench_axis.lay_out(tmp_path))
    name = "temp_screw_c"
    spread = {f"{name}.low": 5.0, f"{name}.high": 9.0, f"{name}.least": 5.0, f"{name}.most": 9.0}
    term = Term(
        NonParametric(),
        smooth_form([name], [spread], with_direction=False),
        (),
        (5.0, 5.0, 5.0, 5.0),
        tuple((0.0,) * 4 for _ in range(4)),
    )
    tables = TableSet.zero(np.array([0.0, 500.0]))
    SealedStore.of(axis, *bench_axis.PASSWORDS.values()).save(Compensation(tables, (term,)))
    assert main(["verify", str(axis.path)]) == 0
    rows = read_csv(next((tmp_path / "X-campaign").glob("verify-*/verify.csv")))
    np.testing.assert_allclose(rows["command_mm"] - rows.target_mm, -0.020, atol=1e-6)


@pytest.mark.outside
@pytest.mark.parametrize(
    ("kind", "seed", "strength", "most"),
    [
        ("feed_resonance", 508_082_495, 3.876, 0.6),
        ("cross_product", 549_564_284, 1.860, 0.6),
        ("direction_times_humidity", 883_629_044, 2.280, 0.75),
    ],
)
def test_on_a_machine_outside_the_catalogue_it_brings_a_fresh_campaign_down(
    kind: str, seed: int, strength: float, most: float
) -> None:
    """From the RMS that the model of the catalogue leaves there."""
    machine = Machine(seed, (kind,), (strength,))
    (said, _), (columns, _) = machine.campaign(0), machine.campaign(1)
    found, fresh = diagnose(Records.of(said)), Records.of(columns)
    assert found.unexplained
    corrected = found.non_parametric
    assert not isinstance(corrected, str), corrected
    without_um, with_um = (
        np.std(fresh.uncorrected_error_um - one.extended.error_um(fresh.columns)) for one in (found, corrected)
    )
    assert with_um < most * without_um
