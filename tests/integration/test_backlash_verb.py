"""`hil backlash` as a user types it, on the bench."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
from support.backlash_axis import QUICK, lay_out

from drivers.drive import ServoDrive
from hil.app.main import main
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.backlash.job import backlash_config
from hil.backlash.settings import backlash_settings
from hil.machine.wiring import connected_drive

pytestmark = pytest.mark.outside

Until = Callable[[Callable[[], bool], str], None]


def test_measure_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis, out = lay_out(tmp_path), tmp_path / "out.json"
    assert main(["backlash", str(axis), "--json", str(out), "--write"]) == 2
    assert "no [instrument]: nothing would use the amount, so it is not written" in capsys.readouterr().err
    assert main(["backlash", str(axis), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["good"] is True
    assert abs(found["fitted"]["mean_um"] - 53.0) <= found["fitted"]["u95_um"]
    assert found["lost_motion_um"] == found["fitted"]["mean_um"]
    assert found["lost_motion_um"] == pytest.approx(sum(found["by_direction_um"].values()) / 2.0)
    assert {one["direction"] for one in found["reversals"]} == {-1, 1}
    assert all(one["four_sample_um"] is not None for one in found["reversals"])
    assert found["parameters"]["before"] == {"no parameter of the drive": 0.0}
    assert found["parameters"]["written"] is None

    rows = [json.loads(line) for line in (tmp_path / "X-campaign/backlash-001.jsonl").read_text().splitlines()]
    assert [(row["run"], row["direction"]) for row in rows] == [(1, -1), (1, 1)]
    assert "± " in capsys.readouterr().out


def test_the_drive_is_let_go_before_the_result_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A report takes seconds, in which a drive that is still connected would miss its master."""
    axis, out = lay_out(tmp_path), tmp_path / "out.json"
    written: list[bool] = []

    @contextmanager
    def seen(which: DriveAxis) -> Iterator[ServoDrive]:
        with connected_drive(which) as drive:
            yield drive
            written.append(out.exists())

    monkeypatch.setattr("hil.backlash.command.connected_drive", seen)
    assert main(["backlash", str(axis), "--json", str(out)]) == 0
    assert written == [False]
    assert out.exists()


def test_a_creep_finds_what_steps_find(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without rests, with the motor's own friction in every reading; 53 µm by the laser."""
    axis, out = lay_out(tmp_path, "modbus-tcp", ""), tmp_path / "out.json"
    assert main(["backlash", str(axis), "--feed", "creep", "--dry-run"]) == 0
    assert "turn back, and creep at 20 µm/s, to" in capsys.readouterr().out
    assert main(["backlash", str(axis), "--feed", "creep", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["feed"] == "creep"
    assert abs(found["fitted"]["mean_um"] - 53.0) <= found["fitted"]["u95_um"] < 2.0
    assert found["four_sample"]["mean_um"] is not None
    rows = [json.loads(line) for line in (tmp_path / "X-campaign/backlash-001.jsonl").read_text().splitlines()]
    assert [row["creep_um_s"] for row in rows] == [20.0, 20.0]


def test_the_report_shows_both_directions_with_both_estimates(tmp_path: Path) -> None:
    axis, page = lay_out(tmp_path), tmp_path / "out.html"
    assert main(["backlash", str(axis), "--report", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 1
    for words in ("+ → −", "− → +", "peak by the four-sample rule", "lost motion ± U95", "the table breaks away"):
        assert words in text
    assert not re.search(r"(src|href)=\"https?:", text)
    embedded = re.search(r'id="data-run-1-minus-plus">(.*?)</script>', text)
    assert embedded is not None
    columns = json.loads(embedded[1])["columns"]
    assert columns["travel_um"][0] == 0
    assert len(columns["torque_1_percent"]) == len(columns["torque_2_percent"]) == len(columns["travel_um"])


def test_one_direction_scaled_by_one_value_of_a_laser_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axis, out = lay_out(tmp_path, "canopen"), tmp_path / "out.json"
    first = ["backlash", str(axis), "--reversals", "to-minus", "--laser", "53.0", "--json", str(out)]
    assert main(first) == 0
    plain = json.loads(out.read_text())
    assert (list(plain["by_direction_um"]), plain["scale"]) == (["+ → −"], 1.0)
    assert [one["direction"] for one in plain["reversals"]] == [-1]
    told = re.search(r"\[backlash\] scale = ([\d.]+) makes them agree", " ".join(capsys.readouterr().out.split()))
    assert told is not None
    assert float(told[1]) == pytest.approx(53.0 / plain["lost_motion_um"], abs=1e-4)
    axis.write_text(axis.read_text() + "scale = 1.25\n")
    assert main(["backlash", str(axis), "--reversals", "to-minus", "--write", "--json", str(out)]) == 0
    scaled = json.loads(out.read_text())
    written_um = scaled["parameters"]["written"] * scaled["parameters"]["amount_um"]
    assert written_um == pytest.approx(1.25 * scaled["lost_motion_um"], abs=0.6 * scaled["parameters"]["amount_um"])
    assert "amount to write" in capsys.readouterr().out


@pytest.mark.parametrize("face", ["canopen", "modbus-tcp"])
def test_a_typed_amount_is_written_without_a_measurement_and_put_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], face: str
) -> None:
    axis = lay_out(tmp_path, face)
    assert main(["backlash", str(axis), "--write-um", "52", "--dry-run"]) == 0
    assert "would write 52 µm" in capsys.readouterr().out
    out = tmp_path / "written.json"
    assert main(["backlash", str(axis), "--write-um", "52", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["amount_um"] == 52.0
    assert "for 52 µm as typed; not yet proven" in " ".join(capsys.readouterr().out.split())
    assert not list(tmp_path.glob("X-campaign/backlash-*.jsonl"))
    assert main(["backlash", str(axis), "--restore"]) == 0
    assert "put back: " in capsys.readouterr().out
    for wrong in ("-1", "x", "1e9"):
        with pytest.raises(SystemExit):
            main(["backlash", str(axis), f"--write-um={wrong}"])


def test_a_dry_run_touches_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis = lay_out(tmp_path, "canopen")
    before = sorted(tmp_path.rglob("*"))
    assert main(["backlash", str(axis), "--dry-run", "--write"]) == 0
    assert sorted(tmp_path.rglob("*")) == before
    plan = capsys.readouterr().out
    assert "2201h and 2202h would be 0" in plan
    assert "from 4.8 mm to 5 mm, turn back, and go in steps of 2 µm, to 3.8 mm at most" in plan
    assert "take the place" in plan


def test_detection_limit_exceeded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis, out = lay_out(tmp_path, "canopen", QUICK + "steps = 20\n"), tmp_path / "out.json"
    assert main(["backlash", str(axis), "--json", str(out), "--write"]) == 1
    found = json.loads(out.read_text())
    assert found["detection_limit_exceeded"] is True
    assert found["lost_motion_um"] is None
    assert found["parameters"]["written"] is None
    assert found["parameters"]["before"] == {"2201h": 0.0, "2202h": 0.0}
    assert not (tmp_path / "X-campaign" / "backlash-before.json").exists()
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "detection limit exceeded: + → − shows no break-away within 40 µm (20 steps); everything is as it was" in shown
    )


def test_restore_puts_back_what_was_there_before_the_first_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two writes one after the other, each measurement with the amount of the one before in the drive; one connection, as a
    bench forgets its parameters with its power. The command as it is, from there on."""
    axis = lay_out(tmp_path, "modbus-tcp")
    config = load_drive_axis(axis)
    how = backlash_config(config)
    with connected_drive(config) as drive:
        monkeypatch.setattr("hil.backlash.command.connected_drive", lambda _axis: nullcontext(drive))
        amount = backlash_settings(config, how, drive).amount
        amount.write(1234)
        for _ in range(2):
            assert main(["backlash", str(axis), "--write"]) == 0
            assert 5200 < amount.read() < 5400
        assert main(["backlash", str(axis), "--restore", "--dry-run"]) == 0
        assert "would write back" in (plan := capsys.readouterr().out)
        assert f"{amount.name} = 1234" in plan
        out = tmp_path / "restored.json"
        assert main(["backlash", str(axis), "--restore", "--json", str(out)]) == 0
        restored = json.loads(out.read_text())["restored"]
        assert (restored[amount.name], amount.read()) == (1234, 1234)
        assert f"put back: {amount.name} = 1234" in capsys.readouterr().out
        amount.write(77)
        assert main(["backlash", str(axis), "--restore", "--json", str(out)]) == 0
        assert "nothing to put back" in capsys.readouterr().out
        assert json.loads(out.read_text())["restored"] is None
        assert amount.read() == 77


def test_an_interruption_is_put_back_before_a_write_is_undone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    axis, folder = lay_out(tmp_path, "canopen"), tmp_path / "X-campaign"
    config = load_drive_axis(axis)
    with connected_drive(config) as drive:
        monkeypatch.setattr("hil.backlash.command.connected_drive", lambda _axis: nullcontext(drive))
        amount = backlash_settings(config, backlash_config(config), drive).amount
        amount.write(1250)
        assert main(["backlash", str(axis), "--write"]) == 0
        written = amount.read()
        amount.write(0)
        (folder / "backlash-before.json").write_text(json.dumps({amount.name: written}))
        capsys.readouterr()
        assert main(["backlash", str(axis), "--restore"]) == 0
        assert amount.read() == written
        assert f"before it there was {amount.name} = 1250" in (said := capsys.readouterr().out)
        assert "--restore once more" in said
        assert main(["backlash", str(axis), "--restore"]) == 0
        assert amount.read() == 1250


@pytest.mark.parametrize(
    ("face", "backlash", "words"),
    [
        ("virtual", "acceleration = '2202h'\n", "[backlash] names acceleration without parameter"),
        ("canopen", "runs = 0\n", "axis.toml:25: [backlash] runs is 0, expected a whole number, 1 to 100"),
    ],
)
def test_a_wrong_axis_file_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], face: str, backlash: str, words: str
) -> None:
    assert main(["backlash", str(lay_out(tmp_path, face, backlash))]) == 2
    assert words in capsys.readouterr().err
    assert not list((tmp_path).rglob("*.jsonl"))


@pytest.mark.parametrize("parameter", ["6040h", "607Ah", "1010h:01"])
def test_an_object_that_moves_the_axis_is_refused_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], parameter: str
) -> None:
    path = lay_out(tmp_path, "canopen")
    path.write_text(path.read_text().replace('"2201h"', f'"{parameter}"'))
    assert main(["backlash", str(path)]) == 2
    assert (
        f"{parameter} is no parameter but a target, a command or communication; nothing was written"
        in capsys.readouterr().err
    )


def test_ctrl_c_ends_it_with_130_and_everything_as_it_was(tmp_path: Path, until: Until) -> None:
    axis, folder = lay_out(tmp_path, "canopen"), tmp_path / "X-campaign"
    command = [sys.executable, "-m", "hil.app", "backlash", str(axis), "--runs", "100"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    kept = folder / "backlash-001.jsonl"
    until(lambda: kept.exists() and kept.read_text().count("\n") >= 2, "two reversals measured")
    assert json.loads((folder / "backlash-before.json").read_text()) == {"2201h": 0.0, "2202h": 0.0}, "noted meanwhile"
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert errors == "hil: interrupted; the axis was stopped, what was measured is kept\n"
    assert not (folder / "backlash-before.json").exists()
    assert all(json.loads(line)["position_load_mm"] for line in kept.read_text().splitlines())


def test_the_example_runs_as_it_is_shipped(tmp_path: Path) -> None:
    shipped = Path(__file__).parents[2] / "hil/examples/backlash_axis.toml"
    axis = tmp_path / "axis.toml"
    axis.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    command = [sys.executable, "-m", "hil.examples.backlash", str(axis)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "LC_ALL": "C.UTF-8"})
    assert (done.returncode, done.stderr) == (0, "")
    found = re.search(r"lost motion ([\d.]+) ± ([\d.]+) µm", done.stdout)
    assert found is not None
    assert abs(float(found[1]) - 53.0) <= float(found[2])
